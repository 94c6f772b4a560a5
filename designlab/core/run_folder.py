"""Folders of results: whose run they hold, what of it is finished, and what may be replaced.

A run marks its folder first, with a file that says what it is, and keeps each result in a file that appears
whole or not at all. The same run again goes on from what is there; another one is refused.
"""

import contextlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from designlab.core.store import is_partial, read_json, remove_partial, write_json, writing

_SHOWN = 40  # characters up to which a value is worth showing; digests are longer


def require_own(folder: str | Path, made_with: str) -> None:
    """Refuse a folder with content that no run has left there.

    Parameters
    ----------
    folder : path
        The folder; may be absent or empty.
    made_with : str
        File that a run leaves there.

    Raises
    ------
    ValueError
        If it is a file, or the folder holds something else.
    """
    path = Path(folder)
    _require_folder(path)
    if not (path / made_with).is_file() and path.is_dir() and not all(map(is_partial, path.iterdir())):
        raise ValueError(
            f"{path}: must be absent, empty or of an earlier run; it has files but no {made_with}"
        )


def require_writable(folder: str | Path, *, made_with: str | None = None) -> None:
    """Try to write into a folder for results, so that a long run does not end with a refusal.

    Parameters
    ----------
    folder : path
        The folder. It is there afterwards, unless `made_with` is given: then the run brings it.
    made_with : str, optional
        File that a run leaves there, see `require_own`; without it, other content is no obstacle.

    Raises
    ------
    ValueError
        If it is a file, or the folder holds something else.
    OSError
        If nothing can be written there; the text names the folder.
    """
    path = Path(folder)
    _require_folder(path)
    if made_with:
        require_own(path, made_with)
    made = [each for each in (path, *path.parents) if not each.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
        if made_with:  # input that is refused leaves nothing
            for each in made:
                each.rmdir()
    except OSError as error:
        raise OSError(error.errno, f"cannot write into {path}: {error.strerror or error}") from None


def claim(
    folder: Path,
    marker: str,
    run: Mapping[str, Any],
    *,
    kind: str,
    decided_by: Mapping[str, str],
    alone: bool = True,
) -> None:
    """Mark a folder as that of a run, and clear what a killed run left half-written there.

    Parameters
    ----------
    folder : Path
        The folder; it is made where it is absent.
    marker : str
        Name of the JSON file that says whose the folder is.
    run : mapping
        What it says.
    kind : str
        What such a run is called, as "a sweep".
    decided_by : mapping of str to str
        Fields that must be as they are there for the run to go on, and what to call one where a field is
        not, as "with another seed".
    alone : bool
        Whether a folder without the marker must be empty.

    Raises
    ------
    ValueError
        If it is a file, holds something else, or a run of which one of those fields differs.
    OSError
        If it cannot be written.
    """
    path, asked = folder / marker, _plain(run)
    _require_folder(folder)
    held = None
    if path.is_file():
        try:
            held = read_json(path)
        except ValueError as error:
            raise ValueError(
                f"{path}: must be JSON that {kind} wrote, is damaged; choose another folder ({error})"
            ) from None
        require_same(folder, held, asked, kind=kind, decided_by=decided_by)
    elif alone:
        require_own(folder, marker)
    remove_partial(folder)
    if held != asked:
        write_json(path, asked)


def require_same(
    place: Path,
    held: Mapping[str, Any],
    asked: Mapping[str, Any],
    *,
    kind: str,
    decided_by: Mapping[str, str],
) -> None:
    """Refuse what a file or folder holds of another run; see `claim`."""
    asked = _plain(asked)
    differing = [words for name, words in decided_by.items() if held.get(name) != asked[name]]
    if not differing:
        return
    shown = [f"{k} {v}" for k, v in held.items() if isinstance(v, str | int) and len(str(v)) < _SHOWN]
    told = f" ({', '.join(shown)})" if shown else ""
    raise ValueError(f"{place}: holds {kind} {' and '.join(differing)}{told}; choose another folder")


def resumed(path: Path, make: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
    """Result of a part of a run: read where an earlier run has kept it, else made and kept."""
    if not path.is_file():
        write_json(path, make())
    return read_json(path)


@contextlib.contextmanager
def locked(folder: Path, *, kind: str) -> Iterator[None]:
    """Hold a folder alone; the system lets go of it when this process ends, however it ends.

    Raises
    ------
    ValueError
        If it is a file.
    RuntimeError
        If another process holds it.
    OSError
        If it cannot be written.
    """
    import fcntl

    _require_folder(folder)
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder / ".lock", os.O_RDWR | os.O_CREAT, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RuntimeError(f"{folder}: another run of this {kind} is writing there") from None
        yield
    finally:
        os.close(descriptor)


def _plain(content: Mapping[str, Any]) -> dict[str, Any]:
    """Content as it is read back from a file, where tuples are lists."""
    plain: dict[str, Any] = json.loads(json.dumps(content))
    return plain


def _require_folder(path: Path) -> None:
    if path.exists() and not path.is_dir():
        raise ValueError(f"{path}: must be a folder, is a file")
