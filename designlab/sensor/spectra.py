"""Spectra of LEDs and cameras: how much each colour channel answers to each LED group."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from designlab.core.types import Array
from designlab.sensor.data import table
from geometries.spec import Spec

WIDTHS_NM = ((490.0, 25.0), (560.0, 35.0), (1100.0, 20.0))
"""Typical full width at half maximum up to a peak wavelength: blue InGaN, green InGaN, red AlGaInP.

Source: Kingbright data sheet DSAO4460 (APTF1616LSEKJ3ZGKQBC), spectral bandwidth at 50 %. The red one also
stands for longer wavelengths (assumption).
"""

_TABLES = table("spectra")
LUMINOUS_EFFICIENCY: Array = np.array(_TABLES["luminous_efficiency"]["rows"], dtype=float)
"""Spectral luminous efficiency V for photopic vision: rows of wavelength (nm) and V."""
PEAK_EFFICACY_LM_W = 683.0
"""Lumen per watt where V is 1: the definition of the candela."""


class Curves(NamedTuple):
    """Published sensitivity of a camera: rows of wavelength (nm), red, green, blue, and their source."""

    per: Literal["photon", "energy"]
    rows: tuple[tuple[float, float, float, float], ...]
    source: str


SENSITIVITIES = {
    name: Curves(content["per"], tuple(map(tuple, content["rows"])), content["source"])
    for name, content in _TABLES["sensitivities"].items()
}
"""Published sensitivities, read from `data/spectra.toml`."""
CHROMIUM: Array = np.array(_TABLES["chromium"]["rows"], dtype=float)
"""Complex refractive index of chromium: rows of wavelength (nm), n and k."""


class Sensitivity(Spec):
    """Spectral sensitivity of a camera's three channels: a published set by name, or a table."""

    name: str | None = Field(None, description="Published set: " + ", ".join(SENSITIVITIES) + ".")
    wavelength_nm: tuple[float, ...] = Field(
        (), max_length=2000, description="Rising wavelengths of a table (nm); dark beyond its ends."
    )
    red: tuple[float, ...] = Field((), max_length=2000, description="Response of channel R at each.")
    green: tuple[float, ...] = Field((), max_length=2000, description="Response of channel G at each.")
    blue: tuple[float, ...] = Field((), max_length=2000, description="Response of channel B at each.")
    per: Literal["photon", "energy"] = Field(
        "energy", description="photon: the table is a quantum efficiency; energy: a response to power."
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, content: Any) -> Any:
        """Take a plain string for the name of a set."""
        return {"name": content} if isinstance(content, str) else content

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        channels = {"red": self.red, "green": self.green, "blue": self.blue}
        if self.name is not None:
            if self.wavelength_nm or any(channels.values()):
                raise ValueError("name: give the name of a set or a table, not both")
            if self.name not in SENSITIVITIES:
                raise ValueError(f"name: unknown {self.name!r}; known are {', '.join(SENSITIVITIES)}")
            return self
        if len(self.wavelength_nm) < 2:
            raise ValueError("wavelength_nm: a table needs at least two wavelengths, or give a name")
        for before, after in pairwise(self.wavelength_nm):
            if after <= before:
                raise ValueError(f"wavelength_nm: must rise, {after:g} nm follows {before:g} nm")
        if self.wavelength_nm[0] < 100 or self.wavelength_nm[-1] > 3000:
            raise ValueError("wavelength_nm: must lie between 100 and 3000 nm")
        for name, values in channels.items():
            if len(values) != len(self.wavelength_nm):
                raise ValueError(
                    f"{name}: needs a value for each of the {len(self.wavelength_nm)} wavelengths, "
                    f"has {len(values)}"
                )
            if min(values) < 0 or not any(values):
                raise ValueError(f"{name}: must not be negative, and somewhere positive")
        return self

    @property
    def curves(self) -> Curves:
        """The table, by name or given."""
        if self.name is not None:
            return SENSITIVITIES[self.name]
        rows = tuple(zip(self.wavelength_nm, self.red, self.green, self.blue, strict=True))
        return Curves(self.per, rows, "given in the design")


def typical_width_nm(wavelength_nm: float) -> float:
    """Typical full width at half maximum of an LED's spectrum by its peak wavelength, see `WIDTHS_NM`."""
    return next((width for limit, width in WIDTHS_NM if wavelength_nm < limit), WIDTHS_NM[-1][1])


def response(
    sensitivity: Sensitivity, *, wavelength_nm: Sequence[float], width_nm: Sequence[float | None]
) -> Array:
    """Response of each camera channel to the power of each LED group.

    The spectrum of a group is a Gaussian of power by wavelength. A sensitivity per photon is weighted by the
    wavelength, as a milliwatt of longer waves holds more photons.

    Parameters
    ----------
    sensitivity : Sensitivity
        The camera's.
    wavelength_nm, width_nm : sequence of float
        Peak and full width at half maximum of each group's spectrum; typical of the colour where None.

    Returns
    -------
    array, shape (3, groups)
        Rows R, G, B; the largest entry is 1, since exposure sets the scale.

    Raises
    ------
    ValueError
        If a group's light lies outside the table, so that no channel answers to it.
    """
    per, rows, _ = sensitivity.curves
    table = np.asarray(rows, dtype=float)
    columns = []
    for peak, width in zip(wavelength_nm, width_nm, strict=True):
        grid, share = _spectrum(peak, width)
        weight = share * (grid / 550.0 if per == "photon" else 1.0)
        curves = [np.interp(grid, table[:, 0], table[:, k], left=0.0, right=0.0) for k in (1, 2, 3)]
        columns.append([float((curve * weight).sum()) for curve in curves])
    matrix = np.array(columns).T
    for group, column in enumerate(matrix.T):
        if column.max() < 1e-6 * table[:, 1:].max():
            raise ValueError(
                f"no channel answers to LED group {group + 1} at {wavelength_nm[group]:g} nm; the "
                f"sensitivity is known from {table[0, 0]:g} to {table[-1, 0]:g} nm"
            )
    return np.asarray(matrix / matrix.max())


def luminous_efficacy_lm_w(wavelength_nm: float, width_nm: float | None = None) -> float:
    """Lumen per watt of an LED's light, a Gaussian spectrum as in `response` weighted with V."""
    grid, share = _spectrum(wavelength_nm, width_nm)
    wavelength, efficiency = LUMINOUS_EFFICIENCY.T
    seen = np.interp(grid, wavelength, efficiency, left=0.0, right=0.0)
    return float(PEAK_EFFICACY_LM_W * (share * seen).sum())


def _spectrum(peak_nm: float, width_nm: float | None) -> tuple[Array, Array]:
    """Wavelengths (nm) and the share of an LED's power at each; a width of None is typical of the colour."""
    sigma = (typical_width_nm(peak_nm) if width_nm is None else width_nm) / (2 * np.sqrt(2 * np.log(2)))
    # Midpoints far finer than the spectrum and any table; 5 sigma hold all but 6e-7 of the light.
    steps = (np.arange(4000) - 1999.5) / 400
    spectrum = np.exp(-0.5 * steps**2)
    return peak_nm + sigma * steps, spectrum / spectrum.sum()
