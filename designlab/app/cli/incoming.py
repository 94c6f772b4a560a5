"""Pictures to reconstruct: files, frames of videos, and files as a camera writes them into a folder."""

import glob
import hashlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.frames import SEVERAL, VIDEOS, frame_count, read_frames
from designlab.core.images import ImageError, read_picture
from designlab.core.types import Progress

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".npy", ".bmp", ".webp")
READ = (*PICTURES, *VIDEOS, *SEVERAL)
LOOK_S = 0.2  # between two looks into a watched folder
REST_S = 0.5  # for which a file must not grow to count as written
GIVE_UP_S = 5.0  # after which a file at rest that is no picture is refused

Known = Callable[[str, str], bool]
"""Tells of a key and a content whether the picture is done already."""


class Incoming(NamedTuple):
    """A picture that is to be reconstructed.

    Attributes
    ----------
    key : str
        Its file and the number of its frame.
    file : Path
        Its file.
    frame : int or None
        Its number in a video; None of a single picture.
    name : str
        Begins the names of what is written of it.
    content : str
        Digest of the file.
    read : callable
        Its values, from 0 to 1; raises ImageError where they cannot be read.
    """

    key: str
    file: Path
    frame: int | None
    name: str
    content: str
    read: Callable[[], NDArray[np.float32]]


def files_of(wanted: list[str]) -> list[Path]:
    """Files that are named, in folders, or that a pattern fits, each once.

    Raises
    ------
    ValueError
        If nothing is found; the text says under what.
    """
    found: list[Path] = []
    for text in wanted:
        path = Path(text)
        if path.is_dir():
            found += sorted(each for each in path.iterdir() if each.suffix.lower() in READ)
        elif path.is_file():
            found.append(path)
        else:
            matches = sorted(Path(each) for each in glob.glob(text) if os.path.isfile(each))
            if not matches:
                raise ValueError(f"PICTURES: {text}: no such file or folder, and no file fits the pattern")
            found += matches
    if not found:
        raise ValueError(f"PICTURES: no picture in {', '.join(wanted)} ({', '.join(READ)})")
    return list(dict.fromkeys(found))


def names_of(files: list[Path]) -> dict[Path, str]:
    """A name for the files of each picture; pictures of one name in several folders are numbered."""
    names: dict[Path, str] = {}
    for path in files:
        name, number = path.stem, 2
        while name in names.values():
            name, number = f"{path.stem}-{number}", number + 1
        names[path] = name
    return names


def counted_frames(files: list[Path]) -> dict[Path, int | None]:
    """Frames of each file that holds several pictures; None of single pictures and of what cannot be read."""
    counts: dict[Path, int | None] = {}
    for path in files:
        try:
            counts[path] = frame_count(path)
        except ImageError:
            counts[path] = None  # read_picture and read_frames say why
    return counts


def pictures_in(
    files: list[Path], counts: dict[Path, int | None], *, every: int, known: Known, progress: Progress
) -> Iterator[Incoming]:
    """Pictures of files that are not done yet, one after the other."""
    totals = {path: -(-(counts[path] or 1) // every) if counts[path] else 1 for path in files}
    total, done, names = sum(totals.values()), 0, names_of(files)
    for path in files:
        progress(path.name, done, total)
        content = digest_of(path)
        if counts[path] is None and path.suffix.lower() not in VIDEOS:
            if not known(str(path), content):
                yield still(path, names[path], content)
        else:
            yield from _frames(path, names[path], content, every, known, progress, done, total)
        done += totals[path]
    progress("page", total, total)


def still(path: Path, name: str, content: str) -> Incoming:
    """A file that holds one picture."""
    return Incoming(str(path), path, None, name, content, lambda: read_picture(path))


def _frames(
    path: Path,
    name: str,
    content: str,
    every: int,
    known: Known,
    progress: Progress,
    done: int,
    total: int,
) -> Iterator[Incoming]:
    def wanted(number: int) -> bool:
        progress(path.name, min(done + number // every, total), total)
        return number % every == 0 and not known(f"{path}#{number}", content)

    frames = read_frames(path, wanted)
    while True:
        try:
            number, image = next(frames)
        except StopIteration:
            return
        except ImageError as error:
            yield Incoming(str(path), path, None, name, content, _failing(error))
            return
        yield Incoming(f"{path}#{number}", path, number, f"{name}-{number:06d}", content, _held(path, image))


def _held(path: Path, image: NDArray[np.float32]) -> Callable[[], NDArray[np.float32]]:
    def values() -> NDArray[np.float32]:
        low, high = float(image.min()), float(image.max())
        if not (low >= 0 and high <= 1):
            raise ImageError(
                f"{path}: values must lie between 0 and 1, they run from {low:.4g} to {high:.4g}"
            )
        return image

    return values


def frame_again(path: Path, number: int) -> NDArray[np.float32]:
    """One frame of a file that holds several.

    Raises
    ------
    ImageError
        If it cannot be read.
    """
    for _, image in read_frames(path, lambda at: at == number):
        return image
    raise ImageError(f"{path}: has no frame {number}")


def watched(folder: Path, *, known: Known) -> Iterator[Incoming]:
    """Pictures in a folder as they are written, without end; a file is given once it has stopped growing.

    A file that is written anew is given again.
    """
    rested: dict[Path, tuple[tuple[int, int], float]] = {}  # size and time of change, and since when
    given: dict[Path, tuple[int, int]] = {}
    while True:
        for path in sorted(folder.iterdir(), key=_changed):
            if path.suffix.lower() not in PICTURES or path.name.startswith("."):
                continue
            try:
                status = path.stat()
            except FileNotFoundError:  # renamed since
                continue
            state, now = (status.st_size, status.st_mtime_ns), time.monotonic()
            if given.get(path) == state:
                continue
            if path not in rested or rested[path][0] != state:
                rested[path] = state, now
            rest_s = now - rested[path][1]
            if rest_s < REST_S or not status.st_size:
                continue
            try:
                content = digest_of(path)
                if not known(str(path), content):
                    image = read_picture(path)
                    yield Incoming(str(path), path, None, path.stem, content, _held(path, image))
            except FileNotFoundError:
                continue
            except ImageError as error:
                if rest_s < GIVE_UP_S:  # the camera may only have paused
                    continue
                yield Incoming(str(path), path, None, path.stem, content, _failing(error))
            given[path] = state
        time.sleep(LOOK_S)


def _failing(error: ImageError) -> Callable[[], NDArray[np.float32]]:
    def fail() -> NDArray[np.float32]:
        raise error

    return fail


def _changed(path: Path) -> tuple[int, str]:
    try:
        return path.stat().st_mtime_ns, path.name
    except FileNotFoundError:
        return 0, path.name


def digest_of(path: Path) -> str:
    """Digest of a file's content, however large."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
