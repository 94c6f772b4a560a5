"""Triangle meshes of CAD solids."""

from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import cadquery
    import trimesh

MERGE_MM = 1e-6
"""Points nearer than this are one vertex; CAD faces repeat the points of a shared edge to about 1e-7 mm."""


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
        vertices, faces = merged(np.array([p.toTuple() for p in points]), np.array(triangles))
        meshes.append(trimesh.Trimesh(vertices, faces, process=False))
    mesh = cast("trimesh.Trimesh", trimesh.util.concatenate(meshes))
    if not (mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0):
        raise ValueError(
            f"solid: does not give a closed mesh with outward normals at tolerance_mm {tolerance_mm:g} "
            f"({'its winding is wrong' if mesh.is_watertight else 'it is not watertight'})"
        )
    return mesh


def solids(work: "cadquery.Workplane") -> "list[cadquery.Solid]":
    """All solids on a workplane, those within compounds included, in their order."""
    import cadquery

    return [solid for value in work.vals() if isinstance(value, cadquery.Shape) for solid in value.Solids()]


def open_edges(mesh: "trimesh.Trimesh") -> int:
    """Count edges whose two directions are not used equally often; 0 on a closed, consistently wound surface.

    Unlike "two triangles an edge", this also holds where two closed bodies touch along an edge.
    """
    start, end = mesh.edges.astype(np.int64).T
    key = np.minimum(start, end) * len(mesh.vertices) + np.maximum(start, end)
    _, edge = np.unique(key, return_inverse=True)
    return int(np.count_nonzero(np.bincount(edge, weights=np.where(start < end, 1.0, -1.0))))


def merged(
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
