"""Triangles of a 3MF package (core specification 1.3, and parts in files of their own), in its unit."""

import zipfile
from io import BytesIO
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

_UNITS = {"micron": "um", "millimeter": "mm", "centimeter": "cm", "meter": "m", "inch": "inch"}
_CORNERS = ("v1", "v2", "v3")
_DEEPEST = 16  # levels of components within components; the specification forbids circles


class _Thing(NamedTuple):
    """An object of a package: triangles of its own, and other objects placed in it."""

    corners: NDArray[np.float64]
    placed: tuple[tuple[tuple[str, str], NDArray[np.float64]], ...]


def read(data: bytes) -> tuple[NDArray[np.float64], str]:
    """Read all triangles that a package would print.

    Parameters
    ----------
    data : bytes
        Content of the file.

    Returns
    -------
    corners : array, shape (triangles, 3, 3)
        Corners of the triangles, in the unit of the package.
    unit : str
        One of um, mm, cm, m and inch.

    Raises
    ------
    ValueError
        If the package has no model, or another unit.
    KeyError, zipfile.BadZipFile, xml.etree.ElementTree.ParseError
        If it is damaged.
    """
    things: dict[tuple[str, str], _Thing] = {}
    items, unit = [], None
    with zipfile.ZipFile(BytesIO(data)) as package:
        models = [name for name in package.namelist() if name.lower().endswith(".model")]
        for name in models:
            root = ElementTree.fromstring(package.read(name))
            for thing in _found(root, "object"):
                things[name, thing.attrib["id"]] = _thing(thing, name)
            if build := [_reference(item, name) for item in _found(root, "item")]:
                items += build
                unit = root.get("unit", "millimeter")
    if unit is None:
        raise ValueError("no model to build in the package")
    if unit not in _UNITS:
        raise ValueError(f"its unit is {unit!r}, known are {', '.join(_UNITS)}")
    corners = [_gathered(things, key, _DEEPEST) @ place[:3] + place[3] for key, place in items]
    return np.concatenate(corners), _UNITS[unit]


def _found(root: ElementTree.Element, tag: str) -> list[ElementTree.Element]:
    """Elements of a name, whatever their namespace."""
    return root.findall(f".//{{*}}{tag}")


def _thing(element: ElementTree.Element, file: str) -> _Thing:
    vertices = [[float(v.attrib[axis]) for axis in "xyz"] for v in _found(element, "vertex")]
    faces = [[int(t.attrib[corner]) for corner in _CORNERS] for t in _found(element, "triangle")]
    points, indices = np.array(vertices).reshape(-1, 3), np.array(faces, dtype=int).reshape(-1, 3)
    if len(indices) and indices.min() < 0:
        raise ValueError("a triangle has a negative corner")
    return _Thing(points[indices], tuple(_reference(part, file) for part in _found(element, "component")))


def _reference(element: ElementTree.Element, file: str) -> tuple[tuple[str, str], NDArray[np.float64]]:
    """Object that an item or component names, and its place: rows of a 4 x 3 matrix right of (x y z 1)."""
    path = next((value for key, value in element.attrib.items() if key.endswith("}path")), file)
    text = element.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0")
    place = np.array([float(part) for part in text.split()]).reshape(4, 3)
    return (path.lstrip("/"), element.attrib["objectid"]), place


def _gathered(
    things: dict[tuple[str, str], _Thing], key: tuple[str, str], levels: int
) -> NDArray[np.float64]:
    """Triangles of an object and of all that is placed in it."""
    if levels == 0:
        raise ValueError("objects lie within objects without end")
    thing = things[key]
    inner = [_gathered(things, of, levels - 1) @ place[:3] + place[3] for of, place in thing.placed]
    return np.concatenate([thing.corners, *inner])
