"""Lens calibrations as fields of a design's camera."""

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from designlab.measurement.importing.lens_calibration import LensCalibration, read_calibration
from designlab.measurement.importing.lens_formats import LensError
from designlab.sensor.camera import PIXEL_ASPECTS, Camera
from designlab.sensor.field_errors import explain
from designlab.sensor.lens import Distortion

PROPORTION = 2e-3  # within which two sizes have one proportion
SQUARE = 1e-9  # within which fx and fy are one number


def lens_fields(
    path: str | Path, camera: Camera, *, fisheye: bool | None = None, size_px: tuple[int, int] | None = None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Read a calibration as changes of a design's fields, see `read_calibration` and `fields_of`."""
    return fields_of(read_calibration(path, fisheye=fisheye, size_px=size_px), camera)


def fields_of(calibration: LensCalibration, camera: Camera) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Put a calibration into terms of a design.

    Parameters
    ----------
    calibration : LensCalibration
        What the file says.
    camera : Camera
        The camera that was calibrated; pictures of another size must be its full sensor, binned or enlarged.

    Returns
    -------
    changes, notes
        Dotted paths with values for `Design.replace`, and what was assumed.

    Raises
    ------
    LensError
        Naming the file and what is wrong or cannot be represented.
    """
    path, size, matrix = calibration.path, calibration.size_px, calibration.matrix
    notes = list(calibration.notes)
    scale = camera.width_px / size[0]
    if abs(size[1] * scale / camera.height_px - 1) > PROPORTION:
        turned = abs(size[0] / size[1] - camera.height_px / camera.width_px) < PROPORTION
        advice = (
            "width and height seem to be exchanged"
            if turned
            else "a mode that crops sees another part of the sensor: calibrate on whole pictures, or set "
            "camera.width_px and height_px to the pictures of that mode"
        )
        raise LensError(
            f"{path}: image size {size[0]} x {size[1]} px: must have the proportion of the full sensor of "
            f"{camera.width_px} x {camera.height_px} px; {advice}"
        )
    if scale != 1:
        notes.append(
            f"{path}: calibrated at {size[0]} x {size[1]} px, taken for the whole sensor of "
            f"{camera.width_px} x {camera.height_px} px, binned"
        )
    aspect = float(matrix[1, 1] / matrix[0, 0])
    low, high = PIXEL_ASPECTS
    if not low <= aspect <= high:
        raise LensError(
            f"{path}: field {calibration.fields['matrix']}: fy over fx must be {low:g} to {high:g}, got "
            f"{matrix[1, 1]:g} / {matrix[0, 0]:g} = {aspect:.4g}; were the pictures stretched?"
        )
    fields = {
        "lens": "fisheye" if calibration.fisheye else "pinhole",
        "horizontal_fov_deg": calibration.horizontal_fov_deg,
        # OpenCV counts from the centre of the first pixel, a design from its edge.
        "principal_point_px": [(float(matrix[axis, 2]) + 0.5) * scale for axis in (0, 1)],
        "pixel_aspect": 1.0 if abs(aspect - 1) < SQUARE else aspect,
    }
    coefficients = {name: calibration.coefficients.get(name, 0.0) for name in Distortion.model_fields}
    try:
        Camera.model_validate({**camera.model_dump(), **fields, "distortion": coefficients})
    except ValidationError as error:
        raise LensError(f"{path}: is no lens a design can have: {explain(error)}") from None
    changes = fields | {f"distortion.{name}": value for name, value in coefficients.items()}
    return {f"camera.{name}": value for name, value in changes.items()}, tuple(notes)
