"""Spectra of LEDs, filters and cameras: how much each colour channel answers to each LED group."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from designlab.core.types import Array
from designlab.sensor.data import table
from geometries.spec import Spec
from geometries.spectrum import Filter, Spectrum, require_curves

WIDTHS_NM = ((490.0, 25.0), (560.0, 35.0), (1100.0, 20.0))
"""Typical full width at half maximum up to a peak wavelength: blue InGaN, green InGaN, red AlGaInP.

Source: Kingbright data sheet DSAO4460 (APTF1616LSEKJ3ZGKQBC), spectral bandwidth at 50 %. The red one also
stands for longer wavelengths (assumption).
"""

_TABLES = table("spectra")
LUMINOUS_EFFICIENCY: Array = np.array(_TABLES["luminous_efficiency"]["rows"], dtype=float)
"""Spectral luminous efficiency V for photopic vision: rows of wavelength (nm) and V."""
PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299792458.0  # exact, by the definition of the SI
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


class Curve(NamedTuple):
    """Published curve: rows of wavelength (nm) and value, and their source."""

    rows: tuple[tuple[float, float], ...]
    source: str


def _curves(kind: str) -> dict[str, Curve]:
    return {
        name: Curve(tuple(map(tuple, content["rows"])), content["source"].strip())
        for name, content in _TABLES[kind].items()
    }


EMISSION = _curves("emission")
"""Published spectra of white LEDs: relative power per nm."""
FILTERS = _curves("filters")
"""Published colour filters: transmittance."""
STEPS = 8000  # midpoints over a spectrum that is a table: steps of 0.05 nm over the visible range
UNKNOWN_SHARE = 0.01  # of what the camera sees of a group, that may lie beyond the table of a filter


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
        require_curves(self.wavelength_nm, channels)
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


def emission_rows(spectrum: Spectrum) -> Array:
    """Rows of wavelength (nm) and relative power per nm of a spectrum, by name or given.

    Raises
    ------
    ValueError
        If the name is unknown; the message lists the known ones.
    """
    return _rows(spectrum.name, spectrum.wavelength_nm, spectrum.power, EMISSION)


def filter_rows(colour_filter: Filter) -> Array:
    """Rows of wavelength (nm) and transmittance of a filter, by name or given.

    Raises
    ------
    ValueError
        If the name is unknown; the message lists the known ones.
    """
    return _rows(colour_filter.name, colour_filter.wavelength_nm, colour_filter.transmittance, FILTERS)


def response(
    sensitivity: Sensitivity,
    *,
    wavelength_nm: Sequence[float],
    width_nm: Sequence[float | None],
    spectra: Sequence[Spectrum | None] | None = None,
    filters: Sequence[Sequence[Filter]] | None = None,
) -> Array:
    """Response of each camera channel to the power of each LED group.

    The spectrum of a group is a Gaussian of power by wavelength, or its table. A sensitivity per photon is
    weighted by the wavelength, as a milliwatt of longer waves holds more photons.

    Parameters
    ----------
    sensitivity : Sensitivity
        The camera's.
    wavelength_nm, width_nm : sequence of float
        Peak and full width at half maximum of each group's spectrum; typical of the colour where None.
    spectra : sequence of Spectrum or None, optional
        Each group's spectrum where it is no Gaussian.
    filters : sequence of sequence of Filter, optional
        Filters that the light of each group passes; none when absent.

    Returns
    -------
    array, shape (3, groups)
        Rows R, G, B; the largest entry would be 1 without filters, since exposure sets the scale.

    Raises
    ------
    ValueError
        If a group's light lies outside the table, so that no channel answers to it, or outside that of a
        filter, or if a filter leaves nothing of it.
    """
    _, rows, _ = sensitivity.curves
    table = np.asarray(rows, dtype=float)
    matrix, seen = _answers(sensitivity, wavelength_nm, width_nm, spectra, filters)
    for group in range(matrix.shape[1]):
        light = f"LED group {group + 1}" + (
            "" if spectra and spectra[group] else f" at {wavelength_nm[group]:g} nm"
        )
        if matrix[:, group].max() < 1e-6 * table[:, 1:].max():
            raise ValueError(
                f"no channel answers to {light}; the "
                f"sensitivity is known from {table[0, 0]:g} to {table[-1, 0]:g} nm"
            )
        if seen[:, group].max() < 1e-6 * table[:, 1:].max():
            raise ValueError(f"no channel answers to {light}; its filters pass less than 1e-6 of it")
    return np.asarray(seen / matrix.max())


def _answers(
    sensitivity: Sensitivity,
    wavelength_nm: Sequence[float],
    width_nm: Sequence[float | None],
    spectra: Sequence[Spectrum | None] | None,
    filters: Sequence[Sequence[Filter]] | None,
) -> tuple[Array, Array]:
    """Answers of the channels to each group without and with filters, on the scale of the sensitivity."""
    per, rows, _ = sensitivity.curves
    table = np.asarray(rows, dtype=float)
    columns, filtered = [], []
    for group, (peak, width) in enumerate(zip(wavelength_nm, width_nm, strict=True)):
        grid, share = _light(peak, width, spectra[group] if spectra else None)
        weight = share * (grid / 550.0 if per == "photon" else 1.0)
        curves = [np.interp(grid, table[:, 0], table[:, k], left=0.0, right=0.0) for k in (1, 2, 3)]
        columns.append([float((curve * weight).sum()) for curve in curves])
        if filters and filters[group]:
            passed = weight * _passed(grid, np.sum(curves, axis=0) * weight, filters[group], group)
            filtered.append([float((curve * passed).sum()) for curve in curves])
        else:
            filtered.append(columns[-1])
    return np.array(columns).T, np.array(filtered).T


def electrons_per_j(wavelength_nm: float) -> float:
    """Photons in a joule of light."""
    return wavelength_nm * 1e-9 / (PLANCK_J_S * LIGHT_M_S)


def peak_electrons_per_j(
    sensitivity: Sensitivity,
    *,
    wavelength_nm: Sequence[float],
    width_nm: Sequence[float | None],
    spectra: Sequence[Spectrum | None] | None = None,
) -> float:
    """Electrons per joule where `response` without filters is 1, of a sensor of quantum efficiency 1.

    The efficiency is that where the sensitivity is highest; parameters as in `response`.
    """
    per, rows, _ = sensitivity.curves
    table = np.asarray(rows, dtype=float)
    best = int(table[:, 1:].max(axis=1).argmax())
    reference_nm = 550.0 if per == "photon" else float(table[best, 0])
    answers, _ = _answers(sensitivity, wavelength_nm, width_nm, spectra, None)
    return float(electrons_per_j(reference_nm) * answers.max() / table[best, 1:].max())


def _rows(
    name: str | None, wavelength_nm: Sequence[float], values: Sequence[float], known: Mapping[str, Curve]
) -> Array:
    if wavelength_nm:
        return np.column_stack([wavelength_nm, values])
    if name is None or name not in known:
        raise ValueError(f"name: unknown {name!r}; known are {', '.join(known)}")
    return np.array(known[name].rows, dtype=float)


def _passed(grid: Array, seen: Array, filters: Sequence[Filter], group: int) -> Array:
    """Share of the light that filters pass at each wavelength; `seen` is what a camera sees without them."""
    passed = np.ones(len(grid))
    for each in filters:
        wavelength, transmittance = filter_rows(each).T
        beyond = float(seen[(grid < wavelength[0]) | (grid > wavelength[-1])].sum() / max(seen.sum(), 1e-300))
        if beyond > UNKNOWN_SHARE:
            raise ValueError(
                f"filter {each.name or 'of the table'} is known from {wavelength[0]:g} to "
                f"{wavelength[-1]:g} nm, {beyond:.2g} of what the camera sees of LED group {group + 1} "
                "lies beyond; extend the table"
            )
        passed *= np.interp(grid, wavelength, transmittance)
    return passed


def luminous_efficacy_lm_w(wavelength_nm: float, width_nm: float | None = None) -> float:
    """Lumen per watt of an LED's light, a Gaussian spectrum as in `response` weighted with V."""
    grid, share = _spectrum(wavelength_nm, width_nm)
    wavelength, efficiency = LUMINOUS_EFFICIENCY.T
    seen = np.interp(grid, wavelength, efficiency, left=0.0, right=0.0)
    return float(PEAK_EFFICACY_LM_W * (share * seen).sum())


def _light(peak_nm: float, width_nm: float | None, spectrum: Spectrum | None) -> tuple[Array, Array]:
    """Wavelengths (nm) and the share of an LED's power at each: of its table, or a Gaussian."""
    if spectrum is None:
        return _spectrum(peak_nm, width_nm)
    wavelength, power = emission_rows(spectrum).T
    edges = np.linspace(wavelength[0], wavelength[-1], STEPS + 1)
    grid = (edges[:-1] + edges[1:]) / 2
    share = np.interp(grid, wavelength, power)
    return grid, share / share.sum()


def _spectrum(peak_nm: float, width_nm: float | None) -> tuple[Array, Array]:
    """Wavelengths (nm) and the share of an LED's power at each; a width of None is typical of the colour."""
    sigma = (typical_width_nm(peak_nm) if width_nm is None else width_nm) / (2 * np.sqrt(2 * np.log(2)))
    # Midpoints far finer than the spectrum and any table; 5 sigma hold all but 6e-7 of the light.
    steps = (np.arange(4000) - 1999.5) / 400
    spectrum = np.exp(-0.5 * steps**2)
    return peak_nm + sigma * steps, spectrum / spectrum.sum()
