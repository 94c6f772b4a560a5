"""What a camera did to light between its sensor and its files, and how that is undone."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.image_files import ImageError
from designlab.core.types import Array, Mask
from designlab.measurement.frames import FULL_SCALE, MeasurementError
from designlab.measurement.importing.camera_files import (
    PATTERNS,
    CameraFile,
    read_camera_file,
    superpixels,
)
from designlab.measurement.importing.ladder import (
    LadderError,
    Tabulated,
    estimate_response,
    read_table,
)
from designlab.sensor.response_curve import Response

USUAL_FULL_SCALES = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
FEW_COUNTS = 16.0  # below, values with fractions are no counts of a camera
MOST_BELOW = 0.05  # of full scale: noise about a level that was taken away reaches less far below zero


@dataclass(frozen=True, eq=False)
class Conversion:
    """What the camera did to light, to be undone.

    Attributes
    ----------
    response : Response or Tabulated
        Curve between linear signal and stored value.
    black : float or None
        Stored value without light; found from dark frames, or stated by raw files, when None.
    white : float or None
        Stored value at full scale; that of the file's type when None.
    bayer : str or None
        Pattern of single-channel files, one of RGGB, BGGR, GRBG, GBRG.
    matrix : array, shape (3, 3), or None
        Colour matrix that the camera applied to linear red, green, blue; its inverse is applied.
    """

    response: Response | Tabulated
    black: float | None = None
    white: float | None = None
    bayer: str | None = None
    matrix: Array | None = None

    def __post_init__(self) -> None:
        if self.bayer is not None and self.bayer not in PATTERNS:
            raise MeasurementError(f"bayer: one of {', '.join(PATTERNS)}, got {self.bayer!r}")
        if self.white is not None and not self.white > (self.black or 0.0):
            raise MeasurementError(f"white: must be above black ({self.black or 0:g}), got {self.white:g}")
        if self.black is not None and self.black < 0:
            raise MeasurementError(f"black: must not be negative, got {self.black:g}")
        if self.matrix is not None:
            shape = np.shape(self.matrix)
            if shape != (3, 3) or abs(np.linalg.det(self.matrix)) < 1e-3:
                raise MeasurementError(f"colour_matrix: must be 3 x 3 and invertible, got shape {shape}")


def read(path: Path) -> CameraFile:
    """Read a camera's file; what is wrong with it is the measurement's error."""
    try:
        return read_camera_file(path)
    except ImageError as error:
        raise MeasurementError(str(error)) from None


def full_scale(file: CameraFile, conversion: Conversion) -> float:
    """Value of a file at full scale: as stated, else that of its type.

    Raises
    ------
    MeasurementError
        If neither is known, or values lie far below zero.
    """
    low, high = file.extremes
    white = conversion.white or file.white
    if low < -MOST_BELOW * (white or max(high, 0.0)):
        raise MeasurementError(
            f"{file.path}: values must not be negative, they run from {low:.6g} to {high:.6g} ({file.kind}): "
            "a difference of two pictures, or one with its mean taken away? Give the pictures as the camera "
            "wrote them"
        )
    if white is None:
        raise MeasurementError(
            f"{file.path}: values run from {low:.6g} to {high:.6g} ({file.kind}), and the file does not tell "
            f"the value at full scale: state it, {_full_scales(file, high)}"
        )
    return white


def _full_scales(file: CameraFile, high: float) -> str:
    """Say which full scales are likely."""
    usual = [each for each in USUAL_FULL_SCALES if each >= high]
    if not usual or (high < FEW_COUNTS and (file.counts != np.round(file.counts)).any()):
        return "as --white V, where V is the value of a saturated pixel"
    others = ", ".join(f"{each:g}" for each in usual[1:])
    return f"as --white {usual[0]:g}" + (f" (or {others}, as the camera's bits are)" if others else "")


def response_named(text: str) -> Response | Tabulated:
    """Read linear, srgb, gamma:G, or the file of a tabulated curve.

    Raises
    ------
    MeasurementError
        If it is none of these.
    """
    if text in ("linear", "srgb"):
        return Response(curve="srgb" if text == "srgb" else "linear")
    gamma = re.fullmatch(r"gamma:([0-9.]+)", text)
    try:
        if gamma:
            return Response(curve="gamma", gamma=float(gamma[1]))
        if Path(text).is_file():
            return read_table(text)
    except (LadderError, ValueError) as error:
        raise MeasurementError(f"response: {error}") from None
    raise MeasurementError(
        f"response: one of linear, srgb, gamma:G, estimate, or a file of lines 'encoded,linear'; got {text!r}"
    )


def response_from(ladder: Mapping[Path, float], conversion: Conversion) -> Tabulated:
    """Estimate the response from files of one scene with their relative exposures.

    Raises
    ------
    MeasurementError
        If the files do not determine a curve.
    """
    if conversion.black:
        raise MeasurementError(
            f"black: must be absent with a ladder, whose curve is that of the values as they are, got "
            f"{conversion.black:g}; give dark frames instead"
        )
    try:
        pictures = []
        for path in ladder:
            file = read(path)
            pictures.append(file.counts / full_scale(file, conversion))
        return estimate_response(pictures, list(ladder.values()))
    except LadderError as error:
        raise MeasurementError(f"ladder: {', '.join(map(str, ladder))}: {error}") from None


def linear_picture(file: CameraFile, conversion: Conversion) -> tuple[Array, Mask]:
    """Undo response and mosaic of a file; its level without light stays in.

    Returns
    -------
    picture, saturated : array, shape (rows, columns, channels); bool array, shape (rows, columns)
        Linear values as shares of full scale, and pixels of which any value was saturated.
    """
    share = file.counts / full_scale(file, conversion)
    picture = conversion.response.decode(share)
    saturated = np.asarray((share >= FULL_SCALE).any(axis=-1))
    pattern = file.bayer or (conversion.bayer if share.shape[-1] == 1 else None)
    if pattern is not None:
        picture = superpixels(picture[..., 0], pattern)
        saturated = np.asarray(superpixels(saturated.astype(float), pattern).max(axis=-1) > 0)
    return picture, saturated


def decoded(picture: NDArray[Any], response: Mapping[str, Any] | None) -> NDArray[Any]:
    """Linear values of a picture, by a curve as plain data; as they are without one."""
    if response is None:
        return picture
    if "encoded" in response:
        curve: Tabulated | Response = Tabulated(np.array(response["encoded"]), np.array(response["linear"]))
    else:
        curve = Response.model_validate(response)
    return np.asarray(curve.decode(picture), dtype=np.float32)


def uncoloured(picture: Array, matrix: Array) -> Array:
    """Undo a colour matrix; scaled so that no unsaturated pixel gets above full scale."""
    inverse = np.linalg.inv(matrix)
    largest = float(np.maximum(inverse, 0.0).sum(axis=1).max())
    return np.asarray(picture @ inverse.T / max(largest, 1.0))
