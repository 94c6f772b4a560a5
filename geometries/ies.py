"""Reader of IES LM-63 photometric files (editions 1986, 1991, 1995, 2002, 2019), type C, TILT=NONE.

Format: ANSI/IES LM-63-02, "Standard File Format for the Electronic Transfer of Photometric Data".
"""

from geometries.intensity_table import IntensityTable, LightFileError, Numbers, front

HEADERS = ("IESNA:LM-63-", "IESNA91", "IES:LM-63-")  # the edition of 1986 has no such line
PHOTOMETRY = {1: "C", 2: "B", 3: "A"}


def parse(text: str, *, name: str) -> IntensityTable:
    """Read the intensity table from the text of an IES file.

    Parameters
    ----------
    text : str
        Content of the file.
    name : str
        What to call it in errors.

    Returns
    -------
    IntensityTable
        The table. The file's vertical angle 0 is the normal of the emitting face, its horizontal angle 0 the
        direction along the row.

    Raises
    ------
    LightFileError
        If it is not of this kind; names file, line and rule.
    """
    lines = text.splitlines()
    start = _after_tilt(lines, name)
    numbers = Numbers(lines, start, name)
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
    azimuth = numbers.rising("horizontal angle", azimuth_count)
    if azimuth[0] != 0 or azimuth[-1] > 360:
        raise numbers.error(
            f"horizontal angles must run from 0 to 0, 90, 180 or 360 deg, "
            f"run {azimuth[0]:g} to {azimuth[-1]:g} deg"
        )
    candela = numbers.intensities("candela value", len(azimuth), len(polar))
    numbers.end()
    return front(polar, azimuth, candela, numbers)


def _after_tilt(lines: list[str], name: str) -> int:
    """Index of the first line after TILT=NONE."""
    if not lines:
        raise LightFileError(f"{name}, line 1: the file is empty")
    for index, line in enumerate(lines):
        stripped = line.strip().upper()
        if stripped.startswith("TILT="):
            tilt = stripped.removeprefix("TILT=").strip()
            if tilt != "NONE":
                raise LightFileError(f"{name}, line {index + 1}: TILT must be NONE, is {line.strip()[5:]!r}")
            return index + 1
        if index == 0 and stripped.startswith(("IES", "IESNA")) and not stripped.startswith(HEADERS):
            raise LightFileError(f"{name}, line 1: {line.strip()!r} is no known edition of LM-63")
    raise LightFileError(f"{name}, line {len(lines)}: no TILT= line up to the end: not an IES LM-63 file")
