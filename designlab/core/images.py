"""Images as arrays, and the files they live in."""

import io
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.image_files import ImageError as ImageError
from designlab.core.image_files import StoredImage, read_stored, rows_columns_channels

Pixels = NDArray[np.float32]

FORMATS = ("EXR", "PNG", "TIFF")


def read_image(path: str | os.PathLike[str]) -> Pixels:
    """Read an EXR, PNG or TIFF file without any change of gamma.

    The format is told by the content of the file, not by its name. Floating-point files keep their values
    (EXR: half or float); integer files are divided by their full scale. An opaque alpha channel is dropped.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    array of float32, shape (rows, columns, channels)
        Row 0 is the top of the picture; 1 channel (grey) or 3 (red, green, blue).

    Raises
    ------
    ImageError
        If there is no such file, or it is not an image of 1 or 3 channels with finite values.
    """
    return _shares(read_stored(Path(path), FORMATS), path)


def read_picture(path: str | os.PathLike[str]) -> Pixels:
    """Read a camera's picture of any format that is known, as shares of full scale, gamma unchanged.

    Parameters
    ----------
    path : path
        The file; JPEG, WebP, BMP and NPY too.

    Returns
    -------
    array of float32, shape (rows, columns, channels)
        Values from 0 to 1.

    Raises
    ------
    ImageError
        If there is no such file, it is no picture, or floats in it go beyond 0 and 1.
    """
    found = _shares(read_stored(Path(path)), path)
    low, high = float(found.min()), float(found.max())
    if low < 0 or high > 1:
        raise ImageError(
            f"{path}: values must lie between 0 and 1, they run from {low:.4g} to {high:.4g}; divide them by "
            "the value of a saturated pixel"
        )
    return found


def _shares(stored: StoredImage, path: str | os.PathLike[str]) -> Pixels:
    """Values as shares of full scale; floats as they are."""
    if stored.values.dtype.kind == "f":
        return _require_finite(stored.values.astype(np.float32), str(path))
    if stored.full_scale is None:
        raise ImageError(f"{path}: values must be unsigned integers or floats, got {stored.values.dtype}")
    return np.asarray(stored.values / stored.full_scale, dtype=np.float32)


def write_image(path: str | os.PathLike[str], array: NDArray[Any], *, bits: int = 8) -> None:
    """Write an array to an EXR, PNG or TIFF file; the file appears complete or not at all.

    EXR holds half floats for a float16 array and floats otherwise. TIFF holds the array's own type (float64
    as float32). PNG holds uint8 and uint16 arrays as they are; floats, which must lie within 0..1, are
    rounded to steps of full scale. Gamma is never changed: apply `to_srgb` or `tone_map` first where the
    picture is for eyes.

    Parameters
    ----------
    path : path
        The file, ending in .exr, .png, .tif or .tiff; its folder must exist.
    array : array, shape (rows, columns) or (rows, columns, channels)
        1 or 3 channels.
    bits : int
        8 or 16: depth of a PNG written from floats.

    Raises
    ------
    ImageError
        If the suffix, the shape or the values do not fit.
    OSError
        If the folder is missing or not writable.
    """
    path = Path(path)
    encode = _ENCODERS.get(path.suffix.lower())
    if encode is None:
        raise ImageError(f"{path}: suffix must be one of {', '.join(_ENCODERS)}, got {path.suffix!r}")
    pixels = rows_columns_channels(np.asarray(array), str(path))
    if pixels.dtype.kind not in "uf":
        raise ImageError(f"{path}: values must be unsigned integers or floats, got {pixels.dtype}")
    _require_finite(pixels, str(path))
    if path.suffix.lower() == ".png":
        pixels = _as_counts(pixels, bits, str(path))
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent}: no such folder")
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        unfinished = Path(folder) / path.name
        encode(unfinished, np.ascontiguousarray(pixels))
        unfinished.replace(path)


def to_srgb(linear: NDArray[Any]) -> NDArray[np.float64]:
    """Encode linear values with the sRGB curve (IEC 61966-2-1), elementwise, without clipping."""
    linear = np.asarray(linear, dtype=float)
    curved = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, curved))


def from_srgb(encoded: NDArray[Any]) -> NDArray[np.float64]:
    """Undo `to_srgb`: linear values from sRGB-encoded ones (IEC 61966-2-1), elementwise."""
    encoded = np.asarray(encoded, dtype=float)
    curved = ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.asarray(np.where(encoded <= 0.04045, encoded / 12.92, curved))


def tone_map(linear: NDArray[Any], white: float | None = None) -> NDArray[np.uint8]:
    """Turn linear radiance into an 8-bit sRGB picture for eyes.

    Parameters
    ----------
    linear : array
        Linear radiance, any shape.
    white : float, optional
        Radiance shown as 255; the 99.9th percentile of all values when absent.
    """
    linear = np.asarray(linear, dtype=float)
    if white is None:
        white = float(np.percentile(linear, 99.9)) or 1.0
    if not white > 0:
        raise ImageError(f"white: must be positive, got {white:g}")
    return np.asarray(np.round(255 * to_srgb(np.clip(linear / white, 0.0, 1.0))), dtype=np.uint8)


def png_bytes(pixels: NDArray[np.uint8], *, compression: int = 6) -> bytes:
    """An 8-bit picture, (rows, columns, 3), as the bytes of a PNG file; levels of compression run to 9."""
    from PIL import Image

    written = io.BytesIO()
    Image.fromarray(pixels).save(written, "PNG", compress_level=compression)
    return written.getvalue()


def resize_area(image: NDArray[Any], rows: int, columns: int) -> NDArray[Any]:
    """Resample so that each new pixel is the mean of the old image over the area it covers.

    Parameters
    ----------
    image : array, shape (rows, columns) or (rows, columns, channels)
        The image; sides need not be multiples of the new ones.
    rows, columns : int
        New size.
    """
    image = np.asarray(image)
    if rows < 1 or columns < 1:
        raise ImageError(f"rows, columns: must be at least 1, got {rows} x {columns}")
    down = np.tensordot(_overlap(image.shape[0], rows), image, axes=(1, 0))
    across = np.tensordot(_overlap(image.shape[1], columns), down, axes=(1, 1))
    return np.asarray(np.swapaxes(across, 0, 1), dtype=np.result_type(image.dtype, np.float32))


def narrowed(image: NDArray[np.float64], columns: int) -> NDArray[np.float64]:
    """Average an image, shape (rows, columns, ...), down to at most so many columns, its proportion kept."""
    columns = min(columns, image.shape[1])
    rows = max(1, round(image.shape[0] * columns / image.shape[1]))
    return np.asarray(resize_area(image, rows, columns), dtype=float)


def _overlap(old: int, new: int) -> NDArray[np.float64]:
    """Share of each old pixel in each new one, shape (new, old), rows summing to one."""
    edges = np.arange(new + 1)[:, None] * (old / new)
    pixel = np.arange(old)[None, :]
    covered = np.minimum(edges[1:], pixel + 1) - np.maximum(edges[:-1], pixel)
    return np.asarray(np.maximum(covered, 0.0) * (new / old))


def _encode_exr(path: Path, pixels: NDArray[Any]) -> None:
    import OpenEXR

    pixels = pixels if pixels.dtype == np.float16 else _scaled(pixels)
    names = "RGB" if pixels.shape[-1] == 3 else "Y"
    channels = {name: np.ascontiguousarray(pixels[..., index]) for index, name in enumerate(names)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def _encode_png(path: Path, pixels: NDArray[Any]) -> None:
    import png

    rows, columns, planes = pixels.shape
    writer = png.Writer(columns, rows, greyscale=planes == 1, bitdepth=8 * pixels.dtype.itemsize)
    with path.open("wb") as file:
        writer.write(file, pixels.reshape(rows, columns * planes))


def _encode_tiff(path: Path, pixels: NDArray[Any]) -> None:
    import tifffile

    pixels = pixels.astype(np.float32) if pixels.dtype == np.float64 else pixels
    kind = "rgb" if pixels.shape[-1] == 3 else "minisblack"
    tifffile.imwrite(path, pixels if pixels.shape[-1] == 3 else pixels[..., 0], photometric=kind)


_ENCODERS: dict[str, Callable[[Path, NDArray[Any]], None]] = {
    ".exr": _encode_exr,
    ".png": _encode_png,
    ".tif": _encode_tiff,
    ".tiff": _encode_tiff,
}


def _scaled(pixels: NDArray[Any]) -> Pixels:
    """Floats as they are, integers as a share of full scale."""
    if pixels.dtype.kind == "f":
        return pixels.astype(np.float32)
    if pixels.dtype.kind == "u":
        return (pixels / np.iinfo(pixels.dtype).max).astype(np.float32)
    raise ImageError(f"values must be unsigned integers or floats, got {pixels.dtype}")


def _as_counts(pixels: NDArray[Any], bits: int, name: str) -> NDArray[Any]:
    if bits not in (8, 16):
        raise ImageError(f"bits: must be 8 or 16, got {bits}")
    if pixels.dtype in (np.uint8, np.uint16):
        return pixels
    if pixels.dtype.kind != "f":
        raise ImageError(f"{name}: a PNG holds uint8, uint16 or floats within 0..1, got {pixels.dtype}")
    lowest, highest = float(pixels.min()), float(pixels.max())
    if lowest < 0 or highest > 1:
        raise ImageError(
            f"{name}: floats must lie within 0..1 for a PNG, got {lowest:g}..{highest:g}; scale or clip them"
        )
    counts = np.round(pixels.astype(float) * (2**bits - 1))
    return np.asarray(counts, dtype=np.uint8 if bits == 8 else np.uint16)


def _require_finite(pixels: NDArray[Any], name: str) -> NDArray[Any]:
    bad = ~np.isfinite(pixels)
    if bad.any():
        row, column, channel = (int(index) for index in np.argwhere(bad)[0])
        raise ImageError(
            f"{name}: values must be finite, {int(bad.sum())} are not, the first is "
            f"{pixels[row, column, channel]} at row {row}, column {column}, channel {channel}"
        )
    return pixels
