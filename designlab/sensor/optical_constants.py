"""Optical constants of the transparent materials these sensors are made of.

Indices are for 589 nm unless the source says otherwise; dispersion over the visible range (about 0.01 to
0.02) is not modelled. Where a source gives losses too small to be seen over the few centimetres that light
travels in a sensor, the material is taken as clear and the figure is quoted.
"""

from dataclasses import dataclass

import numpy as np

from designlab.core.types import Array
from designlab.sensor.data import table


@dataclass(frozen=True)
class Material:
    """A clear material and where its figures come from.

    Attributes
    ----------
    name : str
        Name in designs.
    index : float
        Refractive index.
    source : str
        Where index and losses were read; an assumption says so.
    absorption : tuple of (wavelength in nm, coefficient per mm)
        Absorption coefficient of intensity at some wavelengths, ascending; empty where it is clear.
    """

    name: str
    index: float
    source: str
    absorption: tuple[tuple[float, float], ...] = ()

    def absorption_per_mm(self, *, wavelength_nm: float) -> float:
        """Absorption coefficient per mm, between the tabulated wavelengths linearly, beyond them constant."""
        if not self.absorption:
            return 0.0
        wavelengths, coefficients = zip(*self.absorption, strict=True)
        return float(np.interp(wavelength_nm, wavelengths, coefficients))


def _materials() -> dict[str, Material]:
    materials = {}
    for name, content in table("optical_constants").items():
        # the absorption coefficient (per mm) of an extinction coefficient k at a wavelength in nm
        absorption = tuple((nm, 4e6 * np.pi * k / nm) for nm, k in content.pop("extinction", ()))
        materials[name] = Material(name, absorption=absorption, **content)
    return materials


MATERIALS = _materials()
"""The materials, read from `data/optical_constants.toml`."""
AIR = MATERIALS["air"]


def material(name: str) -> Material:
    """Look up a material by name.

    Raises
    ------
    ValueError
        If the name is unknown; the message lists the known ones.
    """
    try:
        return MATERIALS[name]
    except KeyError:
        raise ValueError(f"material: unknown {name!r}; known are {', '.join(MATERIALS)}") from None


def fresnel_reflectance(cosine: Array, index: complex) -> Array:
    """Fresnel's reflectance for unpolarised light, by the cosine of incidence and the relative index.

    The index is complex for a metal and real for a clear medium.
    """
    inside = np.sqrt(1 - (1 - cosine**2) / index**2 + 0j)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (index * cosine - inside) / (index * cosine + inside)
    return np.asarray((np.abs(across) ** 2 + np.abs(along) ** 2) / 2)


def internal_reflectance(index: float) -> float:
    """Share of diffuse light in a clear medium that its smooth surface to air sends back.

    The mean of Fresnel's reflectance over Lambertian directions, most of it beyond the critical angle; 0.596
    at an index of 1.5 (Judd 1942, J. Res. Natl. Bur. Stand. 29, 329).
    """
    critical = float(np.sqrt(1.0 - 1.0 / index**2))  # cosine
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosine = critical + (1.0 - critical) * (nodes + 1.0) / 2
    passed = 1.0 - fresnel_reflectance(cosine, 1.0 / index)
    return float(1.0 - (1.0 - critical) * weights @ (passed * cosine))
