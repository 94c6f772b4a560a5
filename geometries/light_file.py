"""Photometric files of lamps, whichever of the two formats they have: IES LM-63 or EULUMDAT."""

import re
from pathlib import Path
from typing import NamedTuple

from geometries import eulumdat, ies
from geometries.intensity_table import IntensityTable, LightFileError

LARGEST_BYTES = 4_000_000
HEAD_OF_EULUMDAT = re.compile(
    r"[^\r\n]*(?:\r\n|\r|\n)\s*[0-4]\s*(?:\r\n|\r|\n)\s*[0-4]\s*(?:\r\n|\r|\n)\s*\d+\s"
)


class LightFile(NamedTuple):
    """Table of a photometric file, and which format it has: ies or ldt."""

    format: str
    table: IntensityTable


def read(path: Path, *, name: str) -> LightFile:
    """Read the intensity table of a photometric file; its content tells the format, not its name.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        What to call it in errors.

    Returns
    -------
    LightFile
        With the table as `geometries.ies.parse` and `geometries.eulumdat.parse` return it.

    Raises
    ------
    LightFileError
        If the file cannot be read or is not of these kinds; names file, line and rule.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise LightFileError(f"{name}: cannot be read: {error.strerror or error}") from None
    if len(content) > LARGEST_BYTES:
        raise LightFileError(
            f"{name}: has {len(content)} bytes, a photometric file has at most {LARGEST_BYTES}"
        )
    text = content.decode("latin-1")
    if HEAD_OF_EULUMDAT.match(text) or (path.suffix.lower() == ".ldt" and "TILT=" not in text.upper()):
        return LightFile("ldt", eulumdat.parse(text, name=name))
    return LightFile("ies", ies.parse(text, name=name))
