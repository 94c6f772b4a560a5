"""Files as cameras write them: JPEG, PNG, TIFF, EXR, PGM, NumPy arrays, and raw files through rawpy."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.images import ImageError, read_counts
from designlab.core.types import Array

RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef")
SUFFIXES = (".exr", ".png", ".tif", ".tiff", ".jpg", ".jpeg", ".pgm", ".ppm", ".npy", *RAW_SUFFIXES)
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
ORIENTATION = 0x0112  # EXIF tag


@dataclass(frozen=True, eq=False)
class CameraFile:
    """Values of one file as the camera wrote them.

    Attributes
    ----------
    counts : array, shape (rows, columns, channels)
        Stored values.
    white : float
        Value of full scale: that of the file's type, or what a raw file states; 1 for floats.
    black : array, shape (3,), or None
        Values without light that a raw file states.
    bayer : str or None
        Colours of the four pixels at the upper left, row by row, where the file states them.
    encoded : bool
        Whether the format is one that holds pictures for eyes (JPEG).
    turned : bool
        Whether the file asks viewers to turn it; `counts` are not turned.
    """

    counts: Array
    white: float
    black: Array | None = None
    bayer: str | None = None
    encoded: bool = False
    turned: bool = False


def read_camera_file(path: str | Path) -> CameraFile:
    """Read a file of a camera without any change of its values.

    Raises
    ------
    ImageError
        If it cannot be read.
    RuntimeError
        For a raw file without rawpy.
    """
    path = Path(path)
    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ImageError(f"{path}: suffix must be one of {' '.join(SUFFIXES)}, got {suffix!r}")
    if suffix in RAW_SUFFIXES:
        return _raw(path)
    with path.open("rb") as file:
        magic = file.read(6)
    if magic.startswith(b"\xff\xd8\xff"):
        return _jpeg(path)
    if re.match(rb"P[56]\s", magic):
        return _pnm(path)
    counts = _npy(path) if magic == b"\x93NUMPY" else read_counts(path)
    if counts.ndim == 2:
        counts = counts[..., None]
    if (
        counts.ndim != 3
        or counts.shape[-1] not in (1, 3)
        or 0 in counts.shape
        or counts.dtype.kind not in "uf"
    ):
        raise ImageError(
            f"{path}: must hold rows, columns and 1 or 3 channels of unsigned integers or floats, got shape "
            f"{counts.shape} of {counts.dtype}"
        )
    if not np.isfinite(counts).all():
        raise ImageError(f"{path}: values must be finite")
    white = 1.0 if counts.dtype.kind == "f" else float(np.iinfo(counts.dtype).max)
    return CameraFile(counts.astype(float), white)


def superpixels(mosaic: Array, pattern: str) -> Array:
    """Turn a Bayer mosaic into a picture of half its size: one pixel of red, green (mean of two), blue.

    Nothing is made up between samples; the channels of a pixel are seen half a raw pixel apart.

    Parameters
    ----------
    mosaic : array, shape (rows, columns)
        Linear values; an odd last row or column is dropped.
    pattern : str
        Colours of the four pixels at the upper left, row by row.
    """
    sites: dict[str, list[Array]] = {"R": [], "G": [], "B": []}
    rows, columns = mosaic.shape[0] // 2 * 2, mosaic.shape[1] // 2 * 2
    for place, colour in enumerate(pattern):
        sites[colour].append(mosaic[place // 2 : rows : 2, place % 2 : columns : 2])
    return np.stack([np.mean(sites[colour], axis=0) for colour in "RGB"], axis=-1)


def _jpeg(path: Path) -> CameraFile:
    from PIL import Image as Pillow

    try:
        with Pillow.open(path) as picture:
            turned = picture.getexif().get(ORIENTATION, 1) != 1
            counts = np.asarray(picture.convert("L" if picture.mode == "L" else "RGB"), dtype=float)
    except (OSError, SyntaxError) as error:
        raise ImageError(f"{path}: the file is damaged or of an unsupported kind ({error})") from None
    return CameraFile(counts[..., None] if counts.ndim == 2 else counts, 255.0, encoded=True, turned=turned)


def _pnm(path: Path) -> CameraFile:
    """Netpbm's binary formats; their full scale may be any number up to 65535."""
    content = path.read_bytes()
    header = re.match(rb"P([56])\s+(?:#[^\n]*\n\s*)*(\d+)\s+(\d+)\s+(\d+)\s", content)
    if header is None:
        raise ImageError(f"{path}: the header of the file is damaged")
    kind, columns, rows, white = (int(part) for part in header.groups())
    channels = 1 if kind == 5 else 3
    stored = np.dtype(np.uint8) if white < 256 else np.dtype(">u2")
    values = content[header.end() :]
    size = rows * columns * channels
    if not 0 < white < 65536 or size == 0 or len(values) < size * stored.itemsize:
        raise ImageError(f"{path}: the file ends before its {columns} x {rows} pixels do")
    counts = np.frombuffer(values, dtype=stored, count=size).reshape(rows, columns, channels)
    return CameraFile(counts.astype(float), float(white))


def _npy(path: Path) -> NDArray[Any]:
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, ValueError, EOFError) as error:
        raise ImageError(f"{path}: the file is damaged ({error})") from None


def _raw(path: Path) -> CameraFile:
    try:
        import rawpy
    except ModuleNotFoundError:
        raise RuntimeError(
            f"{path}: raw files need the package rawpy: pip install 'designlab[raw]', or pip install rawpy"
        ) from None
    try:
        with rawpy.imread(str(path)) as raw:
            mosaic = np.array(raw.raw_image_visible, dtype=float)
            pattern, names = raw.raw_pattern, raw.color_desc.decode("ascii", "replace")
            black, white = list(raw.black_level_per_channel), raw.white_level
    except (rawpy.LibRawError, OSError) as error:
        raise ImageError(f"{path}: the file is damaged or of an unsupported kind ({error})") from None
    letters = "" if pattern is None or pattern.shape != (2, 2) else "".join(names[i] for i in pattern.ravel())
    if mosaic.ndim != 2 or letters not in PATTERNS:
        raise ImageError(f"{path}: must be a Bayer raw file, its pattern is {letters or 'another one'}")
    stated = [np.mean([black[i] for i in range(len(names)) if names[i] == colour]) for colour in "RGB"]
    return CameraFile(mosaic[..., None], float(white), np.array(stated), letters)
