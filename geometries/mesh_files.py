"""Mesh files that users bring: their formats, their units, and the side that presses.

Only the surface seen from the side that presses counts, so scans and bodies with holes will do.
"""

import json
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast, get_args
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from geometries import step, three_mf

if TYPE_CHECKING:
    import trimesh

Unit = Literal["um", "mm", "cm", "m", "inch"]
Side = Literal["+z", "-z", "+x", "-x", "+y", "-y"]

FORMATS = {
    ".stl": "STL",
    ".obj": "OBJ",
    ".ply": "PLY",
    ".off": "OFF",
    ".glb": "GLB",
    ".gltf": "glTF",
    ".3mf": "3MF",
    ".step": "STEP",
    ".stp": "STEP",
}
"""Files that are read, by the end of their name."""
UNITS_MM: dict[Unit, float] = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
"""Units that a file may be in, in mm."""
SIDES: tuple[Side, ...] = get_args(Side)
"""Sides of a body, by its file's axes."""

PLAUSIBLE_MM = 1.0, 200.0
"""Largest extent of a body whose unit nobody states."""
POSSIBLE_MM = 0.05, 1000.0
"""Largest extent of any body."""

_METRES = ("GLB", "glTF")  # by their standard
_STL_HEADER, _STL_TRIANGLE = 84, 50  # bytes
_STL_TYPE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attributes", "<u2")])
_THIN = 1e-6  # of the largest extent
_SMALLEST, _LARGEST, _FAR = 1e-9, 1e12, 1e9  # numbers beyond these are damage, or lose the body in rounding
# Rows are the axes x, y and z of the probe in those of the file: the side is turned up the shortest way.
_TURNS: dict[Side, tuple[tuple[int, int, int], ...]] = {
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "+x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}


class MeshNote(UserWarning):
    """Something about a mesh file that its user should know."""


class MeshFile(NamedTuple):
    """What a mesh file holds, in its own unit and axes.

    Attributes
    ----------
    form : str
        Name of its format.
    corners : array, shape (triangles, 3, 3)
        Corners of its triangles. They need not close.
    extents : array, shape (3,)
        Extents along the axes.
    unit : str or None
        Unit that the file states.
    notes : tuple of str
        What was left out or taken for something else.
    """

    form: str
    corners: NDArray[np.float64]
    extents: NDArray[np.float64]
    unit: Unit | None
    notes: tuple[str, ...]


class Understood(NamedTuple):
    """What a mesh file was taken for.

    Attributes
    ----------
    file : str
        The file.
    form : str
        Name of its format.
    triangles : int
        How many there are.
    unit : str or None
        Unit of its numbers; None where the body is scaled to a stated size.
    extents_mm : tuple of float
        Extents of the body along the axes of the file (mm).
    side : str
        Side that presses.
    notes : tuple of str
        What was left out or taken for something else.
    """

    file: str
    form: str
    triangles: int
    unit: Unit | None
    extents_mm: tuple[float, float, float]
    side: Side
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """One line for people."""
        scale = "scaled to" if self.unit is None else f"in {self.unit}:"
        extents = _as_text(np.array(self.extents_mm))
        return f"{self.file}: {self._kind}, {scale} {extents} mm, pressed with its {self.side} side"

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "file": self.file,
            "as": f"{self._kind}, pressed with its {self.side} side",
            "unit": self.unit,
            "extents_mm": list(self.extents_mm),
            "side": self.side,
            "notes": list(self.notes),
        }

    @property
    def _kind(self) -> str:
        return f"{self.form}, {self.triangles:,} triangles"


def read(path: str | Path) -> MeshFile:
    """Read a mesh file.

    Parameters
    ----------
    path : str or Path
        STL, OBJ, PLY, OFF, GLB, glTF, 3MF or STEP file.

    Raises
    ------
    ValueError
        Naming file and rule, where the file cannot be read or holds no triangles.
    """
    with _named(path):
        return _parsed(*_content(Path(path)))


def files_of(path: str | Path) -> list[Path]:
    """List a mesh file and the files that it needs beside it, as glTF does; those that exist.

    Parameters
    ----------
    path : str or Path
        The mesh file.
    """
    path = Path(path)
    try:
        names = _needed(path.read_bytes(), path.suffix.lower())
    except (OSError, _BadMeshError):
        names = ()
    return [file for file in (path, *(path.parent / name for name in names)) if file.is_file()]


def own_size_mm(path: str | Path, *, unit: Unit | None = None, side: Side = "+z") -> float:
    """Return the larger extent of a body across the direction in which it is pressed, by its own unit.

    Parameters
    ----------
    path : str or Path
        Mesh file.
    unit : str, optional
        Unit of the file, see `UNITS_MM`. Where neither it nor the file says one it is mm, if that is
        plausible.
    side : str
        Side that presses, see `SIDES`.

    Returns
    -------
    float
        The extent in mm.

    Warns
    -----
    MeshNote
        About what was left out or taken for something else.

    Raises
    ------
    ValueError
        If the file cannot be used, or its unit must be stated; says which units would be plausible.
    """
    file = read(path)
    unit, note = _unit(path, file, unit)
    for text in (*file.notes, *note):
        warnings.warn(f"{path}: {text}", MeshNote, stacklevel=3)
    own = file.extents * UNITS_MM[unit]
    low, high = POSSIBLE_MM
    if not low <= own.max() <= high:
        raise ValueError(
            f"{path}: {_as_text(own)} mm with its unit taken as {unit}; the largest extent must lie between "
            f"{low:g} and {high:g} mm; state another unit (--probe-unit {'|'.join(UNITS_MM)})"
        )
    return float(np.abs(_turned(own, side))[:2].max())


def load(
    path: str | Path, *, size_mm: float | None = None, unit: Unit | None = None, side: Side = "+z"
) -> "trimesh.Trimesh":
    """Read a body from a mesh file and place it to be pressed.

    The side that presses is turned to +z: -z about x, sides along x about y, sides along y about x. The mesh
    is centred in x and y on its bounding box and moved along z until its foremost point lies at z = 0.

    Parameters
    ----------
    path : str or Path
        Mesh file, see `FORMATS`.
    size_mm : float, optional
        Scales the body so that its larger extent across the pressing direction has this length (mm).
    unit : str, optional
        Unit of the file where no size is given, see `own_size_mm`.
    side : str
        Side that presses, by the file's axes.

    Returns
    -------
    trimesh.Trimesh
        The triangles of the file (mm). They need not close. Not to be changed: it is kept for later calls.

    Raises
    ------
    ValueError
        Naming file and rule, where the file cannot be used or nothing of it faces that side.
    """
    if size_mm is None:
        size_mm = own_size_mm(path, unit=unit, side=side)
    elif not (np.isfinite(size_mm) and size_mm > 0):
        raise ValueError(f"{path}: size_mm must be positive, is {size_mm:g} mm")
    with _named(path):
        return _placed(*_content(Path(path)), size_mm, side)


def understood(path: str | Path, *, size_mm: float, side: Side = "+z") -> Understood:
    """Say what a mesh file is taken for.

    Parameters
    ----------
    path : str or Path
        The mesh file.
    size_mm : float
        Larger extent across the pressing direction (mm).
    side : str
        Side that presses.
    """
    file = read(path)
    own = file.extents
    factor = size_mm / float(np.abs(_turned(own, side))[:2].max())
    unit = next((u for u, mm in UNITS_MM.items() if np.isclose(factor, mm, rtol=1e-6)), None)
    notes = (*file.notes, *(_unit(path, file, None)[1] if unit == "mm" else ()))
    x, y, z = (float(f"{extent:.6g}") for extent in own * factor)
    return Understood(str(path), file.form, len(file.corners), unit, (x, y, z), side, notes)


def closed(body: "trimesh.Trimesh") -> tuple["trimesh.Trimesh", tuple[str, ...]]:
    """Repair a body so that it can be made: corners joined, small holes filled, normals outwards.

    Parameters
    ----------
    body : trimesh.Trimesh
        What `load` gave.

    Returns
    -------
    body, notes
        A copy, and what was repaired; it is watertight unless the surface could not be closed.
    """
    import trimesh

    body, notes = body.copy(), []
    body.merge_vertices(merge_tex=True, merge_norm=True)
    body.update_faces(body.nondegenerate_faces() & body.unique_faces())
    if not body.is_watertight:
        trimesh.repair.fill_holes(body)
        if body.is_watertight:
            notes.append("holes were filled")
    with np.errstate(divide="ignore", invalid="ignore"):  # trimesh divides by the volume, which may be zero
        if body.is_watertight and not (body.is_winding_consistent and body.volume > 0):
            body.fix_normals()
            notes.append("normals were turned outwards")
    body.remove_unreferenced_vertices()
    return body, tuple(notes)


class _BadMeshError(Exception):
    """A rule that the content of a mesh file breaks."""


@contextmanager
def _named(path: str | Path) -> Iterator[None]:
    """Say what is wrong with a file as a `ValueError` that names it."""
    try:
        yield
    except OSError as error:
        beside = error.filename and Path(error.filename) != Path(path)
        what = f"needs {error.filename}, which cannot be read" if beside else "cannot be read"
        raise ValueError(f"{path}: {what} ({error.strerror or error})") from None
    except _BadMeshError as rule:
        raise ValueError(f"{path}: {rule}") from None


def _content(path: Path) -> tuple[bytes, str, tuple[tuple[str, bytes], ...]]:
    """Content of a file, the end of its name, and the files that it needs."""
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise _BadMeshError(f"a mesh file ends in {', '.join(FORMATS)}, not {path.suffix!r}")
    data = path.read_bytes()
    if not data.strip():
        raise _BadMeshError("the file is empty")
    return data, suffix, tuple((name, (path.parent / name).read_bytes()) for name in _needed(data, suffix))


def _needed(data: bytes, suffix: str) -> tuple[str, ...]:
    """Names of the buffers that a glTF file keeps in files beside it."""
    if suffix != ".gltf":
        return ()
    try:
        buffers = json.loads(data)["buffers"]
        names = [unquote(buffer["uri"]) for buffer in buffers if "uri" in buffer]
    except (ValueError, KeyError, TypeError) as error:
        raise _BadMeshError(f"is not a valid glTF file ({type(error).__name__}: {error})") from None
    names = [name for name in names if not name.startswith("data:")]
    if outside := [name for name in names if Path(name).is_absolute() or ".." in Path(name).parts]:
        raise _BadMeshError(f"its buffers must lie in its own folder, it names {outside[0]!r}")
    return tuple(names)


@lru_cache(maxsize=4)
def _placed(
    data: bytes, suffix: str, parts: tuple[tuple[str, bytes], ...], size_mm: float, side: Side
) -> "trimesh.Trimesh":
    """Turn, scale and shift a body; cached by content because every press needs it."""
    import trimesh

    points = _turned(_parsed(data, suffix, parts).corners, side)
    low, extents = _box(points)
    across, deep = float(extents[:2].max()), float(extents[2])
    a, b = points[:, 1, :2] - points[:, 0, :2], points[:, 2, :2] - points[:, 0, :2]
    if not np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() > _THIN * across**2:
        raise _BadMeshError(f"nothing of it faces its {side} side, choose another with --probe-side")
    if deep <= _THIN * across:
        raise _BadMeshError(f"the body has no thickness, its extents are {_as_text(_turned(extents, side))}")
    points -= (low[0] + extents[0] / 2, low[1] + extents[1] / 2, low[2] + deep)
    points *= size_mm / across
    return trimesh.Trimesh(points.reshape(-1, 3), np.arange(3 * len(points)).reshape(-1, 3), process=False)


def _box(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest corner and extents of points, shape (..., 3); axis by axis, which is the quicker way."""
    low = np.array([points[..., axis].min() for axis in range(3)])
    return low, np.array([points[..., axis].max() for axis in range(3)]) - low


def _turned(vectors: NDArray[np.float64], side: Side) -> NDArray[np.float64]:
    """Turn vectors of the file's axes, shape (..., 3), so that a side faces +z."""
    return np.asarray(vectors @ np.array(_TURNS[side], dtype=float).T)


def _unit(path: str | Path, file: MeshFile, unit: Unit | None) -> tuple[Unit, tuple[str, ...]]:
    """Unit of a file, and a note where it is a guess against the format's standard."""
    if unit is not None:
        return unit, ()
    own, (low, high) = file.extents, PLAUSIBLE_MM
    fits = {name: low <= own.max() * mm <= high for name, mm in UNITS_MM.items()}
    by_standard = file.form in _METRES
    taken = file.unit or "mm"
    if fits[taken] or (file.unit is not None and not by_standard):
        in_inch = own * UNITS_MM["inch"]
        if file.unit is None and _round(in_inch) and not _round(own) and fits["inch"]:
            return taken, (
                f"taken as mm; in inch it would be {_as_text(in_inch)} mm, round numbers: state --probe-unit",
            )
        return taken, ()
    if by_standard and fits["mm"]:
        return "mm", (
            f"{file.form} files are in metres by their standard, which makes {_as_text(own)} m of it; taken "
            "as mm, state --probe-unit m if it is so large",
        )
    wrong = "small" if own.max() * UNITS_MM[taken] < low else "large"
    would = [f"{name} ({_as_text(own * UNITS_MM[name])} mm)" for name, fit in fits.items() if fit]
    said = " or ".join(would) if would else "none; or give its size in mm, FILE:SIZE"
    raise ValueError(
        f"{path}: {_as_text(own)} in its file, which is too {wrong} for a probe in {taken}; state its unit "
        f"(--probe-unit, or FILE:UNIT in a text); plausible: {said}"
    )


@lru_cache(maxsize=4)
def _parsed(data: bytes, suffix: str, parts: tuple[tuple[str, bytes], ...]) -> MeshFile:
    """Parse and check a mesh file; cached by content because every press needs it."""
    form = FORMATS[suffix]
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            corners, unit, notes = _triangles(data, form, dict(parts))
    except _BadMeshError:
        raise
    except Exception as error:  # readers fail on bad bytes with almost any type
        why = " ".join(str(error).split())[:200]
        raise _BadMeshError(f"is not a valid {form} file ({type(error).__name__}: {why})") from None
    if not len(corners):
        raise _BadMeshError(f"holds no triangles, or is not a valid {form} file")
    if not np.isfinite(corners).all():
        raise _BadMeshError("has vertices that are not finite numbers")
    _, extents = _box(corners)
    if not _SMALLEST < extents.max() < _LARGEST or np.abs(corners).max() > _FAR * extents.max():
        raise _BadMeshError(f"its extents are {_as_text(extents)}, which no unit makes a probe of")
    return MeshFile(form, corners, extents, unit, notes)


def _triangles(
    data: bytes, form: str, parts: Mapping[str, bytes]
) -> tuple[NDArray[np.float64], Unit | None, tuple[str, ...]]:
    """Corners of all triangles, shape (n, 3, 3), the unit if it is stated, and notes."""
    if form == "STL":
        corners, notes = _stl(data)
        return corners, None, notes
    if form == "3MF":
        corners, unit = three_mf.read(data)
        return corners, cast("Unit", unit), ()
    if form == "STEP":
        return step.read(data), "mm", ()  # CadQuery converts to mm
    import trimesh

    resolver = cast("Any", parts)  # of which trimesh wants `get` alone
    body = trimesh.load_mesh(
        BytesIO(data), file_type=form.lower(), process=False, skip_materials=True, resolver=resolver
    )
    if not isinstance(body, trimesh.Trimesh) or not len(body.faces):
        raise _BadMeshError(f"holds no triangles, or is not a valid {form} file")
    return np.asarray(body.triangles, dtype=float), "m" if form in _METRES else None, ()


def _stl(data: bytes) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Read either form of STL; a binary file may begin with 'solid' and go on behind its last triangle."""
    count = int.from_bytes(data[_STL_HEADER - 4 : _STL_HEADER], "little") if len(data) >= _STL_HEADER else 0
    there, over = divmod(max(len(data) - _STL_HEADER, 0), _STL_TRIANGLE)
    if re.match(rb"\s*solid\b", data, re.IGNORECASE) and b"\0" not in data:
        return _stl_text(data)
    if 0 < count <= there:
        corners = np.frombuffer(data, _STL_TYPE, count=count, offset=_STL_HEADER)["corners"].astype(float)
        behind = over + (there - count) * _STL_TRIANGLE
        notes = (f"{behind:,} bytes behind its last triangle are left out",) if behind else ()
        return corners, notes
    if there < count <= 1000 * max(there, 1):
        raise _BadMeshError(f"is cut short: its header states {count:,} triangles, {there:,} are there")
    raise _BadMeshError("holds no triangles, or is not a valid STL file")


def _stl_text(data: bytes) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    text = data.lower()
    if b"endsolid" not in text:
        raise _BadMeshError("is cut short: its solid does not end")
    numbers = b" ".join(re.findall(rb"\bvertex\s+([^\n]+)", text))
    commas = b"," in numbers
    if commas:
        numbers = numbers.replace(b",", b".")
    found = np.fromstring(numbers.decode("latin-1"), sep=" ")
    if len(found) != 9 * text.count(b"endfacet"):
        raise _BadMeshError("is not a valid STL file: not every facet has three corners of three numbers")
    return found.reshape(-1, 3, 3), ("decimal commas are read as points",) if commas else ()


def _round(lengths_mm: NDArray[np.float64]) -> bool:
    """Whether all lengths are multiples of a tenth of a millimetre."""
    tenths = 10 * lengths_mm
    return bool(np.allclose(tenths, np.round(tenths), atol=1e-3, rtol=0))


def _as_text(lengths: NDArray[np.float64]) -> str:
    return " x ".join(f"{length:.4g}" for length in lengths)
