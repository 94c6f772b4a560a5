"""Files that hold lens calibrations, as names and values: YAML, XML, JSON, NumPy archives, COLMAP's lists."""

import codecs
import io
import json
import re
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import yaml

MOST_BYTES = 64 * 2**20  # calibrations with all the corners that were found are smaller
OPENCV = "OpenCV FileStorage"
COLMAP = "COLMAP cameras.txt"
COLMAP_LINE = re.compile(r"\d+\s+([A-Z][A-Z_]*)\s+(\d+)\s+(\d+)\s+(\S.*)")
COLMAP_MODELS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
}
"""Parameters of COLMAP's camera models (src/colmap/sensor/models.h) by OpenCV's names."""


class LensError(ValueError):
    """A calibration that cannot be read, or says what the camera model cannot."""


class Document(NamedTuple):
    """What one document of a file says: its kind, and values by the names they have in the file.

    Values are text, numbers, arrays, and lists and mappings of these; scalars of YAML and XML stay text.
    """

    kind: str
    values: Mapping[str, Any]


def read_documents(path: str | Path) -> list[Document]:
    """Read all documents of a file, whose kind is told by its content.

    Raises
    ------
    LensError
        Naming the file and what is wrong with it.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LensError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not data.strip():
        raise LensError(f"{path}: is empty")
    if len(data) > MOST_BYTES:
        raise LensError(f"{path}: has {len(data)} bytes, more than a calibration needs; save it alone")
    try:
        return _documents(path, data)
    except RecursionError:
        raise LensError(f"{path}: cannot be read as a calibration: it is nested too deeply") from None


def _documents(path: Path, data: bytes) -> list[Document]:
    if data.startswith(b"PK") or path.suffix.lower() == ".npz":
        return [Document("NumPy archive", _arrays(path, data))]
    if data.startswith(b"\x93NUMPY"):
        raise LensError(f"{path}: holds one array; save matrix, distortion and size together by numpy.savez")
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise LensError(f"{path}: is no text in UTF-8 ({error.reason} at byte {error.start})") from None
    start = text.lstrip()[:1]
    if start == "<":
        return [_xml(path, data)]
    suffix = path.suffix.lower()
    if suffix == ".json" or (start == "{" and suffix not in (".yaml", ".yml")):
        return [_json(path, text)]
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if lines and all(COLMAP_LINE.fullmatch(line) for line in lines):
        return [_colmap(path, line) for line in lines]
    return _yaml(path, text)


def _arrays(path: Path, data: bytes) -> dict[str, Any]:
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise LensError(f"{path}: is no NumPy archive (.npz), or is cut short")
    found = {}
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as stored:
            for name in stored.files:
                try:
                    array = stored[name]
                    found[name] = array if array.ndim else array.item()
                except ValueError as error:
                    if "allow_pickle" not in str(error):
                        raise
                    # An array of Python objects: corners or views, which no calibration needs.
    except Exception as error:  # a damaged archive fails in many ways in zipfile, zlib and NumPy
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LensError(f"{path}: cannot be read as a NumPy archive: {reason}") from None
    return found


def _xml(path: Path, data: bytes) -> Document:
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise LensError(f"{path}: cannot be read as XML: {error}") from None
    values = _branch(root)
    if not isinstance(values, dict):
        raise LensError(f"{path}: holds no names with values")
    return Document(f"{OPENCV} XML" if root.tag == "opencv_storage" else "XML", values)


def _branch(node: ElementTree.Element) -> Any:
    if not len(node):
        return (node.text or "").strip().strip('"')
    if all(child.tag == "_" for child in node):  # a sequence of OpenCV
        return [_branch(child) for child in node]
    return {child.tag: _branch(child) for child in node}


def _json(path: Path, text: str) -> Document:
    try:
        values = json.loads(text.lstrip("\ufeff"))
    except ValueError as error:
        raise LensError(f"{path}: cannot be read as JSON: {error}") from None
    if isinstance(values, list):
        values = {str(number): each for number, each in enumerate(values)}
    return Document(f"{OPENCV} JSON" if '"opencv-matrix"' in text else "JSON", values)


def _yaml(path: Path, text: str) -> list[Document]:
    if "!!python/object" in text:
        raise LensError(
            f"{path}: holds Python objects, such as NumPy arrays; write lists of numbers (.tolist())"
        )
    # OpenCV writes %YAML:1.0, which is no directive of YAML's.
    plain = re.sub(r"\A(\s*%YAML.*)+\n", "", text)
    try:
        # Scalars stay text: YAML 1.1 takes 1e-05 for text, 0640 for 416 and 1:30 for 90.
        found = list(yaml.load_all(plain, Loader=yaml.BaseLoader))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = "" if mark is None else f" in line {mark.line + 1 + text.count('%YAML')}"
        raise LensError(f"{path}: cannot be read as YAML: {error.problem or error.context}{where}") from None
    except (yaml.YAMLError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise LensError(f"{path}: cannot be read as YAML: {reason}") from None
    documents = [each for each in found if isinstance(each, dict) and each]
    if not documents:
        raise LensError(f"{path}: holds no names with values; is it a lens calibration?")
    opencv = text.lstrip().startswith("%YAML:") or "!!opencv-" in text
    return [Document(f"{OPENCV} YAML" if opencv else _kind(each), each) for each in documents]


def _kind(values: Mapping[str, Any]) -> str:
    """What writes YAML with such names."""
    if any(re.fullmatch(r"cam\d+", str(name)) for name in values):
        return "Kalibr camchain"
    small = {str(name).lower() for name in values}
    matrix = values.get("camera_matrix")
    if (isinstance(matrix, Mapping) and "data" in matrix) or {"d", "k", "r", "p"} <= small:
        return "ROS camera_info"
    return "YAML"


def _colmap(path: Path, line: str) -> Document:
    match = COLMAP_LINE.fullmatch(line)
    assert match is not None
    model, width, height, rest = match.groups()
    if model not in COLMAP_MODELS:
        raise LensError(f"{path}: camera model {model} is not known; known are {', '.join(COLMAP_MODELS)}")
    names, numbers = COLMAP_MODELS[model].split(), rest.split()
    if len(names) != len(numbers):
        raise LensError(
            f"{path}: camera model {model} has {len(names)} parameters ({' '.join(names)}), "
            f"got {len(numbers)}"
        )
    values = {"model": model, "width": width, "height": height, **dict(zip(names, numbers, strict=True))}
    return Document(COLMAP, values)
