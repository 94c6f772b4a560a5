"""Triangle meshes: from a CAD solid or a user's file to arrays."""

import warnings
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from geometries.raster import height_map

if TYPE_CHECKING:
    import cadquery
    import trimesh

__all__ = ["MERGE_MM", "MESH_SUFFIXES", "from_solid", "height_map", "load"]

MESH_SUFFIXES = (".stl", ".obj")
"""File types that `load` reads."""

MERGE_MM = 1e-6
"""Points nearer than this are one vertex; CAD faces repeat the points of a shared edge to about 1e-7 mm."""

_SMALLEST_MM, _LARGEST_MM = 0.05, 1000.0


def from_solid(
    solid: "cadquery.Workplane | cadquery.Shape",
    *,
    tolerance_mm: float = 0.005,
    angular_tolerance_deg: float = 5.0,
) -> "trimesh.Trimesh":
    """Triangulate one or several closed CAD solids.

    Parameters
    ----------
    solid : cadquery.Workplane or cadquery.Shape
        Closed solids; those on a workplane's stack become one mesh.
    tolerance_mm : float
        Largest distance between the mesh and the true surface (mm).
    angular_tolerance_deg : float
        Largest angle between neighbouring facets of a curved face (deg).

    Returns
    -------
    trimesh.Trimesh
        Watertight mesh in mm with outward normals.

    Raises
    ------
    ValueError
        If a tolerance is not positive, or the solid does not give a closed mesh.
    """
    import trimesh

    for name, value in (("tolerance_mm", tolerance_mm), ("angular_tolerance_deg", angular_tolerance_deg)):
        if not value > 0:
            raise ValueError(f"{name}: must be positive, is {value:g}")
    shapes: Any = solid.vals() if hasattr(solid, "vals") else [solid]
    meshes = []
    for shape in shapes:
        # A copy carries no triangulation; OpenCASCADE would keep an older, finer one.
        points, triangles = shape.copy().tessellate(tolerance_mm, np.deg2rad(angular_tolerance_deg))
        vertices, faces = _merged(np.array([p.toTuple() for p in points]), np.array(triangles))
        meshes.append(trimesh.Trimesh(vertices, faces, process=False))
    mesh = cast("trimesh.Trimesh", trimesh.util.concatenate(meshes))
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0):
        raise ValueError(
            f"solid: does not give a closed mesh with outward normals at tolerance_mm {tolerance_mm:g} "
            f"({'its winding is wrong' if mesh.is_watertight else 'it is not watertight'})"
        )
    return mesh


def load(path: str | Path, *, size_mm: float | None = None) -> "trimesh.Trimesh":
    """Read a closed body from an STL or OBJ file, to be pressed with its +z side.

    The file's axes are kept: the side that faces +z in the file touches the gel. The mesh is centred in x and
    y on its bounding box and moved along z until its foremost point lies at z = 0.

    Parameters
    ----------
    path : str or Path
        Mesh file; its unit is taken as mm.
    size_mm : float, optional
        Scales the body so that its larger extent along x or y has this length (mm).

    Returns
    -------
    trimesh.Trimesh
        Watertight, outward normals; ``metadata["notes"]`` lists what had to be repaired.

    Warns
    -----
    UserWarning
        With the same notes.

    Raises
    ------
    ValueError
        Naming file and rule, where the file cannot be read or holds no closed body of a usable size.
    """
    path = Path(path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ValueError(f"{path}: a mesh file ends in {' or '.join(MESH_SUFFIXES)}, not {path.suffix!r}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not data.strip():
        raise ValueError(f"{path}: the file is empty")
    try:
        mesh = _closed_body(data, path.suffix.lower()[1:]).copy()
    except _BadMeshError as rule:
        raise ValueError(f"{path}: {rule}") from None
    for note in mesh.metadata["notes"]:
        warnings.warn(f"{path}: {note}", stacklevel=2)
    if size_mm is not None:
        if not (np.isfinite(size_mm) and size_mm > 0):
            raise ValueError(f"{path}: size_mm must be positive, is {size_mm:g} mm")
        mesh.apply_transform(np.diag([*3 * [size_mm / max(mesh.extents[:2])], 1.0]))
    largest = max(mesh.extents)
    if not (_SMALLEST_MM <= largest <= _LARGEST_MM):
        raise ValueError(
            f"{path}: the largest extent must lie between {_SMALLEST_MM:g} and {_LARGEST_MM:g} mm, "
            f"is {largest:g} mm; the file's unit is taken as mm, give a size to scale it"
        )
    low, high = mesh.bounds
    mesh.apply_translation([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -high[2]])
    return mesh


class _BadMeshError(Exception):
    """A rule that the content of a mesh file breaks."""


@lru_cache(maxsize=4)
def _closed_body(data: bytes, file_type: str) -> "trimesh.Trimesh":
    """Parse, check and repair a mesh file; cached by content because every press needs it."""
    import trimesh

    try:
        mesh = trimesh.load_mesh(BytesIO(data), file_type=file_type, process=False, skip_materials=True)
    except Exception as error:  # the readers of trimesh fail on bad bytes with almost any type
        raise _BadMeshError(
            f"is not a valid {file_type.upper()} file ({type(error).__name__}: {error})"
        ) from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise _BadMeshError(f"holds no triangles, or is not a valid {file_type.upper()} file")
    if not np.isfinite(mesh.vertices).all():
        raise _BadMeshError("has vertices that are not finite numbers")
    if not min(mesh.extents) > 1e-6 * max(mesh.extents):
        raise _BadMeshError(f"the body has no thickness, its extents are {_as_text(mesh.extents)} mm")
    notes = []
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(_proper(np.asarray(mesh.faces)) & mesh.unique_faces())
    if not mesh.is_watertight:
        trimesh.repair.fill_holes(mesh)
        notes.append("holes were filled")
    if not mesh.is_watertight:
        raise _BadMeshError(
            "the surface is not closed (not watertight), and filling small holes did not help"
        )
    with np.errstate(divide="ignore", invalid="ignore"):  # trimesh divides by the volume, which may be zero
        if not (mesh.is_winding_consistent and mesh.volume > 0):
            mesh.fix_normals()
            notes.append("normals were turned outwards")
    if not mesh.volume > 1e-9 * float(np.prod(np.maximum(mesh.extents, 1e-3 * max(mesh.extents)))):
        raise _BadMeshError(f"encloses no volume, its extents are {_as_text(mesh.extents)} mm")
    body = trimesh.Trimesh(vertices=mesh.vertices, faces=mesh.faces, process=False)
    body.remove_unreferenced_vertices()
    body.metadata["notes"] = notes
    return body


def _as_text(lengths_mm: NDArray[np.float64]) -> str:
    return " x ".join(f"{length:g}" for length in lengths_mm)


def _merged(
    points: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Join points nearer than `MERGE_MM` and drop the triangles that collapse."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    # Rounding coordinates would split a pair that straddles a rounding boundary; distances do not.
    pairs = cKDTree(points).query_pairs(MERGE_MM, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    _, label = connected_components(links, directed=False)
    _, first = np.unique(label, return_index=True)
    joined = label[triangles]
    return points[first], joined[_proper(joined)].astype(np.int64)


def _proper(triangles: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell which triangles, as indices of shape (n, 3), have three different corners."""
    a, b, c = triangles.T
    return np.asarray((a != b) & (b != c) & (c != a))
