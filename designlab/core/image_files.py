"""Picture files as they are stored: told by their content, values unchanged, full scale, and what is odd."""

import io
import logging
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import tifffile
    from PIL.Image import Image as PillowImage

CHANNEL_COUNTS = (1, 3)
ORIENTATION = 0x0112  # tag of EXIF and of TIFF
LARGEST_PIXELS = 150_000_000  # sensors of cameras end at some 100 million; a damaged header says more
COLOURS = {"CMYK": "CMYK (printing inks)", "LAB": "CIE Lab", "HSV": "HSV", "YCbCr": "YCbCr"}
REMEDY = "save it as the camera's own red, green, blue (PNG, TIFF, EXR or .npy)"


class ImageError(ValueError):
    """A file or an array that is not the image it should be."""


@dataclass(frozen=True, eq=False)
class StoredImage:
    """Values of a picture file as they are stored.

    Attributes
    ----------
    values : array, shape (rows, columns, channels)
        Integers or floats, 1 or 3 channels; row 0 is the first that is stored.
    format : str
        Name of the format, such as PNG.
    full_scale : float or None
        Largest value that the type can hold; None where the type does not tell: floats, signed integers,
        integers of more than 16 bits.
    orientation : int
        EXIF orientation, 1 to 8: how viewers turn the picture. The values are not turned.
    lossy : bool
        Whether the format is one for eyes (JPEG, WebP).
    notes : tuple of str
        What was left out or looked up.
    """

    values: NDArray[Any]
    format: str
    full_scale: float | None
    orientation: int = 1
    lossy: bool = False
    notes: tuple[str, ...] = ()

    @property
    def depth(self) -> str:
        """Depth of the values, in words."""
        kind = self.values.dtype
        if kind.kind == "f":
            return f"{8 * kind.itemsize}-bit floats"
        if kind.kind == "i":
            return f"{8 * kind.itemsize}-bit signed integers"
        bits = 8 * kind.itemsize if self.full_scale is None else int(self.full_scale).bit_length()
        return f"{bits} bits"


def format_of(path: Path) -> str | None:
    """Name of the format of a file by its first bytes; None where it is unknown.

    Raises
    ------
    ImageError
        If there is no such file, or it cannot be opened.
    """
    start = _start(path)
    return next((name for name, known in _FORMATS.items() if known.begins(start)), None)


def read_stored(path: Path, formats: tuple[str, ...] | None = None) -> StoredImage:
    """Read a picture file without any change of its values; an opaque alpha channel is left out.

    Parameters
    ----------
    path : Path
        The file. Its content tells the format, not its name.
    formats : tuple of str, optional
        Formats that may be read; all that are known when absent.

    Raises
    ------
    ImageError
        If there is no such file, or it is not a picture of 1 or 3 channels.
    """
    name = format_of(path)
    allowed = tuple(_FORMATS) if formats is None else formats
    if name not in allowed:
        raise ImageError(f"{path}: {_unknown(path, name, allowed)}")
    try:
        with quiet():
            stored = _FORMATS[name].decode(path)
    except ImageError as error:
        raise ImageError(f"{path}: {error}") from None
    except Exception as error:  # each decoder has its own exceptions for a damaged file
        reason = str(error) or type(error).__name__
        raise ImageError(f"{path}: the file is damaged or of an unsupported kind ({reason})") from error
    return _named_as_it_is(_checked(stored, str(path)), path)


def rows_columns_channels(pixels: NDArray[Any], name: str) -> NDArray[Any]:
    """Bring an array to the shape (rows, columns, channels) with 1 or 3 channels, without an opaque alpha.

    Raises
    ------
    ImageError
        If its shape is another, or its alpha is not opaque.
    """
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3 or 0 in pixels.shape:
        raise ImageError(f"{name}: must be an array of rows, columns and channels, got shape {pixels.shape}")
    if pixels.shape[-1] in (2, 4):
        _require_opaque(pixels[..., -1], name)
        pixels = pixels[..., :-1]
    if pixels.shape[-1] not in CHANNEL_COUNTS:
        raise ImageError(f"{name}: must have 1 or 3 channels, got {pixels.shape[-1]}")
    return pixels


def type_full_scale(kind: np.dtype[Any]) -> float | None:
    """Largest value of a type of unsigned integers of up to 16 bits; None for others."""
    return float(np.iinfo(kind).max) if kind.kind == "u" and kind.itemsize <= 2 else None


@contextmanager
def quiet() -> Iterator[None]:
    """Hold back what libraries say of files: one error names the file, and standard output is for results."""
    log = logging.getLogger("tifffile")
    spoke, log.disabled = log.disabled, True
    try:
        # OpenEXR prints what it then raises.
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        log.disabled = spoke


def _start(path: Path) -> bytes:
    if not path.is_file():
        raise ImageError(f"{path}: no such file")
    try:
        with path.open("rb") as file:
            return file.read(16)
    except OSError as error:
        raise ImageError(f"{path}: cannot be read: {error.strerror or error}") from None


def _unknown(path: Path, name: str | None, allowed: tuple[str, ...]) -> str:
    """Say what a file is instead of a picture that can be read."""
    start = _start(path)
    known = f"must be an {', '.join(allowed[:-1])} or {allowed[-1]} image"
    if name is not None:
        return f"{known}, is {name}; convert it with `designlab import`"
    other = next((text for magic, text in _OTHERS.items() if re.match(magic, start, re.DOTALL)), None)
    if other is not None:
        return f"{known}, is {other}"
    return f"{known}, its first bytes are {start[:8].hex(' ') or 'missing'}"


def _checked(stored: StoredImage, name: str) -> StoredImage:
    """Bring values to rows, columns, channels, and say where an alpha channel was left out."""
    values = stored.values
    if values.dtype.kind not in "uif":
        raise ImageError(f"{name}: values must be integers or floats, got {values.dtype}")
    alpha = values.ndim == 3 and values.shape[-1] in (2, 4)
    notes = (*stored.notes, "its alpha channel is opaque and left out") if alpha else stored.notes
    return replace(stored, values=rows_columns_channels(values, name), notes=notes)


def _require_opaque(alpha: NDArray[Any], name: str) -> None:
    full = type_full_scale(alpha.dtype)
    opaque = (1.0, 255.0, 65535.0) if full is None else (full,)
    if alpha.min() == alpha.max() and float(alpha.flat[0]) in opaque:
        return
    clear = float((alpha <= 0).mean())
    raise ImageError(
        f"{name}: must be opaque, its alpha channel is not: {clear:.0%} of the pixels are transparent (a "
        "mask of the gel's outline?); pictures have no masks here: save it without alpha, with the pixels "
        "that the camera saw"
    )


def _named_as_it_is(stored: StoredImage, path: Path) -> StoredImage:
    """Note a name that promises another format."""
    suffix = path.suffix.lower()
    promised = next((name for name, known in _FORMATS.items() if suffix in known.suffixes), None)
    if promised is None or promised == stored.format:
        return stored
    return replace(stored, notes=(*stored.notes, f"named {suffix}, but it is {stored.format} and read so"))


def _require_size(rows: int, columns: int) -> None:
    if rows * columns > LARGEST_PIXELS:
        raise ImageError(f"must have at most {LARGEST_PIXELS} pixels, its header says {columns} x {rows}")


def _decode_exr(path: Path) -> StoredImage:
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        low, high = (np.asarray(corner, dtype=int) for corner in file.header()["dataWindow"])
        columns, rows = (int(side) for side in high - low + 1)
    _require_size(rows, columns)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    for names in (("R", "G", "B"), ("Y",)):
        if set(channels) - {"A"} == set(names):
            planes = [channels[name] for name in (*names, *(["A"] if "A" in channels else []))]
            return StoredImage(np.stack(planes, axis=-1), "EXR", None)
    raise ImageError(f"channels must be R, G, B or Y, got {', '.join(sorted(channels)) or 'none'}")


def _decode_png(path: Path) -> StoredImage:
    import png

    with path.open("rb") as file:
        reader = png.Reader(file=file)
        reader.preamble()
        _require_size(reader.height, reader.width)
        if reader.bitdepth != 16:
            return _decode_pillow(path)
        # Pillow cuts 16-bit colour to 8 bits
        columns, rows, lines, info = reader.read()
        values = np.stack([np.asarray(line, dtype=np.uint16) for line in lines])
    orientation = _pillow_orientation(path)
    return StoredImage(values.reshape(rows, columns, info["planes"]), "PNG", 65535.0, orientation)


def _decode_pillow(path: Path) -> StoredImage:
    """Pictures of 8 bits; palettes are looked up."""
    from PIL import Image as Pillow

    with Pillow.open(path) as picture:
        name = {"MPO": "JPEG", "WEBP": "WebP"}.get(picture.format or "", picture.format or "")
        frames = getattr(picture, "n_frames", 1)
        if frames != 1 and picture.format != "MPO":  # an MPO is a JPEG with further pictures behind it
            raise ImageError(f"must hold one picture, got {frames}; save one picture a file")
        _require_size(picture.height, picture.width)
        orientation = _orientation(picture)
        notes = ("its palette is looked up",) if picture.mode in ("P", "PA") else ()
        values = _pillow_values(picture)
    return StoredImage(values, name, 255.0, orientation, name in ("JPEG", "WebP"), notes)


def _pillow_values(picture: "PillowImage") -> NDArray[Any]:
    mode = picture.mode
    if mode in COLOURS:
        raise ImageError(f"its colours are {COLOURS[mode]}, must be red, green, blue or grey; {REMEDY}")
    if "transparency" in picture.info or mode == "PA":
        return np.asarray(picture.convert("LA" if mode in ("1", "L") else "RGBA"))
    return np.asarray(picture.convert({"P": "RGB", "1": "L", "RGBX": "RGB"}.get(mode, mode)))


def _orientation(picture: "PillowImage") -> int:
    """EXIF orientation; 1 where there is none or none that is known."""
    found = picture.getexif().get(ORIENTATION, 1)
    return found if found in range(1, 9) else 1


def _pillow_orientation(path: Path) -> int:
    from PIL import Image as Pillow

    with Pillow.open(path) as picture:
        return _orientation(picture)


def _decode_tiff(path: Path) -> StoredImage:
    import tifffile

    with tifffile.TiffFile(path) as file:
        pages = [page for page in file.pages if isinstance(page, tifffile.TiffPage) and not page.is_reduced]
        if len(pages) != 1:
            raise ImageError(
                f"must hold one page, got {len(pages)}; save one picture a file, its channels last "
                "(rows, columns, 3)"
            )
        page = pages[0]
        _require_size(page.imagelength, page.imagewidth)
        colours = page.photometric
        if colours in (tifffile.PHOTOMETRIC.SEPARATED, tifffile.PHOTOMETRIC.CIELAB):
            name = COLOURS["CMYK" if colours == tifffile.PHOTOMETRIC.SEPARATED else "LAB"]
            raise ImageError(f"its colours are {name}, must be red, green, blue or grey; {REMEDY}")
        notes = ("its palette is looked up",) if colours == tifffile.PHOTOMETRIC.PALETTE else ()
        values, full = _tiff_values(path, page)
        tag = page.tags.get(ORIENTATION)
    orientation = tag.value if tag is not None and tag.value in range(1, 9) else 1
    if colours == tifffile.PHOTOMETRIC.MINISWHITE and full is not None:
        values, notes = (full - values).astype(values.dtype), ("stored with 0 for white, and turned round",)
    return StoredImage(values, "TIFF", full, orientation, page.compression == 7, notes)


def _tiff_values(path: Path, page: "tifffile.TiffPage") -> tuple[NDArray[Any], float | None]:
    """Values of a page and their full scale, by the reader that knows its compression."""
    import tifffile

    if page.photometric not in (tifffile.PHOTOMETRIC.PALETTE, tifffile.PHOTOMETRIC.YCBCR):
        try:
            pixels = page.asarray()
        except (ValueError, ModuleNotFoundError) as error:
            # The package with tifffile's further decoders, and a module of a later Python.
            if not any(missing in str(error) for missing in ("imagecodecs", "compression")):
                raise
        else:
            pixels = pixels.astype(np.uint8) if pixels.dtype.kind == "b" else pixels
            planar = page.planarconfig == tifffile.PLANARCONFIG.SEPARATE and pixels.ndim == 3
            return np.moveaxis(pixels, 0, -1) if planar else pixels, _bits_scale(pixels, page)
    if page.samplesperpixel == 1 or page.bitspersample <= 8:
        from PIL import Image as Pillow

        with Pillow.open(path) as picture:
            picture.getexif()[ORIENTATION] = 1  # else Pillow turns what it loads
            pixels = _pillow_values(picture)
    else:
        pixels = _opencv_values(path, page)
    # Fewer than 8 bits are stretched to 8 by Pillow, 12 bits are not stretched to 16.
    return pixels, 255.0 if pixels.dtype == np.uint8 else _bits_scale(pixels, page)


def _bits_scale(pixels: NDArray[Any], page: "tifffile.TiffPage") -> float | None:
    full = type_full_scale(pixels.dtype)
    return None if full is None else min(full, float(2**page.bitspersample - 1))


def _opencv_values(path: Path, page: "tifffile.TiffPage") -> NDArray[Any]:
    """Compressed colour of more than 8 bits, which Pillow cuts to 8."""
    compression = getattr(page.compression, "name", page.compression)
    try:
        import cv2
    except ModuleNotFoundError:
        raise ImageError(
            f"compressed by {compression} with {page.bitspersample} bits a channel, which needs "
            "OpenCV: pip install opencv-python-headless; or save it without compression, or with deflate"
        ) from None
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if found is None or found.dtype.itemsize * 8 != page.bitspersample:
        raise ImageError(f"compressed by {compression}; save it without compression")
    pixels = np.asarray(found)
    return pixels if pixels.ndim == 2 else pixels[..., [2, 1, 0, 3][: pixels.shape[-1]]]


def _decode_netpbm(path: Path) -> StoredImage:
    """Netpbm's formats of grey and colour; their full scale may be any number up to 65535."""
    content = path.read_bytes()
    # One white space ends the header; binary values behind it may look like white space too.
    header = re.match(rb"P([2356])" + 3 * rb"\s+(?:#[^\n]*\n\s*)*(\d+)" + rb"\s", content)
    if header is None:
        raise ImageError("the header of the file is damaged")
    kind, columns, rows, white = (int(part) for part in header.groups())
    _require_size(rows, columns)
    channels = 1 if kind in (2, 5) else 3
    size = rows * columns * channels
    ends = ImageError(f"the file ends before its {columns} x {rows} pixels do")
    if not 0 < white < 65536 or size == 0:
        raise ImageError(f"the header of the file is damaged: {columns} x {rows} pixels of 0 to {white}")
    stored = np.dtype(np.uint8) if white < 256 else np.dtype(">u2")
    if kind < 5:
        numbers = content[header.end() :].split()
        if len(numbers) < size:
            raise ends
        written = [int(number) for number in numbers[:size]]
        if min(written) < 0 or max(written) > white:
            raise ImageError(f"values must lie within 0 and {white}, got {min(written)} to {max(written)}")
        counts = np.array(written, dtype=stored)
    else:
        values = content[header.end() :]
        if len(values) < size * stored.itemsize:
            raise ends
        counts = np.frombuffer(values, dtype=stored, count=size)
    counts = counts.astype(stored.newbyteorder("=")).reshape(rows, columns, channels)
    notes: tuple[str, ...] = ()
    if counts.max() > white:
        swapped = counts.byteswap()
        if stored.itemsize == 1 or swapped.max() > white:
            raise ImageError(f"values must not exceed {white}, its stated full scale, got {counts.max()}")
        counts, notes = swapped, ("its bytes stand in the other order than the format demands, read so",)
    return StoredImage(counts, "PGM" if channels == 1 else "PPM", float(white), notes=notes)


def _decode_npy(path: Path) -> StoredImage:
    """Arrays of rows, columns and channels; channels that stand first are moved last."""
    stored = np.load(path, mmap_mode="r", allow_pickle=False)
    shape = stored.shape
    if stored.dtype.kind not in "uif":
        raise ImageError(f"values must be integers or floats, got {stored.dtype}")
    if stored.ndim not in (2, 3) or 0 in shape:
        stack = f": a stack of {shape[0]} pictures? Save one picture a file" if stored.ndim == 4 else ""
        raise ImageError(f"must hold rows, columns and 1 or 3 channels, got shape {shape}{stack}")
    notes: tuple[str, ...] = ()
    if stored.ndim == 3 and shape[-1] > 4 and shape[0] <= 4:
        stored = np.moveaxis(stored, 0, -1)
        notes = (f"its channels stand first {shape}, and are moved last",)
    if stored.ndim == 3 and stored.shape[-1] > 4:
        raise ImageError(
            f"must hold rows, columns and 1 or 3 channels, got shape {shape}: a stack of pictures? Save one "
            "picture a file, as (rows, columns, 3)"
        )
    _require_size(*stored.shape[:2])
    values = np.array(stored, dtype=stored.dtype.newbyteorder("="))
    return StoredImage(values, "NPY", type_full_scale(values.dtype), notes=notes)


@dataclass(frozen=True)
class _Format:
    magic: bytes  # pattern of the first bytes
    suffixes: tuple[str, ...]
    decode: Callable[[Path], StoredImage]

    def begins(self, start: bytes) -> bool:
        return re.match(self.magic, start, re.DOTALL) is not None


_FORMATS = {
    "EXR": _Format(rb"\x76\x2f\x31\x01", (".exr",), _decode_exr),
    "PNG": _Format(rb"\x89PNG\r\n\x1a\n", (".png",), _decode_png),
    "TIFF": _Format(rb"II[*+]\0|MM\0[*+]", (".tif", ".tiff"), _decode_tiff),
    "JPEG": _Format(rb"\xff\xd8\xff", (".jpg", ".jpeg"), _decode_pillow),
    "WebP": _Format(rb"RIFF....WEBP", (".webp",), _decode_pillow),
    "BMP": _Format(rb"BM.{12}", (".bmp",), _decode_pillow),
    "PGM": _Format(rb"P[25]\s", (".pgm",), _decode_netpbm),
    "PPM": _Format(rb"P[36]\s", (".ppm",), _decode_netpbm),
    "NPY": _Format(rb"\x93NUMPY", (".npy",), _decode_npy),
}

_OTHERS = {
    rb"GIF8": f"a GIF of 256 colours; {REMEDY}",
    rb"....ftyp(avi|hei|hev|mif|msf)": f"a HEIC or AVIF picture; {REMEDY}",
    rb"....ftyp": "a video; save single pictures from the camera (PNG, TIFF)",
    rb"RIFF....AVI ": "a video; save single pictures from the camera (PNG, TIFF)",
    rb"\0\0\0\x0cjP|\xff\x4f\xff\x51": f"a JPEG 2000 picture; {REMEDY}",
    rb"#\?R": f"a Radiance picture; {REMEDY}",
    rb"P[14]\s": f"a picture of black and white alone (PBM); {REMEDY}",
    rb"P[7Ff]\s": f"a PAM or PFM file; {REMEDY}",
    rb"PK\x03\x04": "a ZIP or .npz archive; save the one array by numpy.save as .npy",
    rb"\x89HDF": "an HDF5 or MATLAB file; save the one array by numpy.save as .npy",
    rb"MATLAB": "a MATLAB file; save the one array by numpy.save as .npy",
    rb"SIMPLE  =": f"a FITS file; {REMEDY}",
    rb"%PDF": f"a PDF; {REMEDY}",
}
"""Files that people take for pictures to import, by pattern of the first bytes."""
