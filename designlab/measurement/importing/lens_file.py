"""Lens calibrations in OpenCV's formats, as fields of a design's camera."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from pydantic import ValidationError

from designlab.core.types import Array
from designlab.sensor.camera import Camera
from designlab.sensor.design import explain
from designlab.sensor.lens import Distortion, Fisheye

# Names that OpenCV's samples, ROS and most scripts use, in small letters without underscores.
MATRIX_NAMES = ("cameramatrix", "cameramatrix1", "intrinsicmatrix", "mtx", "k")
DISTORTION_NAMES = ("distcoeffs", "distortioncoefficients", "distcoeff", "distortion", "dist", "d")
WIDTH_NAMES, HEIGHT_NAMES = ("imagewidth", "width"), ("imageheight", "height")
FISHEYE_NAMES = ("fisheyemodel", "fisheye")
PINHOLE_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "taux", "tauy")
FISHEYE_ORDER = ("k1", "k2", "k3", "k4")
MOST_OFF_PX = 0.5  # at the edge of the picture, for one focal length in both directions
PROPORTION = 2e-3  # within which two sizes have one proportion


class LensError(ValueError):
    """A calibration that cannot be read, or says what the camera model cannot."""


class LensCalibration(NamedTuple):
    """What a file says: matrix (3, 3) and distances in px of the calibrated pictures."""

    matrix: Array
    distortion: Array
    size_px: tuple[int, int] | None
    fisheye: bool


def lens_fields(
    path: str | Path, camera: Camera, *, fisheye: bool | None = None, size_px: tuple[int, int] | None = None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Read a calibration as changes of a design's fields.

    Parameters
    ----------
    path : path
        YAML, XML or JSON of cv2.FileStorage, camera_info YAML of ROS, or plain .json or .npz with
        camera_matrix and dist_coeffs.
    camera : Camera
        The camera that was calibrated; pictures of another size must be its full sensor, binned or enlarged.
    fisheye : bool, optional
        Whether cv2.fisheye was used; what the file says when absent, else not.
    size_px : tuple of int, optional
        Width and height of the calibrated pictures; what the file says when absent, else the full sensor.

    Returns
    -------
    changes, notes
        Dotted paths with values for `Design.replace`, and what was rounded or assumed.

    Raises
    ------
    LensError
        Naming the file and what is wrong or cannot be represented.
    """
    found = read_calibration(path)
    fish = found.fisheye if fisheye is None else fisheye
    notes = []
    size = size_px or found.size_px
    if size is None:
        size = (camera.width_px, camera.height_px)
        notes.append(
            f"{path}: states no image size, so it is taken for that of the sensor, {size[0]} x {size[1]}"
        )
    scale = camera.width_px / size[0]
    if abs(size[1] * scale / camera.height_px - 1) > PROPORTION:
        raise LensError(
            f"{path}: image size {size[0]} x {size[1]} px: must have the proportion of the full sensor of "
            f"{camera.width_px} x {camera.height_px} px; calibrate on whole pictures, or correct "
            "camera.width_px and height_px"
        )
    if scale != 1:
        notes.append(f"{path}: calibrated at {size[0]} x {size[1]} px, taken for the whole sensor, binned")
    focal, note = _focal(found.matrix, size, str(path))
    notes += note
    distortion = _distortion(found.distortion, fish, str(path))
    # OpenCV counts from the centre of the first pixel, a design from its edge.
    centre = [(float(found.matrix[axis, 2]) + 0.5) * scale for axis in (0, 1)]
    half = size[0] / 2 / focal
    try:
        if fish:
            right, _, forward = Fisheye(Distortion(**distortion)).direction(np.array([half]), np.zeros(1))
            half_angle = float(np.arctan2(right[0], forward[0]))
        else:
            half_angle = float(np.arctan(half))
        fields = {
            "lens": "fisheye" if fish else "pinhole",
            "horizontal_fov_deg": float(np.degrees(2 * half_angle)),
            "principal_point_px": centre,
        }
        Camera.model_validate({**camera.model_dump(), **fields, "distortion": distortion})
    except ValidationError as error:
        raise LensError(f"{path}: is no lens a design can have: {explain(error)}") from None
    except ValueError as error:
        raise LensError(f"{path}: is no lens a design can have: {error}") from None
    coefficients = {f"distortion.{name}": distortion.get(name, 0.0) for name in Distortion.model_fields}
    return {f"camera.{name}": value for name, value in (fields | coefficients).items()}, tuple(notes)


def read_calibration(path: str | Path) -> LensCalibration:
    """Read camera matrix, distortion and image size from a file.

    Raises
    ------
    LensError
        Naming the file and what is missing.
    """
    path = Path(path)
    try:
        entries = dict(_entries(path))
    except (OSError, EOFError, ValueError, KeyError, AttributeError, ElementTree.ParseError) as error:
        raise LensError(f"{path}: cannot be read as a calibration: {error}") from None
    matrix = _one(entries, MATRIX_NAMES)
    distortion = _one(entries, DISTORTION_NAMES)
    if matrix is None or distortion is None:
        missing = "camera_matrix" if matrix is None else "distortion_coefficients"
        raise LensError(
            f"{path}: field {missing}: missing; has {', '.join(entries) or 'nothing that is known'}"
        )
    matrix = np.asarray(matrix, dtype=float)
    if matrix.size != 9:
        raise LensError(f"{path}: field camera_matrix: must be 3 x 3, got shape {matrix.shape}")
    width, height = _one(entries, WIDTH_NAMES), _one(entries, HEIGHT_NAMES)
    size = None if width is None or height is None else (int(np.ravel(width)[0]), int(np.ravel(height)[0]))
    if size is None and (both := _one(entries, ("imagesize",))) is not None and np.size(both) == 2:
        size = (int(np.ravel(both)[0]), int(np.ravel(both)[1]))
    model = str(_one(entries, ("distortionmodel",)) or "")
    flag = _one(entries, FISHEYE_NAMES)
    fisheye = model in ("equidistant", "fisheye") or (flag is not None and bool(float(np.ravel(flag)[0])))
    values = np.ravel(np.asarray(distortion, dtype=float))
    return LensCalibration(matrix.reshape(3, 3), values, size, fisheye)


def _focal(matrix: Array, size: tuple[int, int], path: str) -> tuple[float, list[str]]:
    """One focal length in px for both directions, where that is as good as two."""
    x, y, skew = float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 1])
    if not (x > 0 and y > 0):
        raise LensError(f"{path}: field camera_matrix: fx and fy must be positive, got {x:g} and {y:g}")
    if skew != 0:
        raise LensError(f"{path}: field camera_matrix: a design has no skew, must be 0, got {skew:g}")
    # Both edges are off alike where the mean is weighed by the sides of the picture.
    focal = (size[0] * x + size[1] * y) / (size[0] + size[1])
    off = max(size[0] / 2 * abs(x / focal - 1), size[1] / 2 * abs(y / focal - 1))
    if off > MOST_OFF_PX:
        raise LensError(
            f"{path}: field camera_matrix: a design's pixels are square, so fx and fy must agree up to "
            f"{MOST_OFF_PX:g} px at the edge of the picture; {x:.6g} and {y:.6g} are {off:.2g} px off; "
            "calibrate with cv2.CALIB_FIX_ASPECT_RATIO, or on pictures that were not stretched"
        )
    if x == y:
        return x, []
    return focal, [f"{path}: fx {x:.6g} and fy {y:.6g} are taken as {focal:.6g}, {off:.2g} px at the edge"]


def _distortion(values: Array, fisheye: bool, path: str) -> dict[str, float]:
    order = FISHEYE_ORDER if fisheye else PINHOLE_ORDER
    if len(values) > len(order) or (fisheye and len(values) != 4):
        raise LensError(
            f"{path}: field distortion_coefficients: {'4' if fisheye else 'at most 14'} are known for a "
            f"{'fisheye' if fisheye else 'pinhole'} lens, got {len(values)}"
        )
    named = dict(zip(order, map(float, values), strict=False))
    known = FISHEYE_ORDER if fisheye else ("k1", "k2", "p1", "p2", "k3")
    foreign = {name: value for name, value in named.items() if name not in known and value != 0}
    if foreign:
        shown = ", ".join(f"{name} = {value:g}" for name, value in foreign.items())
        raise LensError(
            f"{path}: field distortion_coefficients: a design's pinhole lens has k1 k2 p1 p2 k3 alone, got "
            f"also {shown}; calibrate without the rational, thin prism and tilted models, or as a fisheye"
        )
    return {name: value for name, value in named.items() if name in known}


def _one(entries: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    plain = {name.lower().replace("_", "").replace("-", ""): value for name, value in entries.items()}
    return next((plain[name] for name in names if name in plain), None)


def _entries(path: Path) -> Iterator[tuple[str, Any]]:
    """Matrices and single values of a file, by name."""
    suffix = path.suffix.lower()
    if suffix == ".npz":
        with np.load(path, allow_pickle=False) as stored:
            yield from ((name, stored[name]) for name in stored.files)
        return
    text = path.read_text(encoding="utf-8")
    if suffix == ".json":
        for name, value in json.loads(text).items():
            yield name, _matrix(value) if isinstance(value, dict) else value
    elif suffix == ".xml" or text.lstrip().startswith("<"):
        for node in ElementTree.fromstring(text):
            parts = {part.tag: part.text or "" for part in node}
            yield node.tag, _matrix(parts) if "data" in parts else (node.text or "").strip()
    else:
        # What a YAML library makes of "%YAML:1.0" and "!!opencv-matrix" differs; the blocks are simple.
        matrices = r"^(\w+):[^\S\n]*(?:!!opencv-(?:nd-)?matrix)?[^\S\n]*\n((?:[^\S\n]+\S.*\n)+)"
        for name, block in re.findall(matrices, f"{text}\n", re.MULTILINE):
            parts = dict(re.findall(r"(\w+):\s*(\[[^\]]*\]|\S+)", block))
            if "data" in parts:
                yield name, _matrix(parts)
        for name, value in re.findall(r"^(\w+):[^\S\n]+([^\s!].*?)[^\S\n]*$", text, re.MULTILINE):
            numbers = re.fullmatch(r"\[([^\]]*)\]", value)
            yield name, [float(part) for part in numbers[1].split(",")] if numbers else value.strip("\"'")


def _matrix(parts: Mapping[str, Any]) -> Array:
    data = parts["data"]
    if isinstance(data, str):
        data = [float(part) for part in data.strip(" []\n").replace(",", " ").split()]
    values = np.asarray(data, dtype=float)
    # OpenCV 5 writes vectors as matrices of one dimension.
    return values.reshape(int(parts["rows"]), int(parts["cols"])) if "rows" in parts else values.ravel()
