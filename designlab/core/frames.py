"""Frames of video files, and of TIFF, GIF and other files that hold several pictures."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.image_files import ImageError, format_of, quiet, rows_columns_channels, type_full_scale

VIDEOS = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv")
SEVERAL = (".gif", ".apng")  # what is read frame by frame even where there is one
NEEDS_OPENCV = (
    "a video needs OpenCV: pip install 'designlab[video]'; or save its frames as pictures, or as a TIFF "
    "file of several pages"
)


def frame_count(path: Path) -> int | None:
    """Number of frames of a file; None of a single picture.

    Of some videos the container tells a number that is a little off.

    Raises
    ------
    ImageError
        If the file is absent or damaged, or is a video and OpenCV is missing.
    """
    suffix = path.suffix.lower()
    if suffix in VIDEOS:
        with _capture(path) as (capture, cv2):
            return int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    known = format_of(path)
    if known == "TIFF":
        with _pages(path) as pages:
            count = len(pages)
    elif suffix in SEVERAL or known == "WebP":
        count = _of_pillow(path)
    else:
        return None
    return count if count > 1 or suffix in SEVERAL else None


def read_frames(path: Path, wanted: Callable[[int], bool]) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Read frames one after the other, as shares of full scale, gamma unchanged and never turned.

    Parameters
    ----------
    path : Path
        A file of which `frame_count` tells a number.
    wanted : callable
        Of the number of a frame, from 0: whether it is given.

    Yields
    ------
    int
        Number of the frame.
    array of float32, shape (rows, columns, channels)
        Its values, from 0 to 1.

    Raises
    ------
    ImageError
        If the file is damaged, or its frames are no pictures of 1 or 3 channels.
    """
    suffix = path.suffix.lower()
    if suffix in VIDEOS:
        frames = _video_frames(path, wanted)
    elif suffix not in SEVERAL and format_of(path) == "TIFF":
        frames = _tiff_frames(path, wanted)
    else:
        frames = _pillow_frames(path, wanted)
    for number, values in frames:
        pixels = rows_columns_channels(values, f"{path}, frame {number}")
        yield number, pixels.astype(np.float32)


def import_opencv(path: Path) -> Any:
    """OpenCV, which reads videos.

    Raises
    ------
    ImageError
        If it is missing; the text says how to get it.
    """
    try:
        import cv2
    except ModuleNotFoundError:
        raise ImageError(f"{path}: {NEEDS_OPENCV}") from None
    return cv2


@contextmanager
def _capture(path: Path) -> Iterator[tuple[Any, Any]]:
    """A video opened by OpenCV, and OpenCV."""
    cv2 = import_opencv(path)
    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    capture = cv2.VideoCapture(str(path))
    try:
        if not capture.isOpened():
            raise ImageError(f"{path}: the video is damaged, or OpenCV knows no decoder for it")
        yield capture, cv2
    finally:
        capture.release()


def _video_frames(path: Path, wanted: Callable[[int], bool]) -> Iterator[tuple[int, NDArray[Any]]]:
    with _capture(path) as (capture, cv2):
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        number = 0
        while capture.grab():
            if wanted(number):
                there, frame = capture.retrieve()
                if there:
                    yield number, frame[..., ::-1] / np.float32(255)
            number += 1


@contextmanager
def _pages(path: Path) -> Iterator[list[Any]]:
    """Pages of a TIFF file, without those that are smaller copies of others."""
    import tifffile

    try:
        with quiet():
            file = tifffile.TiffFile(path)
    except (tifffile.TiffFileError, OSError) as error:
        raise ImageError(f"{path}: the file is damaged or of an unsupported kind ({error})") from error
    with file:
        with quiet():
            pages = [page for page in file.pages if not getattr(page, "is_reduced", False)]
        yield pages


def _tiff_frames(path: Path, wanted: Callable[[int], bool]) -> Iterator[tuple[int, NDArray[Any]]]:
    with _pages(path) as pages:
        for number, page in enumerate(pages):
            if not wanted(number):
                continue
            try:
                with quiet():
                    pixels = np.asarray(page.asarray())
            except (ValueError, OSError, IndexError) as error:
                raise ImageError(f"{path}, page {number}: {error}; save it without compression") from error
            if pixels.dtype.kind != "f":
                full = type_full_scale(pixels.dtype)
                if full is None:
                    raise ImageError(
                        f"{path}, page {number}: must hold unsigned integers of up to 16 bits, or floats, "
                        f"got {pixels.dtype}"
                    )
                pixels = pixels / np.float32(min(full, 2.0 ** page.aspage().bitspersample - 1))
            yield number, pixels


def _of_pillow(path: Path) -> int:
    from PIL import Image as Pillow

    try:
        with Pillow.open(path) as picture:
            return int(getattr(picture, "n_frames", 1))
    except (OSError, ValueError, SyntaxError) as error:
        raise ImageError(f"{path}: the file is damaged or of an unsupported kind ({error})") from error


def _pillow_frames(path: Path, wanted: Callable[[int], bool]) -> Iterator[tuple[int, NDArray[Any]]]:
    from PIL import Image as Pillow

    try:
        with Pillow.open(path) as picture:
            for number in range(getattr(picture, "n_frames", 1)):
                if wanted(number):
                    picture.seek(number)
                    yield number, np.asarray(picture.convert("RGB")) / np.float32(255)
    except (OSError, ValueError, SyntaxError) as error:
        raise ImageError(f"{path}: the file is damaged or of an unsupported kind ({error})") from error
