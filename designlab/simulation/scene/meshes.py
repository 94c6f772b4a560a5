"""Triangle meshes of surfaces that several parts of a scene need."""

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.simulation.scene.materials import Coating, Dielectric, Diffuse, Shape


def oriented(vertices: Array, faces: NDArray[np.int64], outward: Array) -> NDArray[np.uint32]:
    """Wind faces so that their normals point along `outward` (one direction, or one for each face)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flipped = (np.cross(b - a, c - a) * outward).sum(-1) < 0
    return np.where(flipped[:, None], faces[:, ::-1], faces).astype(np.uint32)


def sheet(
    name: str,
    rings: list[Array],
    heights: list[Array],
    surface: Diffuse | Coating | Dielectric,
    *,
    up: float = 1.0,
) -> Shape:
    """Sheet through nested rings of equal point count, facing along z times `up`; one ring may be a point."""
    count = len(rings[0])
    vertices = np.concatenate([np.column_stack([xy, z]) for xy, z in zip(rings, heights, strict=True)])
    faces = np.concatenate(
        [band_faces(count, ring * count, (ring + 1) * count) for ring in range(len(rings) - 1)]
    )
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12]
    return Shape(name, vertices, oriented(vertices, faces, np.array([0.0, 0.0, up])), surface)


def band_faces(count: int, first: int, second: int) -> NDArray[np.int64]:
    """Triangles between two closed rings of `count` vertices that start at the given indices."""
    k = np.arange(count)
    following = (k + 1) % count
    a, b, c, d = first + k, first + following, second + following, second + k
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
