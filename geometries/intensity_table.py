"""Tables of relative intensity that photometric files hold, and reading their numbers."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BEHIND = 0.01  # share of the light beyond 90 deg that may be cut off: a flat face sends none there
SYMMETRIES_DEG = (90.0, 180.0, 360.0)  # where planes may end: two mirror planes, one, none


class LightFileError(ValueError):
    """A photometric file that cannot be used; the text names file, line and rule."""


class IntensityTable(NamedTuple):
    """Relative intensity over the front half-space.

    Polar angles from the normal of the emitting face and azimuths from the direction along the row (deg; none
    of a round beam), and a row of intensities for each azimuth.
    """

    polar_deg: tuple[float, ...]
    azimuth_deg: tuple[float, ...]
    intensity: tuple[tuple[float, ...], ...]


class Numbers:
    """The numbers of a file, one after another, whatever the line breaks; remembers the line for errors.

    Parameters
    ----------
    lines : list of str
        Lines of the file.
    start : int
        Index of the first line with numbers.
    name : str
        What to call the file in errors.
    """

    def __init__(self, lines: list[str], start: int, name: str) -> None:
        self.line, self.name = start, name
        self._tokens = self._split(lines, start)

    def _split(self, lines: list[str], start: int) -> Iterator[str]:
        for index in range(start, len(lines)):
            for token in lines[index].replace(",", " ").split():
                self.line = index + 1
                yield token

    def error(self, rule: str) -> LightFileError:
        """Return an error at the present line."""
        return LightFileError(f"{self.name}, line {self.line}: {rule}")

    def take(self, what: str) -> float:
        """Return the next number."""
        token = next(self._tokens, None)
        if token is None:
            raise self.error(f"the file ends where a number is due ({what})")
        try:
            value = float(token)
        except ValueError:
            raise self.error(f"{what} must be a number, is {token!r}") from None
        if not np.isfinite(value):
            raise self.error(f"{what} must be finite, is {token!r}")
        return value

    def count(self, what: str, low: int, high: int) -> int:
        """Return the next number, a whole one between two bounds."""
        value = self.take(what)
        if value != int(value) or not low <= value <= high:
            raise self.error(f"{what} must be a whole number from {low} to {high}, is {value:g}")
        return int(value)

    def rising(self, what: str, count: int) -> list[float]:
        """Return the next numbers, each above the one before."""
        values: list[float] = []
        for _ in range(count):
            value = self.take(what)
            if values and value <= values[-1]:
                raise self.error(f"{what}s must rise, {value:g} deg follows {values[-1]:g} deg")
            values.append(value)
        return values

    def intensities(self, what: str, planes: int, angles: int) -> NDArray[np.float64]:
        """Return the next numbers as a table of intensities, shape (planes, angles)."""
        table = np.array([[self.take(what) for _ in range(angles)] for _ in range(planes)])
        if (table < 0).any():
            raise self.error(f"{what}s must not be negative, one is {table.min():g}")
        if not table.any():
            raise self.error(f"{what}s must not all be zero")
        return table

    def end(self) -> None:
        """Require that nothing follows."""
        token = next(self._tokens, None)
        if token is not None:
            raise self.error(f"the table is complete, but {token!r} follows")


def front(
    polar: list[float], azimuth: list[float], candela: NDArray[np.float64], numbers: Numbers
) -> IntensityTable:
    """Cut a table of intensities, shape (azimuths, polar angles), at 90 deg and close its turn."""
    angle = np.array(polar)
    if angle[0] != 0 or angle[-1] > 180:
        raise numbers.error(
            f"vertical angles must run from 0 to 90 or 180 deg, run {angle[0]:g} to {angle[-1]:g} deg"
        )
    if angle[-1] > 90.0 and 90.0 not in angle:
        edge = [float(np.interp(90.0, angle, row)) for row in candela]
        place = int(np.searchsorted(angle, 90.0))
        angle, candela = np.insert(angle, place, 90.0), np.insert(candela, place, edge, axis=1)
    ahead = angle <= 90.0
    weight = candela.mean(axis=0) * np.sin(np.radians(angle))
    whole = float(np.trapezoid(weight, angle))
    behind = (whole - float(np.trapezoid(weight[ahead], angle[ahead]))) / max(whole, 1e-300)
    if behind > BEHIND:
        raise numbers.error(
            f"{behind:.1%} of the light lies beyond 90 deg, an LED's face sends none there "
            f"(up to {BEHIND:.0%} is cut off)"
        )
    angle, candela = angle[ahead], candela[:, ahead]
    if 180.0 < azimuth[-1] < 360.0:
        # Many files leave out the plane at 360 deg, which repeats the one at 0.
        azimuth, candela = [*azimuth, 360.0], np.concatenate([candela, candela[:1]])
    if azimuth[-1] not in (0.0, *SYMMETRIES_DEG):
        raise numbers.error(
            f"horizontal angles must end at 0, 90, 180 or 360 deg, end at {azimuth[-1]:g} deg"
        )
    return IntensityTable(
        polar_deg=tuple(float(a) for a in angle),
        azimuth_deg=() if len(azimuth) == 1 else tuple(azimuth),
        intensity=tuple(tuple(float(v) for v in row) for row in candela),
    )
