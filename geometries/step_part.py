"""A part of one's own: a closed STEP file that is read once and then kept in the specification."""

import base64
import tempfile
import zlib
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, model_validator

from geometries import step
from geometries.mesh import merged, open_edges
from geometries.spec import FOLDER, Spec

if TYPE_CHECKING:
    import cadquery
    import trimesh

LARGEST_BYTES = 4_000_000


class StepPart(Spec):
    """A part of one's own from a STEP file, drawn in mm in the sensor frame."""

    file: str = Field(min_length=1, max_length=400)
    """STEP file, relative to the design's own file."""
    content: str = Field("", repr=False)
    """The file, kept in the design (compressed); written by the program."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any, info: ValidationInfo) -> Any:
        """Read the file where its content is not there yet; it must hold closed bodies."""
        given = {"file": given} if isinstance(given, str) else given
        if not isinstance(given, dict) or given.get("content") or not isinstance(given.get("file"), str):
            return given
        path = Path((info.context or {}).get(FOLDER, ".")) / given["file"]
        data = _bytes(path)
        try:
            _closed(data)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None
        return given | {"content": base64.b64encode(zlib.compress(data, 9)).decode("ascii")}

    @property
    def data(self) -> bytes:
        """The file.

        Raises
        ------
        ValueError
            If the kept content is damaged.
        """
        unpacked = zlib.decompressobj()
        try:
            # no more than a file may have, whatever was packed
            data = unpacked.decompress(base64.b64decode(self.content, validate=True), LARGEST_BYTES)
            if not unpacked.eof:
                raise ValueError
            return data
        except (ValueError, zlib.error):
            raise ValueError(
                f"{self.file}: its content is damaged; delete `content` to read it again"
            ) from None


def mesh(part: StepPart) -> "trimesh.Trimesh":
    """Closed surface of a part (mm), its normals outwards; not to be changed.

    Raises
    ------
    ValueError
        If it is not closed.
    """
    return _closed(part.data)


def depth_mm(body: "trimesh.Trimesh", points: NDArray[np.float64]) -> float:
    """How deep the deepest of some points, shape (n, 3), lies in a closed body (mm).

    Where all lie outside, minus the distance of the nearest to a corner of the body.
    """
    from scipy.spatial import cKDTree
    from trimesh import triangles

    closest_point: Any = triangles.closest_point
    corners = np.asarray(body.triangles)
    inside = points[np.array([_winding(corners - point) > 0.5 for point in points])]
    if not len(inside):
        return -float(cKDTree(body.vertices).query(points)[0].min())
    away = [closest_point(corners, np.tile(p, (len(corners), 1))) - p for p in inside]
    return max(float(np.linalg.norm(each, axis=1).min()) for each in away)


def _winding(corners: NDArray[np.float64]) -> float:
    """How often triangles, shape (n, 3, 3), go round the origin: their solid angles over 4 pi."""
    a, b, c = (corners[:, k] for k in range(3))
    la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=1)
    scale = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return float(2 * np.arctan2(volume, scale).sum() / (4 * np.pi))


def solid(part: StepPart) -> "cadquery.Workplane":
    """Bodies of a part as CAD solids (mm)."""
    import cadquery

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.step"
        path.write_bytes(part.data)
        return cadquery.importers.importStep(str(path)).solids()


@lru_cache(maxsize=4)
def _closed(data: bytes) -> "trimesh.Trimesh":
    """Surface of the bodies of a file; refuses one that is open."""
    import trimesh

    if b"MANIFOLD_SOLID_BREP" not in data and b"BREP_WITH_VOIDS" not in data:
        raise ValueError(
            "holds no solid body, only faces or edges if anything; it must be closed: export a solid body"
        )
    corners = step.read(data)
    points, faces = merged(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    found = trimesh.Trimesh(points, faces, process=False)
    if gaps := open_edges(found):
        raise ValueError(
            f"its surface is open: {gaps} edges of its triangles have one side only, 0 may be; "
            "export a closed solid body"
        )
    if not found.volume > 0:
        raise ValueError("its surface looks inwards or has no volume; export a closed solid body")
    return found


def _bytes(path: Path) -> bytes:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise ValueError(
                f"{path}: has {path.stat().st_size:,} bytes, a part may have {LARGEST_BYTES:,}; simplify it"
            )
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}") from None
