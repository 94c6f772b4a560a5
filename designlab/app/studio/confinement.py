"""Files of the studio lie under the folder that it was started in, and nowhere else."""

import re
from pathlib import Path

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._-]{0,79}")


class OutsideFolder(ValueError):
    """A path that leads out of the folder of the studio."""


def inside(root: Path, name: str) -> Path:
    """Path of a name under a folder; links are followed before it is judged.

    Parameters
    ----------
    root : Path
        The folder of the studio.
    name : str
        Relative path, or an absolute one that lies there.

    Raises
    ------
    OutsideFolder
        If it lies elsewhere.
    """
    root = root.resolve()
    try:
        found = (root / name).resolve()
    except (OSError, ValueError, RuntimeError):
        raise OutsideFolder(f"{name[:80]!r}: is no path") from None
    if not found.is_relative_to(root):
        raise OutsideFolder(f"{name[:80]!r}: lies outside the folder that the studio was started in")
    return found


def new_file(root: Path, name: str, suffix: str) -> Path:
    """Path of a file to be written into the folder itself, its suffix added where it is missing.

    Raises
    ------
    OutsideFolder
        If the name is that of no plain file.
    """
    name = name.strip()
    stem = name.removesuffix(suffix)
    if not NAME.fullmatch(stem) or ".." in stem:
        raise OutsideFolder(
            f"name: must be letters, digits, spaces, dots, dashes or underscores, got {name[:80]!r}"
        )
    return inside(root, stem + suffix)


def files_below(root: Path, pattern: str) -> list[Path]:
    """Files whose name fits a pattern, to two levels down, each once; none that a link leads out to."""
    found = {path.resolve() for depth in ("", "*/", "*/*/") for path in root.glob(depth + pattern)}
    return sorted(path for path in found if path.is_relative_to(root.resolve()))


def shown(root: Path, path: Path) -> str:
    """The path as people read it: relative to the folder."""
    return path.resolve().relative_to(root.resolve()).as_posix()
