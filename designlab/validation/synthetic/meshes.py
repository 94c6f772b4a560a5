"""Triangle meshes of what light meets within and around a core."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.validation.synthetic.generator_sensor import Rectangles, Rig
from designlab.validation.synthetic.glass import Disc, ImmersedParts
from designlab.validation.synthetic.surface import base_z
from geometries import elastomer

JOINED_MM = 2e-3  # a bonded board lies this far inside the core's side
FACING = 0.7  # cosine: sides turned to a board by less than 45 deg may carry it
RINGS = 48
SEGMENTS = 288


class Mesh(NamedTuple):
    """Triangles with optional vertex normals."""

    vertices: Array
    faces: NDArray[np.int64]
    normals: Array | None = None


def membrane(rig: Rig) -> Mesh:
    """Untouched membrane, up to the gel's outline."""
    radius = rig.elastomer.radius_mm
    outline = elastomer.polygon(rig.elastomer, segments=SEGMENTS)
    return sheet(outline, None, lambda x, y: base_z(radius, x, y), radius)


def sheet(
    outline: Array, hole: Disc | None, height: Callable[[Array, Array], Array], radius_mm: float | None
) -> Mesh:
    """Sheet that faces up, in rings from a hole (or a point) to a convex outline.

    With `radius_mm` its vertex normals are those of a sphere about the axis that is open to +z.
    """
    hole = hole or Disc(0.0, 0.0, 0.0)
    middle = np.array([hole.x_mm, hole.y_mm])
    corners = np.arctan2(*(outline - middle).T[::-1]) % (2 * np.pi)
    even = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    # Corners of the outline are kept, even angles that nearly coincide with them are not.
    away = np.abs((even[:, None] - corners[None, :] + np.pi) % (2 * np.pi) - np.pi).min(axis=1)
    turn = np.sort(np.concatenate([corners, even[away > 1e-4]]))
    round_ = np.column_stack([np.cos(turn), np.sin(turn)])
    far = _reach(outline - middle, round_)
    share = np.linspace(0.0, 1.0, RINGS + 1 if radius_mm is not None else 3)
    reach = hole.radius_mm + share[:, None] * (far - hole.radius_mm)
    xy = (middle + reach[..., None] * round_).reshape(-1, 2)
    vertices = np.column_stack([xy, height(xy[:, 0], xy[:, 1])])
    count = len(turn)
    k = np.arange(count)
    faces = []
    for ring in range(len(share) - 1):
        inner, outer = ring * count + k, (ring + 1) * count + k
        inner_next, outer_next = ring * count + (k + 1) % count, (ring + 1) * count + (k + 1) % count
        if ring or hole.radius_mm > 0:
            faces.append(np.stack([inner, outer_next, inner_next], axis=1))
        faces.append(np.stack([inner, outer, outer_next], axis=1))
    normals = None
    if radius_mm is not None:
        rise = np.sqrt(np.maximum(radius_mm**2 - (xy**2).sum(axis=1), 1e-9))
        normals = np.column_stack([-xy, rise]) / np.hypot(rise, np.hypot(*xy.T))[:, None]
    return Mesh(vertices, np.concatenate(faces), normals)


def _reach(polygon: Array, directions: Array) -> Array:
    """Distance from the origin to a convex polygon around it along unit vectors (n, 2)."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    outward = np.column_stack([edge[:, 1], -edge[:, 0]])
    with np.errstate(divide="ignore"):
        ahead = directions @ outward.T
        reach = np.where(ahead > 1e-12, (polygon * outward).sum(axis=1) / ahead, np.inf)
    return np.asarray(reach.min(axis=1))


def package(boards: Rectangles, number: int, way_mm: float, depth_mm: float) -> Mesh:
    """Front of a board, or the whole box where packages are cast into the core."""
    centre = boards.centre[number] + way_mm * boards.normal[number]
    across = boards.half[number, 0] * boards.across[number]
    down = boards.half[number, 1] * boards.down[number]
    front = np.array([centre + i * across + j * down for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    if not depth_mm:
        return Mesh(front, np.array([[0, 1, 2], [0, 2, 3]]))
    vertices = np.concatenate([front, front - depth_mm * boards.normal[number]])
    quads = [(0, 1, 2, 3), (7, 6, 5, 4), (4, 5, 1, 0), (5, 6, 2, 1), (6, 7, 3, 2), (7, 4, 0, 3)]
    return Mesh(vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def joining_mm(boards: Rectangles, number: int, glass: ImmersedParts) -> float:
    """Way of a board along its normal until its front lies just inside the core: glue fills the rest."""
    corners = package(boards, number, 0.0, 0.0).vertices
    ways = []
    for side in (wall for wall in glass.walls if wall.name.startswith("core-side")):
        a, b, c = side.vertices[side.faces[0]]
        outward = np.cross(b - a, c - a)
        outward /= np.linalg.norm(outward) * np.sign(outward[:2] @ a[:2])
        along = -float(outward @ boards.normal[number])
        if along > FACING:
            ways.append((max(float(outward @ (p - a)) for p in corners) + JOINED_MM) / along)
    return max(ways, default=0.0)
