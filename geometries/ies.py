"""Reader of IES LM-63 photometric files (editions 1986, 1991, 1995, 2002, 2019), type C, TILT=NONE.

Format: ANSI/IES LM-63-02, "Standard File Format for the Electronic Transfer of Photometric Data".
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

HEADERS = ("IESNA:LM-63-", "IESNA91", "IES:LM-63-")  # the edition of 1986 has no such line
BEHIND = 0.01  # share of the light beyond 90 deg that may be cut off: a flat face sends none there
LARGEST_BYTES = 4_000_000
SYMMETRIES_DEG = (90.0, 180.0, 360.0)  # where planes may end: two mirror planes, one, none
PHOTOMETRY = {1: "C", 2: "B", 3: "A"}


class IesError(ValueError):
    """An IES file that cannot be used; the text names file, line and rule."""


class IntensityTable(NamedTuple):
    """Relative intensity over the front half-space.

    Polar angles from the normal of the emitting face and azimuths from the direction along the row (deg; none
    of a round beam), and a row of intensities for each azimuth.
    """

    polar_deg: tuple[float, ...]
    azimuth_deg: tuple[float, ...]
    intensity: tuple[tuple[float, ...], ...]


def read(path: Path, *, name: str) -> IntensityTable:
    """Read the intensity table of an IES file.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        What to call it in errors.

    Returns
    -------
    IntensityTable
        The table. The file's vertical angle 0 is the normal of the emitting face, its horizontal angle 0 the
        direction along the row.

    Raises
    ------
    IesError
        If the file cannot be read or is not of this kind; names file, line and rule.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise IesError(f"{name}: cannot be read: {error.strerror or error}") from None
    if len(content) > LARGEST_BYTES:
        raise IesError(f"{name}: has {len(content)} bytes, an IES file has at most {LARGEST_BYTES}")
    return parse(content.decode("latin-1"), name=name)


def parse(text: str, *, name: str) -> IntensityTable:
    """Read the intensity table from the text of an IES file; see `read`."""
    lines = text.splitlines()
    start = _after_tilt(lines, name)
    numbers = _Numbers(lines, start, name)
    numbers.take("number of lamps")
    numbers.take("lumens per lamp")
    if numbers.take("candela multiplier") <= 0:
        raise numbers.error("the candela multiplier must be positive")
    polar_count = numbers.count("number of vertical angles", 2, 2000)
    azimuth_count = numbers.count("number of horizontal angles", 1, 400)
    kind = numbers.count("photometric type", 1, 3)
    if kind != 1:
        raise numbers.error(f"photometry must be of type C (1), is type {PHOTOMETRY[kind]} ({kind})")
    for what in ("units type", "width", "length", "height", "ballast factor", "future use", "input watts"):
        numbers.take(what)
    polar = numbers.rising("vertical angle", polar_count)
    if polar[0] != 0 or polar[-1] > 180:
        raise numbers.error(
            f"vertical angles must run from 0 to 90 or 180 deg, run {polar[0]:g} to {polar[-1]:g} deg"
        )
    azimuth = numbers.rising("horizontal angle", azimuth_count)
    if azimuth[0] != 0 or azimuth[-1] > 360:
        raise numbers.error(
            f"horizontal angles must run from 0 to 0, 90, 180 or 360 deg, "
            f"run {azimuth[0]:g} to {azimuth[-1]:g} deg"
        )
    candela = np.array([[numbers.take("candela value") for _ in polar] for _ in azimuth])
    if (candela < 0).any():
        raise numbers.error(f"candela values must not be negative, one is {candela.min():g}")
    if not candela.any():
        raise numbers.error("candela values must not all be zero")
    numbers.end()
    return _front(polar, azimuth, candela, numbers)


def _after_tilt(lines: list[str], name: str) -> int:
    """Index of the first line after TILT=NONE."""
    if not lines:
        raise IesError(f"{name}, line 1: the file is empty")
    for index, line in enumerate(lines):
        stripped = line.strip().upper()
        if stripped.startswith("TILT="):
            tilt = stripped.removeprefix("TILT=").strip()
            if tilt != "NONE":
                raise IesError(f"{name}, line {index + 1}: TILT must be NONE, is {line.strip()[5:]!r}")
            return index + 1
        if index == 0 and stripped.startswith(("IES", "IESNA")) and not stripped.startswith(HEADERS):
            raise IesError(f"{name}, line 1: {line.strip()!r} is no known edition of LM-63")
    raise IesError(f"{name}, line {len(lines)}: no TILT= line up to the end: not an IES LM-63 file")


def _front(
    polar: list[float], azimuth: list[float], candela: np.ndarray, numbers: "_Numbers"
) -> IntensityTable:
    """Cut the table at 90 deg and close its turn."""
    angle = np.array(polar)
    if angle[-1] > 90.0 and 90.0 not in angle:
        edge = [float(np.interp(90.0, angle, row)) for row in candela]
        place = int(np.searchsorted(angle, 90.0))
        angle, candela = np.insert(angle, place, 90.0), np.insert(candela, place, edge, axis=1)
    front = angle <= 90.0
    weight = candela.mean(axis=0) * np.sin(np.radians(angle))
    whole = float(np.trapezoid(weight, angle))
    behind = (whole - float(np.trapezoid(weight[front], angle[front]))) / max(whole, 1e-300)
    if behind > BEHIND:
        raise numbers.error(
            f"{behind:.1%} of the light lies beyond 90 deg, an LED's face sends none there "
            f"(up to {BEHIND:.0%} is cut off)"
        )
    angle, candela = angle[front], candela[:, front]
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


class _Numbers:
    """The numbers of a file, one after another, whatever the line breaks; remembers the line for errors."""

    def __init__(self, lines: list[str], start: int, name: str) -> None:
        self.line, self.name = start, name
        self._tokens = self._split(lines, start)

    def _split(self, lines: list[str], start: int) -> Iterator[str]:
        for index in range(start, len(lines)):
            for token in lines[index].replace(",", " ").split():
                self.line = index + 1
                yield token

    def error(self, rule: str) -> IesError:
        """Return an error at the present line."""
        return IesError(f"{self.name}, line {self.line}: {rule}")

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

    def end(self) -> None:
        """Require that nothing follows."""
        token = next(self._tokens, None)
        if token is not None:
            raise self.error(f"the table is complete, but {token!r} follows")
