"""Reader of EULUMDAT photometric files (.ldt).

Format: A. Stockmar, "EULUMDAT - ein Leuchtendatenformat für den europäischen Beleuchtungsplaner", 1990.
There is one value a line: the head of 26 lines, six lines for each set of lamps, ten direct ratios; then the
angles of the C planes, the angles in them, and the intensities (cd/klm) plane by plane, without those that
symmetry gives.
"""

import re

import numpy as np
from numpy.typing import NDArray

from geometries.intensity_table import IntensityTable, LightFileError, Numbers, front

HEAD = 26  # lines before the sets of lamps
LINES_A_SET, RATIOS = 6, 10
SYMMETRIES = {
    0: "none",
    1: "round the axis",
    2: "to the plane C0-C180",
    3: "to the plane C90-C270",
    4: "to both planes",
}
PLANES_DIVIDE_BY = {0: 1, 1: 1, 2: 2, 3: 4, 4: 4}
MOST_SETS = 20


def parse(text: str, *, name: str) -> IntensityTable:
    """Read the intensity table from the text of a EULUMDAT file.

    Parameters
    ----------
    text : str
        Content of the file.
    name : str
        What to call it in errors.

    Returns
    -------
    IntensityTable
        The table. The file's gamma 0 is the normal of the emitting face, its plane C0 the direction along the
        row.

    Raises
    ------
    LightFileError
        If it is not of this kind; names file, line and rule.
    """
    # A comma is a decimal one: each line holds one value. str.splitlines would also break at signs of names.
    lines = [line.replace(",", ".") for line in re.split(r"\r\n|\r|\n", text)]
    if len(lines) <= HEAD:
        raise LightFileError(f"{name}, line {len(lines)}: the head of a EULUMDAT file has {HEAD} lines")
    symmetry = _whole(lines, 3, "symmetry (Isym)", 0, 4, name)
    planes = _whole(lines, 4, "number of C planes (Mc)", 1, 721, name)
    angles = _whole(lines, 6, "number of intensities in a plane (Ng)", 2, 2000, name)
    if planes % PLANES_DIVIDE_BY[symmetry]:
        raise LightFileError(
            f"{name}, line 4: with symmetry {SYMMETRIES[symmetry]} the number of C planes (Mc) must "
            f"divide by {PLANES_DIVIDE_BY[symmetry]}, is {planes}"
        )
    tilt = _number(lines, 25, "tilt of the lamp when measured", name)
    if tilt != 0:
        raise LightFileError(f"{name}, line 25: tilt of the lamp when measured must be 0, is {tilt:g} deg")
    sets = _whole(lines, HEAD, "number of sets of lamps", 0, MOST_SETS, name)
    numbers = Numbers(lines, HEAD + LINES_A_SET * sets, name)
    for _ in range(RATIOS):
        numbers.take("direct ratio")
    turn = numbers.rising("angle of a C plane", planes)
    if turn[0] != 0 or turn[-1] >= 360:
        raise numbers.error(
            f"angles of C planes must run from 0 to below 360 deg, run {turn[0]:g} to {turn[-1]:g} deg"
        )
    polar = numbers.rising("angle gamma", angles)
    stored = {0: planes, 1: 1, 2: planes // 2 + 1, 3: planes // 2 + 1, 4: planes // 4 + 1}[symmetry]
    candela = numbers.intensities("intensity", stored, angles)
    azimuth = (turn[3 * planes // 4 :] + turn[: planes // 4 + 1]) if symmetry == 3 else turn[:stored]
    last = {2: 180.0, 4: 90.0}.get(symmetry, azimuth[-1])
    if azimuth[-1] != last:
        raise numbers.error(
            f"with symmetry {SYMMETRIES[symmetry]} the stored planes must end at C{last:g}, end at "
            f"C{azimuth[-1]:g}"
        )
    if symmetry == 3:
        azimuth, candela = _whole_turn(azimuth, candela, numbers)
    if symmetry == 0 and planes == 1:
        raise numbers.error("a single C plane needs symmetry round the axis (Isym 1)")
    if symmetry == 0:
        azimuth, candela = [*azimuth, 360.0], np.concatenate([candela, candela[:1]])
    return front(polar, azimuth, candela, numbers)


def _whole_turn(
    azimuth: list[float], candela: NDArray[np.float64], numbers: Numbers
) -> tuple[list[float], NDArray[np.float64]]:
    """Planes from 0 to 360 deg, of those from C270 over C0 to C90 and their mirror images."""
    if azimuth[0] != 270 or azimuth[-1] != 90:
        raise numbers.error(
            f"with symmetry {SYMMETRIES[3]} the stored planes must run from C270 to C90, run from "
            f"C{azimuth[0]:g} to C{azimuth[-1]:g}"
        )
    half = [angle - 360.0 if angle >= 270.0 else angle for angle in azimuth]
    rows = {angle % 360.0: row for angle, row in zip(half, candela, strict=True)}
    rows |= {180.0 - angle: row for angle, row in zip(half, candela, strict=True)}
    rows[360.0] = rows[0.0]
    turn = sorted(rows)
    return turn, np.array([rows[angle] for angle in turn])


def _number(lines: list[str], line: int, what: str, name: str) -> float:
    """Return the number that a line of the head holds."""
    text = lines[line - 1].strip()
    try:
        value = float(text or "nan")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise LightFileError(f"{name}, line {line}: {what} must be a number, is {text!r}")
    return value


def _whole(lines: list[str], line: int, what: str, low: int, high: int, name: str) -> int:
    """Return the whole number that a line of the head holds."""
    value = _number(lines, line, what, name)
    if value != int(value) or not low <= value <= high:
        raise LightFileError(
            f"{name}, line {line}: {what} must be a whole number from {low} to {high}, is {value:g}"
        )
    return int(value)
