"""Files as cameras write them: JPEG, PNG, TIFF, EXR, PGM, NumPy arrays, and raw files through rawpy."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from designlab.core.image_files import ImageError, StoredImage, format_of, read_stored
from designlab.core.types import Array

RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef")
SUFFIXES = (
    *(".exr", ".png", ".tif", ".tiff", ".jpg", ".jpeg", ".webp", ".bmp", ".pgm", ".ppm", ".npy"),
    *RAW_SUFFIXES,
)
PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
UNTURNED = 1  # EXIF orientation
TURNS_OF_RAW = {3: 3, 5: 8, 6: 6}  # EXIF orientations of LibRaw's flips
LINEAR_FORMATS = ("EXR", "NPY", "PGM")  # that hold values as sensors give them, unless said otherwise
OVERSHOOT = 1.001  # what rounding may put above a full scale of 1
LEAST_FOR_PATTERN = 4  # cells each way
MOSAIC_STEP = 0.03  # of the mean, between the places of a cell: whole pictures differ by far less


@dataclass(frozen=True, eq=False)
class CameraFile:
    """Values of one file as the camera wrote them.

    Attributes
    ----------
    path : Path
        The file.
    counts : array, shape (rows, columns, channels)
        Stored values.
    white : float or None
        Value of full scale: that of the file's type, or what a raw file states; 1 for floats up to 1; None
        where it is not known.
    kind : str
        Format and depth, in words.
    black : array, shape (3,), or None
        Values without light that a raw file states.
    bayer : str or None
        Colours of the four pixels at the upper left, row by row, where the file states them.
    encoded : bool
        Whether the format is one that holds pictures for eyes (JPEG, WebP).
    orientation : int
        EXIF orientation, 1 to 8, by which viewers turn the picture; `counts` are not turned.
    notes : tuple of str
        What was left out, looked up or moved.
    """

    path: Path
    counts: Array
    white: float | None
    kind: str
    black: Array | None = None
    bayer: str | None = None
    encoded: bool = False
    orientation: int = UNTURNED
    notes: tuple[str, ...] = ()

    @property
    def extremes(self) -> tuple[float, float]:
        """Lowest and highest stored value."""
        return float(self.counts.min()), float(self.counts.max())


def is_linear_format(path: Path) -> bool:
    """Whether a file is of a format that usually holds values as the sensor gives them.

    Raises
    ------
    ImageError
        If there is no such file.
    """
    return path.suffix.lower() in RAW_SUFFIXES or format_of(path) in LINEAR_FORMATS


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
    name = format_of(path)
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES and name in (None, "TIFF"):  # most raw files begin as a TIFF does
        return _raw(path)
    if name is None and suffix not in SUFFIXES:
        raise ImageError(f"{path}: suffix must be one of {' '.join(SUFFIXES)}, got {suffix!r}")
    stored = read_stored(path)
    if not np.isfinite(stored.values).all():
        raise ImageError(f"{path}: values must be finite")
    kind, notes = f"{stored.format}, {_channels(stored)} of {stored.depth}", stored.notes
    white = stored.full_scale
    if stored.values.dtype.kind == "f" and stored.values.max() <= OVERSHOOT:
        white = 1.0
    low_bits = _unused_bits(stored)
    if low_bits:
        kind = f"{kind} (in steps of {2**low_bits})"
    return CameraFile(
        path,
        stored.values.astype(float),
        white,
        kind,
        encoded=stored.lossy,
        orientation=stored.orientation,
        notes=notes,
    )


def looks_like_mosaic(counts: Array) -> bool:
    """Whether a picture of one channel, (rows, columns), has the steps of a Bayer mosaic between pixels.

    The four places of a 2 x 2 cell then differ from cell to cell in the same way, and the two greens agree
    better than the others.
    """
    rows, columns = counts.shape[0] // 2 * 2, counts.shape[1] // 2 * 2
    if min(rows, columns) < 2 * LEAST_FOR_PATTERN:
        return False
    places = [counts[row:rows:2, column:columns:2] for row in (0, 1) for column in (0, 1)]
    levels = np.array([place.mean() for place in places])
    greens = min(abs(levels[0] - levels[3]), abs(levels[1] - levels[2]))
    span = float(np.ptp(levels))
    return bool(span > MOSAIC_STEP * levels.mean() and greens < span / 3)


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


def _channels(stored: StoredImage) -> str:
    count = stored.values.shape[-1]
    return "1 channel" if count == 1 else f"{count} channels"


def _unused_bits(stored: StoredImage) -> int:
    """How many low bits are zero in all values of 16 bits: those of 10 or 12 bits are often shifted up."""
    if stored.values.dtype != np.uint16 or stored.full_scale != 65535:
        return 0
    used = int(np.bitwise_or.reduce(stored.values, axis=None))
    return 0 if used == 0 else (used & -used).bit_length() - 1


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
            turn = TURNS_OF_RAW.get(raw.sizes.flip, UNTURNED)
    except (rawpy.LibRawError, OSError) as error:
        raise ImageError(f"{path}: the file is damaged or of an unsupported kind ({error})") from None
    letters = "" if pattern is None or pattern.shape != (2, 2) else "".join(names[i] for i in pattern.ravel())
    if mosaic.ndim != 2 or letters not in PATTERNS:
        raise ImageError(f"{path}: must be a Bayer raw file, its pattern is {letters or 'another one'}")
    stated = [np.mean([black[i] for i in range(len(names)) if names[i] == colour]) for colour in "RGB"]
    kind = f"raw file, {letters} mosaic of {int(white).bit_length()} bits"
    return CameraFile(
        path, mosaic[..., None], float(white), kind, np.array(stated), letters, orientation=turn
    )
