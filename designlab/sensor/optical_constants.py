"""Optical constants of the transparent materials these sensors are made of.

Indices are for 589 nm unless the source says otherwise; dispersion over the visible range (about 0.01 to
0.02) is not modelled. Where a source gives losses too small to be seen over the few centimetres that light
travels in a sensor, the material is taken as clear and the figure is quoted.
"""

from dataclasses import dataclass

import numpy as np


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


AIR = Material("air", 1.0, "definition; air at 20 C is 1.00027")

# Extinction coefficients k of N-BK7 by wavelength (nm), SCHOTT Zemax catalogue 2017-01-20b as tabulated by
# refractiveindex.info; the absorption coefficient is 4 pi k / wavelength.
_BK7_EXTINCTION = (
    (436.0, 1.1147e-8), (460.0, 1.0286e-8), (500.0, 9.5781e-9), (546.0, 6.9658e-9),
    (580.0, 9.2541e-9), (620.0, 1.1877e-8), (660.0, 1.2643e-8), (700.0, 8.9305e-9),
)  # fmt: skip

MATERIALS: dict[str, Material] = {
    material.name: material
    for material in (
        AIR,
        Material(
            "acrylic",
            1.49,
            "PMMA at 589 nm, rounded: 1.4925 by Beadie et al., Appl. Opt. 54, F139 (2015), with 1.500 at "
            "465 nm and 1.491 at 625 nm. Absorbs about 2e-5 per mm near 500 nm (laser calorimetry): taken"
            " as clear",
        ),
        Material(
            "silicone",
            1.41,
            "clear silicone gels, 1.40 to 1.43 by makers' data sheets, rounded. Sylgard 184 at 589 nm: "
            "1.431 (Schneider et al., Sens. Actuators A 151, 95 (2009)) or 1.395 (Zhang et al., Appl. "
            "Opt. 59, 2337 (2020)). Waveguides written into PDMS lose 0.03 dB/cm, 7e-4 per mm, at 650 to "
            "700 nm (EPFL): an upper limit of the bulk's loss, taken as clear",
        ),
        Material(
            "resin-2020",
            1.5403,
            "gelcore of the 2020 prototype, arXiv 2012.13184, public scene files; losses are not published",
        ),
        Material(
            "resin-clear",
            1.51,
            "clear printing resins (two commercial, one custom): 1.505 at 670 nm to 1.533 at 405 nm, Opt."
            " Mater. Express 11, 3392 (2021); rounded. Losses and haze depend on print, cure and polish, "
            "and no single coefficient describes them (Hamp et al., Appl. Opt. 60, 6573 (2021)): none "
            "assumed, measure the part",
        ),
        Material(
            "epoxy",
            1.53,
            "assumption: middle of the range 1.50 to 1.57 that makers of optical epoxies give for most of"
            " them; no figure for losses found, none assumed",
        ),
        Material(
            "glass",
            1.5168,
            "SCHOTT N-BK7 data sheet, n_d and extinction coefficients",
            tuple((nm, 4e6 * np.pi * k / nm) for nm, k in _BK7_EXTINCTION),
        ),
    )
}


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
