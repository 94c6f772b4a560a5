"""What a camera's file was taken for, and what may be wrong with it."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from designlab.core.types import Array, Mask
from designlab.measurement.frames import MeasuredFrame
from designlab.measurement.importing.camera_files import UNTURNED, CameraFile, looks_like_mosaic
from designlab.measurement.importing.conversion import Conversion, full_scale
from designlab.measurement.quality.colour import SHOWING, missing_colour

CUT_SHARE = 0.01  # of the values at zero that a colour matrix cannot be undone for, worth a note
ABOVE = 1.001  # of a stated full scale, above which values are worth a note
EIGHT_BITS = 255.0
NAMES_SHOWN = 3  # in a note about several files


class PictureFile(NamedTuple):
    """What a file was taken for.

    Attributes
    ----------
    file : str
        Its name.
    kind : str
        Format, channels and depth, in words.
    size_px : tuple of int
        Width and height.
    extremes : tuple of float
        Lowest and highest stored value.
    full_scale : float
        Stored value at full scale.
    orientation : int
        EXIF orientation; the values are not turned.
    """

    file: str
    kind: str
    size_px: tuple[int, int]
    extremes: tuple[float, float]
    full_scale: float
    orientation: int


def understood(file: CameraFile, conversion: Conversion) -> PictureFile:
    """Say what a file was taken for."""
    rows, columns, channels = file.counts.shape
    mosaic = conversion.bayer if channels == 1 and file.bayer is None else None
    kind = file.kind if mosaic is None else f"{file.kind}, {mosaic} mosaic"
    white = full_scale(file, conversion)
    return PictureFile(file.path.name, kind, (columns, rows), file.extremes, white, file.orientation)


def odd(
    file: CameraFile, frame: MeasuredFrame, conversion: Conversion, picture: Array, saturated: Mask
) -> Iterator[str]:
    """Say what may be wrong with a file as it is understood.

    Parameters
    ----------
    file : CameraFile
        The file.
    frame : MeasuredFrame
        What it shows.
    conversion : Conversion
        What is undone.
    picture, saturated : array, shape (rows, columns, channels); bool array, shape (rows, columns)
        Linear values as shares of full scale, and pixels of which any value was saturated.
    """
    if file.orientation != UNTURNED:
        yield (
            f"asks viewers to turn it (EXIF orientation {file.orientation}); it is imported as the sensor "
            "saw it, so places are those of the unturned picture; to import it turned, save it turned "
            "without EXIF"
        )
    if file.encoded and _is_linear(conversion):
        yield (
            f"a {file.kind.partition(',')[0]}, which is hardly ever linear as declared; suspected cause: "
            "response left as it was; remedy: srgb, or the camera's curve from an exposure ladder"
        )
    low, high = file.extremes
    white = full_scale(file, conversion)
    if _is_linear(conversion) and file.kind.startswith("NPY, 3") and white == EIGHT_BITS:
        yield (
            "8 bits a channel, taken for linear: an array made from a JPEG or PNG is not, --response srgb; "
            "and OpenCV's hold blue, green, red"
        )
    if low < 0:
        yield f"values below zero, down to {low:.3g}, as of pictures whose level of darkness is taken away"
    if high > ABOVE * white:
        share = float((file.counts > white).any(axis=-1).mean())
        yield (
            f"values up to {high:.6g}, above the stated full scale of {white:g}: {share:.1%} of the pixels "
            "count as saturated"
        )
    if not frame.lit:
        return
    if conversion.matrix is not None:
        cut = float((file.counts <= 0).mean())
        if cut > CUT_SHARE:
            yield (
                f"{cut:.0%} of the values are cut at zero, where the matrix cannot be undone; take it less "
                "saturated in colour, or raw"
            )
    if picture.shape[-1] == 1 and looks_like_mosaic(file.counts[..., 0]):
        yield (
            "neighbouring pixels differ as those of a Bayer mosaic do: if it is one, state its pattern, as "
            "--bayer RGGB"
        )
    if frame.kind in SHOWING and (frame.leds is None or len(frame.leds) > 1):
        missing = missing_colour(picture)
        if missing is not None and not saturated.all():
            yield (
                f"this picture has no colour: {missing}. LED groups of different colours cannot be told "
                "apart in it"
            )


def _is_linear(conversion: Conversion) -> bool:
    return bool(getattr(conversion.response, "is_linear", False))


def several(names: Sequence[str]) -> str:
    """Name the first of several files, and how many more there are."""
    shown = ", ".join(names[:NAMES_SHOWN])
    return f"{shown} and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else shown
