"""The membrane's coating: how it reflects, in closed form, and what it looks like from place to place."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.sensor.optical_properties import AlbedoImage, Optics
from designlab.simulation.contact.surface import Surface
from designlab.simulation.scene.materials import Coating, Texture
from geometries import elastomer

CELL_MM = 0.05  # of a texture; coarser where it would get more than `MOST_CELLS` a side
MOST_CELLS = 1024
FOLLOWED = 4  # steps to where a point of the skin came from; shifts differ little from place to place
SPLIT = 4  # sub-samples of a cell in each direction, for smooth rims of the dots


def backed(albedo: Any, transmittance: Any, behind: Any) -> Any:
    """Reflectance of a coating with a diffuse surface of reflectance `behind` right behind it.

    Light passes, returns, and passes again or is sent back once more: the geometric series
    a + t^2 r (1 + r a + (r a)^2 + ...) = a + t^2 r / (1 - r a), of which Kubelka (1948), J. Opt. Soc. Am. 38,
    448, eq. 30, is the general form. The coating is taken as alike from both sides.

    Parameters
    ----------
    albedo, transmittance, behind : float or array
        Diffuse reflectance and transmittance of the coating alone, diffuse reflectance behind it.
    """
    return albedo + transmittance**2 * behind / (1.0 - behind * albedo)


def bare(reflectance: Any, transmittance: Any, behind: Any) -> Any:
    """Reflectance of a coating alone, at least 0, from what it has with a surface behind it.

    Solves `backed` for its albedo a: r a^2 - (1 + r R) a + R - t^2 r = 0, written so that r may be 0.

    Parameters
    ----------
    reflectance, transmittance, behind : float or array
        Diffuse reflectance R with the surface, transmittance t of the coating alone, reflectance r behind it.
    """
    half = 1.0 + behind * reflectance
    root = ((1.0 - behind * reflectance) ** 2 + (2.0 * transmittance * behind) ** 2) ** 0.5
    return np.maximum(2.0 * (reflectance - transmittance**2 * behind) / (half + root), 0.0)


def coating_brdf(
    cos_in: Any, cos_out: Any, cos_half: Any, *, reflectance: Any, specular: float, roughness: float
) -> Any:
    """BRDF (1/sr) of a coating: a Lambertian share and a GGX lobe without Fresnel loss.

    f = (1 - s) rho / pi + s rho D G1(in) G1(out) / (4 cos_in cos_out) with the distribution D and Smith's
    separable masking G1 of Walter et al. (2007), "Microfacet models for refraction through rough surfaces",
    eqs. 33 and 34. Only arithmetic is used, so that arrays of any kind will do.

    Parameters
    ----------
    cos_in, cos_out, cos_half : float or array
        Cosines to the normal of the directions to the light and to the eye, and of the direction half-way
        between the two; the first two must be positive.
    reflectance : float or array
        Share of light reflected, rho.
    specular, roughness : float
        Share s of it in the lobe, GGX alpha of the lobe.
    """
    square = roughness**2
    distribution = square / (np.pi * ((square - 1.0) * cos_half**2 + 1.0) ** 2)
    # G1(c) / (2 c) = 1 / (c + sqrt(a^2 + (1 - a^2) c^2)): the cosines of the denominator cancel.
    masked_in = cos_in + (square + (1.0 - square) * cos_in**2) ** 0.5
    masked_out = cos_out + (square + (1.0 - square) * cos_out**2) ** 0.5
    lobe = distribution / (masked_in * masked_out)
    return reflectance * ((1.0 - specular) / np.pi + specular * lobe)


def coating(design: Design, surface: Surface) -> Coating:
    """Coating of a membrane: markers and image of the design, and the pressed object where it shines through.

    Markers and image move with the skin, which an elastic gel shifts sideways; that of a kernel contact
    moves along z alone. Where nothing touches, the coating reflects as it is stated to; where something does,
    light that passes meets the object and no longer the backing.
    """
    optics = design.optics
    albedo = design.per_group("membrane_albedo")
    plain = Coating(
        albedo,
        optics.coating_specular,
        optics.coating_roughness,
        transmittance=optics.coating_transmittance,
    )
    leaks = optics.shows_touch and bool(surface.contact.any())
    if not (leaks or optics.marker_pitch_mm or optics.albedo_image):
        return plain
    x, y, width_mm, height_mm = _cells(design)
    local = np.array(albedo)[:, None, None] * np.ones_like(x)
    on_x, on_y = _undeformed(surface, x, y)
    if optics.albedo_image:
        local = local * _image(optics.albedo_image, on_x, on_y)
    if optics.marker_pitch_mm:
        dots = _dots(on_x, on_y, width_mm / x.shape[1], optics)
        local = local * (1.0 - dots) + optics.marker_reflectance * dots
    if leaks:
        touched = surface.sample(surface.contact.astype(float), x, y)
        within = (np.abs(x) <= surface.x_mm.max()) & (np.abs(y) <= surface.y_mm.max())
        alone = bare(local, optics.coating_transmittance, optics.sent_back)
        touching = backed(alone, optics.coating_transmittance, optics.object_reflectance)
        local = np.where(within, local + touched * (touching - local), local)
    brightest = local.max(axis=(1, 2))
    factor = local / np.where(brightest > 0, brightest, 1.0)[:, None, None]
    texture = Texture(_as_one_layer(factor), width_mm, height_mm)
    return replace(plain, reflectance=tuple(float(value) for value in brightest), texture=texture)


def _cells(design: Design) -> tuple[Array, Array, float, float]:
    """Centres (x, y) of square cells over the whole gel, shape (rows, columns), and its size in mm."""
    outline = np.abs(elastomer.polygon(design.elastomer)).max(axis=0)
    cell_mm = max(CELL_MM, 2 * float(outline.max()) / MOST_CELLS)
    columns, rows = (int(np.ceil(2 * reach / cell_mm)) for reach in outline)
    x, y = np.meshgrid(
        (np.arange(columns) + 0.5 - columns / 2) * cell_mm, (rows / 2 - np.arange(rows) - 0.5) * cell_mm
    )
    return x, y, columns * cell_mm, rows * cell_mm


def _undeformed(surface: Surface, x: Array, y: Array) -> tuple[Array, Array]:
    """Where the skin that is now at points (mm) was before the press; beyond the surface it stays."""
    if surface.moved is None:
        return x, y
    within = (np.abs(x) <= surface.x_mm.max()) & (np.abs(y) <= surface.y_mm.max())
    before_x, before_y = x, y
    for _ in range(FOLLOWED):
        shift_x, shift_y = (surface.sample(field, before_x, before_y) for field in surface.sideways_mm)
        before_x, before_y = np.where(within, x - shift_x, x), np.where(within, y - shift_y, y)
    return before_x, before_y


def _dots(x: Array, y: Array, cell_mm: float, optics: Optics) -> Array:
    """Share of each cell that lies in a marker dot; the dots stand on a square grid, one at the origin."""
    pitch_mm, diameter_mm = optics.marker_pitch_mm, optics.marker_diameter_mm
    offsets = ((np.arange(SPLIT) + 0.5) / SPLIT - 0.5) * cell_mm
    covered = np.zeros_like(x)
    for dx in offsets:
        for dy in offsets:
            u = (x + dx) - pitch_mm * np.round((x + dx) / pitch_mm)
            v = (y + dy) - pitch_mm * np.round((y + dy) / pitch_mm)
            covered += u**2 + v**2 <= (diameter_mm / 2) ** 2
    return covered / SPLIT**2


def _image(image: AlbedoImage, x: Array, y: Array) -> Array:
    """Image at points (mm), interpolated between its pixels, its edge continued."""
    from scipy.ndimage import map_coordinates

    rows = (0.5 - y / image.height_mm) * image.rows - 0.5
    columns = (0.5 + x / image.width_mm) * image.columns - 0.5
    return np.asarray(map_coordinates(image.values, [rows, columns], order=1, mode="nearest"))


def _as_one_layer(factor: Array) -> NDArray[np.float32]:
    """One layer where all are the same."""
    layers = factor.astype(np.float32)
    return layers[:1] if (layers == layers[:1]).all() else layers
