"""How an LED's light spreads over directions: a power of the cosine, or a measured table."""

import math
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from geometries.intensity_table import SYMMETRIES_DEG
from geometries.light_file import read
from geometries.spec import FOLDER, Spec, quantity

Array = NDArray[np.float64]


class AngularProfile(Spec):
    """Relative radiant intensity of a small emitting face over the half-space in front of it.

    Give at most one of: `exponent`; `beam_deg`; a table (`polar_deg`, `intensity` and, where the beam is not
    round, `azimuth_deg`); `ies` or `ldt`. Nothing at all is Lambert's cosine, exponent 1.
    """

    exponent: float | None = quantity(None, unit="1", ge=0, le=2e4)
    """m of an intensity proportional to cos(polar angle)^m; 1 is a Lambertian face."""
    beam_deg: float | None = quantity(None, unit="deg", ge=1, lt=180)
    """Full angle between the directions of half the axial intensity; sets the exponent."""
    polar_deg: tuple[float, ...] = Field((), max_length=2000)
    """Angles from the face's normal at which `intensity` is given, rising from 0 (deg); linear between them,
    dark beyond the last."""
    azimuth_deg: tuple[float, ...] = Field((), max_length=400)
    """Planes in which `intensity` is given, around the normal from the row's direction towards the membrane,
    rising from 0 to 90 (two mirror planes), 180 (one) or 360 (none); absent where the beam is round (deg)."""
    intensity: tuple[tuple[float, ...], ...] = Field((), max_length=400)
    """Relative intensity: one row for each azimuth, one value for each polar angle."""
    ies: str | None = Field(None, max_length=400)
    """IES LM-63 file, relative to the design's own file; it is read once and its table then kept in the
    design."""
    ldt: str | None = Field(None, max_length=400)
    """EULUMDAT file of the lamp instead, read in the same way."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, content: Any, info: ValidationInfo) -> Any:
        """Read the named file, unless its table is already there."""
        if not isinstance(content, dict):
            return content
        named = [content[field] for field in ("ies", "ldt") if isinstance(content.get(field), str)]
        if len(named) != 1:
            return content
        if any(content.get(name) for name in ("exponent", "beam_deg", "polar_deg", "intensity")):
            return content
        found = read(Path((info.context or {}).get(FOLDER, ".")) / named[0], name=named[0])
        kept = {name: value for name, value in content.items() if name not in ("ies", "ldt")}
        return kept | {found.format: named[0]} | found.table._asdict()

    @field_validator("intensity", mode="before")
    @classmethod
    def _rows(cls, value: Any) -> Any:
        """Take the plain list of a round beam for its only row."""
        if isinstance(value, list | tuple) and value and not isinstance(value[0], list | tuple):
            return (tuple(value),)
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        given = [name for name in ("exponent", "beam_deg") if getattr(self, name) is not None]
        table = bool(self.polar_deg or self.intensity or self.azimuth_deg)
        files = (self.ies is not None) + (self.ldt is not None)
        if len(given) + table > 1 or (given and files) or files > 1:
            raise ValueError("give one of exponent, beam_deg, a table (polar_deg, intensity), ies and ldt")
        if table:
            _require_angles("polar_deg", self.polar_deg, highest=90.0)
            if self.azimuth_deg:
                _require_angles("azimuth_deg", self.azimuth_deg, highest=360.0)
                if self.azimuth_deg[-1] not in SYMMETRIES_DEG:
                    raise ValueError(
                        f"azimuth_deg: must end at 90, 180 or 360 deg, ends at {self.azimuth_deg[-1]:g} deg"
                    )
            _require_rows(self.intensity, max(1, len(self.azimuth_deg)), len(self.polar_deg))
            if self.flux <= 0:
                raise ValueError("intensity: at least one value must be positive")
        return self

    @property
    def power(self) -> float | None:
        """Exponent of the cosine; None where the profile is a table."""
        if self.polar_deg:
            return None
        if self.beam_deg is not None:
            power = math.log(0.5) / math.log(math.cos(math.radians(self.beam_deg / 2)))
            return 1.0 if abs(power - 1.0) < 1e-9 else power
        return 1.0 if self.exponent is None else self.exponent

    @property
    def is_lambertian(self) -> bool:
        """Whether the face looks equally bright from everywhere."""
        return self.power == 1.0

    @property
    def planes(self) -> tuple[Array, Array]:
        """Table over the whole turn: azimuths 0 to 360 (deg), intensities of shape (azimuths, polar)."""
        rows = np.asarray(self.intensity, dtype=float)
        if not self.azimuth_deg:
            return np.array([0.0, 360.0]), np.repeat(rows, 2, axis=0)
        azimuth = np.asarray(self.azimuth_deg)
        while azimuth[-1] < 360.0:
            azimuth = np.concatenate([azimuth, 2 * azimuth[-1] - azimuth[-2::-1]])
            rows = np.concatenate([rows, rows[-2::-1]])
        return azimuth, rows

    @property
    def understood(self) -> dict[str, Any] | None:
        """What the file of the lamp was taken for, with its name; None where there is none."""
        file = self.ies or self.ldt
        if file is None or not self.polar_deg:
            return None
        turn = f"{len(self.azimuth_deg)} planes over {self.azimuth_deg[-1]:g} deg" if self.azimuth_deg else ""
        mean = np.asarray(self.intensity, dtype=float).mean(axis=0)
        below = np.flatnonzero(mean < mean[0] / 2)
        half = f"half the axial intensity before {self.polar_deg[below[0]]:g} deg" if below.size else "wide"
        return {
            "file": file,
            "as": f"{'IES LM-63' if self.ies else 'EULUMDAT'}, {turn or 'round beam'}, {half}",
            "size": [max(1, len(self.azimuth_deg)), len(self.polar_deg)],
            "unit": "deg",
        }

    @cached_property
    def flux(self) -> float:
        """Integral of the relative intensity over the half-space (sr).

        Linear pieces of I(t) = a + b t integrate to [-(a + b t) cos t + b sin t] over sin t dt, and the
        trapezoidal rule is exact over azimuth.
        """
        if self.power is not None:
            return 2 * math.pi / (self.power + 1)
        if len(self.polar_deg) < 2:
            return 0.0
        azimuth, rows = self.planes
        polar = np.radians(self.polar_deg)
        slope = np.diff(rows, axis=1) / np.diff(polar)
        ends = [-rows[:, k : len(polar) - 1 + k] * np.cos(polar[k : len(polar) - 1 + k]) for k in (0, 1)]
        zones = ends[1] - ends[0] + slope * np.diff(np.sin(polar))
        return float(np.trapezoid(zones.sum(axis=1), np.radians(azimuth)))

    def share_per_sr(self, polar_deg: ArrayLike, azimuth_deg: ArrayLike = 0.0) -> Array:
        """Intensity in given directions over the whole flux (1/sr); zero behind the face.

        Parameters
        ----------
        polar_deg, azimuth_deg : array_like
            Angle from the normal and angle around it from the row's direction towards the membrane (deg).
        """
        polar, turn = np.broadcast_arrays(
            np.asarray(polar_deg, dtype=float), np.asarray(azimuth_deg, dtype=float) % 360.0
        )
        if self.power is not None:
            cosine = np.where(polar < 90.0, np.cos(np.radians(polar)), 0.0)
            shape = np.where(polar <= 90.0, np.maximum(cosine, 0.0) ** self.power, 0.0)
        else:
            azimuth, rows = self.planes
            after = np.clip(np.searchsorted(azimuth, turn, side="right"), 1, len(azimuth) - 1)
            part = (turn - azimuth[after - 1]) / (azimuth[after] - azimuth[after - 1])
            nodes = np.asarray(self.polar_deg)
            upper = np.clip(np.searchsorted(nodes, polar, side="right"), 1, len(nodes) - 1)
            along = (polar - nodes[upper - 1]) / (nodes[upper] - nodes[upper - 1])
            first = rows[after - 1, upper - 1] * (1 - along) + rows[after - 1, upper] * along
            second = rows[after, upper - 1] * (1 - along) + rows[after, upper] * along
            shape = np.where(polar <= nodes[-1], first * (1 - part) + second * part, 0.0)
        return np.asarray(shape / self.flux)


def _require_angles(name: str, angles: tuple[float, ...], *, highest: float) -> None:
    if len(angles) < 2:
        raise ValueError(f"{name}: needs at least two angles, has {len(angles)}")
    if angles[0] != 0.0 or angles[-1] > highest:
        raise ValueError(
            f"{name}: must run from 0 to at most {highest:g} deg, runs {angles[0]:g} to {angles[-1]:g} deg"
        )
    for before, after in pairwise(angles):
        if after <= before:
            raise ValueError(f"{name}: must rise, {after:g} deg follows {before:g} deg")


def _require_rows(rows: tuple[tuple[float, ...], ...], planes: int, angles: int) -> None:
    if len(rows) != planes or any(len(row) != angles for row in rows):
        raise ValueError(
            f"intensity: needs {planes} row(s) of {angles} values, one row for each azimuth and one value "
            f"for each polar angle, has rows of {', '.join(str(len(row)) for row in rows) or 'nothing'}"
        )
    if negative := [value for row in rows for value in row if value < 0]:
        raise ValueError(f"intensity: must not be negative, got {negative[0]:g}")
