"""Materials of a `Scene` as Mitsuba's scattering functions and media."""

from typing import Any

from designlab.scene import Coating, Dielectric, Diffuse


def bsdf(material: Diffuse | Coating | Dielectric, group: int) -> dict[str, Any]:
    """Scattering function of a surface for the light of one LED group, as Mitsuba's dictionary."""
    if isinstance(material, Dielectric):
        return _dielectric(material)
    return diffuse(material.reflectance[group])


def diffuse(reflectance: float) -> dict[str, Any]:
    """Lambertian surface."""
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(reflectance)] * 3}}


def _dielectric(boundary: Dielectric) -> dict[str, Any]:
    indices = {"int_ior": float(boundary.inside.index), "ext_ior": float(boundary.outside.index)}
    if boundary.roughness == 0:
        return {"type": "dielectric", **indices}
    rough = {"distribution": "ggx", "alpha": float(boundary.roughness)}
    return {"type": "roughdielectric", **rough, **indices}
