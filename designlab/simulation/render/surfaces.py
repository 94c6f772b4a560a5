"""Materials of a `Scene` as Mitsuba's scattering functions, textures and media."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.simulation.render.engine import mi
from designlab.simulation.scene.scene import Coating, Dielectric, Diffuse, Medium, Metal, Shape, Texture


def bsdf(material: Diffuse | Coating | Dielectric, group: int) -> dict[str, Any]:
    """Scattering function of a surface for the light of one LED group, as Mitsuba's dictionary."""
    if isinstance(material, Dielectric):
        return _dielectric(material)
    if isinstance(material, Coating):
        return _coating(material, group)
    return diffuse(material.reflectance[group])


def media(material: Diffuse | Coating | Dielectric, group: int) -> dict[str, Any]:
    """Media on the two sides of a boundary, under Mitsuba's names; a clear one needs none."""
    if not isinstance(material, Dielectric):
        return {}
    sides = {"interior": material.inside, "exterior": material.outside}
    return {side: _medium(stuff, group) for side, stuff in sides.items() if not _is_clear(stuff, group)}


def needs_media(shapes: tuple[Shape, ...]) -> bool:
    """Whether light is absorbed or scattered anywhere on its way, so that Mitsuba must track media."""
    boundaries = [shape.material for shape in shapes if isinstance(shape.material, Dielectric)]
    return not all(boundary.inside.clear and boundary.outside.clear for boundary in boundaries)


def texture_coordinates(shape: Shape) -> NDArray[np.float32] | None:
    """Coordinates (n, 2) of a shape's vertices in its coating's texture, nothing without one."""
    if not isinstance(shape.material, Coating) or shape.material.texture is None:
        return None
    texture = shape.material.texture
    u = 0.5 + shape.vertices[:, 0] / texture.width_mm
    v = 0.5 - shape.vertices[:, 1] / texture.height_mm  # Mitsuba's first row is at v = 0
    return np.column_stack([u, v]).astype(np.float32)


def diffuse(reflectance: float | dict[str, Any]) -> dict[str, Any]:
    """Lambertian surface; the reflectance is a number or a texture."""
    return {"type": "diffuse", "reflectance": _grey(reflectance)}


def metal(material: Metal, group: int) -> dict[str, Any]:
    """Mirror or glossy metal for the light of one LED group."""
    content: dict[str, Any] = {
        "type": "conductor",
        "specular_reflectance": _grey(material.reflectance[group]),
    }
    if material.index is None:
        content["material"] = "none"  # reflects all: Fresnel's factor is 1
    else:
        content |= {"eta": float(material.index[group].real), "k": float(material.index[group].imag)}
    if material.roughness:
        content |= {"type": "roughconductor", "distribution": "ggx", "alpha": float(material.roughness)}
    return content


def _grey(value: float | dict[str, Any]) -> dict[str, Any]:
    return value if isinstance(value, dict) else {"type": "rgb", "value": [float(value)] * 3}


def _coating(coating: Coating, group: int) -> dict[str, Any]:
    """Blend of a Lambertian surface and a microfacet mirror, both dimmed by reflectance and texture."""
    reflectance: float | dict[str, Any] = coating.reflectance[group]
    if coating.texture is not None:
        reflectance = _texture(coating.texture, group, coating.reflectance[group])
    lambertian = diffuse(reflectance)
    if coating.specular == 0:
        return lambertian
    lobe = {
        "type": "roughconductor",
        "material": "none",  # reflects all: Fresnel's factor is 1
        "distribution": "ggx",
        "alpha": float(coating.roughness),
        "specular_reflectance": _grey(reflectance),
    }
    return {"type": "blendbsdf", "weight": float(coating.specular), "first": lambertian, "second": lobe}


def _texture(texture: Texture, group: int, reflectance: float) -> dict[str, Any]:
    values = np.ascontiguousarray(reflectance * texture.layer(group)[:, :, None], dtype=np.float32)
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(values),
        "raw": True,
        "filter_type": "bilinear",
        "wrap_mode": "clamp",
    }


def _dielectric(boundary: Dielectric) -> dict[str, Any]:
    indices = {"int_ior": float(boundary.inside.index), "ext_ior": float(boundary.outside.index)}
    if boundary.roughness == 0:
        return {"type": "dielectric", **indices}
    rough = {"distribution": "ggx", "alpha": float(boundary.roughness)}
    return {"type": "roughdielectric", **rough, **indices}


def _is_clear(medium: Medium, group: int) -> bool:
    return medium.absorption_per_mm[group] == 0 and medium.scattering_per_mm == 0


def _medium(medium: Medium, group: int) -> dict[str, Any]:
    """Homogeneous medium: extinction is absorption plus scattering, albedo the scattered share of it."""
    extinction = medium.absorption_per_mm[group] + medium.scattering_per_mm
    content: dict[str, Any] = {
        "type": "homogeneous",
        "sigma_t": extinction,
        "albedo": medium.scattering_per_mm / extinction,
    }
    if medium.scattering_per_mm:
        content["phase"] = {"type": "hg", "g": float(medium.anisotropy)}
    return content
