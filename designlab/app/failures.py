"""Whose a failure is, in one line: the user's input, the machine, or a defect of this program."""

import errno
import re
import traceback
from pathlib import Path
from typing import Literal, NamedTuple

OWN_PACKAGES = ("designlab", "geometries")
_ROOT = Path(__file__).parents[2]
_FILE = re.compile(r'^ *File "([^"]+)"', re.MULTILINE)
_TEMPORARY = re.compile(r"\.([^/]+)\.[0-9a-f]{8,32}\.partial")


class Failure(NamedTuple):
    """What an exception comes from, and what to tell the user of it."""

    cause: Literal["input", "machine", "defect"]
    text: str


def judged(error: Exception) -> Failure:
    """Say what an exception comes from; what our own modules raise on purpose is told as it is."""
    if isinstance(error, ValueError) and _is_ours(error):
        return Failure("input", one_line(error))
    if isinstance(error, OSError) and not isinstance(error, ImportError):
        return Failure("machine", _of_system(error))
    if isinstance(error, MemoryError):
        return Failure("machine", "out of memory; a smaller image, fewer samples or fewer workers need less")
    if isinstance(error, ModuleNotFoundError) and not str(error.name).startswith(OWN_PACKAGES):
        return Failure(
            "machine", f"the package {error.name} is missing; `designlab doctor` says how to get it"
        )
    if isinstance(error, RuntimeError) and _is_ours(error):
        return Failure("machine", one_line(error))
    what = f"{type(error).__name__}: {one_line(error)} ({_raised_in(error)})"
    return Failure("defect", f"a defect of designlab: {what}")


def one_line(error: BaseException) -> str:
    """Text of an exception without line breaks, its type where it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def _is_ours(error: Exception) -> bool:
    """Whether one of our modules raised an exception on purpose, rather than a library in its depths."""
    own_type = type(error).__module__.partition(".")[0] in OWN_PACKAGES
    return own_type or _raised_in(error).partition(".")[0] in OWN_PACKAGES


def _raised_in(error: Exception) -> str:
    """Name of the module where an exception was raised, in this process or in a worker."""
    # A worker's exception brings its traceback along as a text, the last file of which raised it.
    files = (
        _FILE.findall(str(error.__cause__)) if type(error.__cause__).__name__ == "_RemoteTraceback" else []
    )
    for package in OWN_PACKAGES if files else ():
        if Path(files[-1]).is_relative_to(_ROOT / package):
            return ".".join(Path(files[-1]).with_suffix("").relative_to(_ROOT).parts)
    if files:
        return Path(files[-1]).stem
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    return str(frames[-1].f_globals.get("__name__", "?")) if frames else "?"


def _of_system(error: OSError) -> str:
    text = error.strerror or str(error)
    if error.filename is not None and str(error.filename) not in text:
        text = f"{error.filename}: {text}"
    text = _TEMPORARY.sub(r"\1", text)  # what the user asked for, not the name it had while being written
    if error.errno == errno.ENOSPC:
        text += "; make room and run the same command again"
    return " ".join(text.split())
