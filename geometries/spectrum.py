"""Spectra as tables: what an LED emits by wavelength, and what a colour filter lets through."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Self

from pydantic import Field, model_validator

from geometries.spec import Spec

SHORTEST_NM, LONGEST_NM = 100.0, 3000.0  # beyond, a table is rather in another unit


def require_curves(wavelength_nm: Sequence[float], columns: Mapping[str, Sequence[float]]) -> None:
    """Refuse a table that holds no curves over wavelengths; each column is named as its field.

    Raises
    ------
    ValueError
        Naming field, rule and value.
    """
    if len(wavelength_nm) < 2:
        raise ValueError("wavelength_nm: a table needs at least two wavelengths, or give a name")
    for before, after in pairwise(wavelength_nm):
        if after <= before:
            raise ValueError(f"wavelength_nm: must rise, {after:g} nm follows {before:g} nm")
    if wavelength_nm[0] < SHORTEST_NM or wavelength_nm[-1] > LONGEST_NM:
        raise ValueError(
            f"wavelength_nm: must lie between {SHORTEST_NM:g} and {LONGEST_NM:g} nm, "
            f"runs from {wavelength_nm[0]:g} to {wavelength_nm[-1]:g}"
        )
    for field, values in columns.items():
        if len(values) != len(wavelength_nm):
            raise ValueError(
                f"{field}: needs a value for each of the {len(wavelength_nm)} wavelengths, has {len(values)}"
            )
        if min(values) < 0 or not any(values):
            raise ValueError(f"{field}: must not be negative, and somewhere positive")


class _Curve(Spec):
    """A curve over wavelengths: a published one by name, or a table."""

    name: str | None = Field(
        None,
        min_length=1,
        max_length=80,
        description="Name of a published one, or of the table that is given.",
    )
    wavelength_nm: tuple[float, ...] = Field(
        (), max_length=4000, description="Rising wavelengths of a table (nm); linear between them."
    )

    @model_validator(mode="before")
    @classmethod
    def _named(cls, content: Any) -> Any:
        """Take a plain string for the name."""
        return {"name": content} if isinstance(content, str) else content

    def _check(self, field: str, values: tuple[float, ...]) -> None:
        """Refuse a table that is no curve; `values` are of `field`."""
        if not self.wavelength_nm and not values:
            if self.name is None:
                raise ValueError("name: needed where no table is given; known ones are in the catalogue")
            return
        require_curves(self.wavelength_nm, {field: values})


class Spectrum(_Curve):
    """Spectrum of an LED's light, for one that is no narrow peak: white by phosphor, for example."""

    power: tuple[float, ...] = Field(
        (),
        max_length=4000,
        description="Relative power per nm at each wavelength; dark beyond the table's ends.",
    )

    @model_validator(mode="after")
    def _sound(self) -> Self:
        self._check("power", self.power)
        return self


class Filter(_Curve):
    """A colour filter: the share of the light that passes, by wavelength, the same at every angle."""

    transmittance: tuple[float, ...] = Field(
        (), max_length=4000, description="Share of the light that passes at each wavelength, 0 to 1."
    )

    @model_validator(mode="after")
    def _sound(self) -> Self:
        self._check("transmittance", self.transmittance)
        if self.transmittance and max(self.transmittance) > 1:
            raise ValueError(
                f"transmittance: lies between 0 and 1, got {max(self.transmittance):g}; divide percent by 100"
            )
        return self
