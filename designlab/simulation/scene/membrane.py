"""The reflective membrane of a scene: its mesh, and how its coating reflects from place to place."""

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.simulation.contact.surface import ROUNDING_MM, Surface
from designlab.simulation.scene.coating import coating
from designlab.simulation.scene.materials import Shape
from geometries import elastomer

EVERY_KEPT = 8  # of the fine grid lines where no gel has moved
EVERY_LOWERED = 2  # likewise through a bulge, which is smooth


def membrane(design: Design, surface: Surface) -> Shape:
    """Grid, fine where the gel is pressed, coarse elsewhere, without seams, cut off at the gel's outline.

    A bulge that reaches the border of the surface goes on beyond it, and ends at the gel's outline.
    """
    gel = design.elastomer
    outline = elastomer.polygon(gel)
    x = _extended(surface.x_mm, float(outline[:, 0].min()), float(outline[:, 0].max()))
    y = _extended(surface.y_mm[::-1], float(outline[:, 1].min()), float(outline[:, 1].max()))[::-1]
    grid_x, grid_y = np.meshgrid(x, y)
    z = elastomer.base_mm(gel, grid_x, grid_y)
    p, q = elastomer.base_gradient(gel, grid_x, grid_y)
    column, row = int(np.searchsorted(x, surface.x_mm[0])), int(np.searchsorted(-y, -surface.y_mm[0]))
    fine = np.s_[row : row + len(surface.y_mm), column : column + len(surface.x_mm)]
    if surface.bulges:
        z += _beyond(surface, grid_x, grid_y, outline)
    z[fine] += surface.height_mm
    dp, dq = surface.indentation_gradient
    p[fine] += dp
    q[fine] += dq
    pressed = np.zeros(z.shape, dtype=bool)
    pressed[fine] = surface.height_mm > ROUNDING_MM
    every = EVERY_LOWERED if surface.bulges else EVERY_KEPT
    rows = _worth_keeping(np.asarray(pressed.any(axis=1)), row, len(surface.y_mm), every)
    columns = _worth_keeping(np.asarray(pressed.any(axis=0)), column, len(surface.x_mm), every)
    x, y, kept_nodes = x[columns], y[rows], np.ix_(rows, columns)
    grid_x, grid_y, z, p, q = (field[kept_nodes] for field in (grid_x, grid_y, z, p, q))
    middle_x, middle_y = np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2)
    corners = np.isfinite(z)
    whole = corners[1:, 1:] & corners[1:, :-1] & corners[:-1, 1:] & corners[:-1, :-1]
    kept = elastomer.inside(gel, middle_x, middle_y) & whole
    index = np.arange(grid_x.size, dtype=np.uint32).reshape(grid_x.shape)
    a, b, c, d = index[:-1, :-1][kept], index[:-1, 1:][kept], index[1:, 1:][kept], index[1:, :-1][kept]
    faces = np.concatenate([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)])
    normals = np.stack([-p, -q, np.ones_like(p)], axis=-1).reshape(-1, 3)
    with np.errstate(invalid="ignore"):  # vertical on a sphere's equator, where no face is kept
        normals = np.nan_to_num(normals / np.linalg.norm(normals, axis=-1, keepdims=True), nan=0.0)
    vertices = np.nan_to_num(np.stack([grid_x, grid_y, z], axis=-1).reshape(-1, 3))
    return Shape("membrane", vertices, faces, coating(design, surface), normals)


def _beyond(surface: Surface, x: Array, y: Array, outline: Array) -> Array:
    """Height of lowered gel at points (mm) beside a surface: as at its border, ending at the outline."""
    lowered = np.minimum(surface.sample(surface.height_mm, x, y), 0.0)
    left = []
    for at, own, along in ((x, surface.x_mm, outline[:, 0]), (y, surface.y_mm, outline[:, 1])):
        reach, end = float(np.abs(own).max()), float(np.abs(along).max())
        left.append(np.clip((end - np.abs(at)) / max(end - reach, 1e-9), 0.0, 1.0))
    beside = (np.abs(x) > np.abs(surface.x_mm).max()) | (np.abs(y) > np.abs(surface.y_mm).max())
    return np.where(beside, lowered * left[0] * left[1], 0.0)


def _worth_keeping(pressed: NDArray[np.bool_], first: int, count: int, every: int) -> NDArray[np.bool_]:
    """Grid lines through pressed gel with their neighbours, some of the other fine ones, all coarse ones.

    The `count` fine lines start at `first`; the coarse ones reach to the outline, which they must follow.
    """
    kept = pressed.copy()
    kept[1:] |= pressed[:-1]
    kept[:-1] |= pressed[1:]
    kept[first : first + count : every] = True
    kept[:first] = True
    kept[first + count - 1 :] = True
    return kept


def _extended(axis: Array, low: float, high: float) -> Array:
    """Continue an ascending axis to [low, high] in at most 24 even steps a side, no finer than its own."""

    def beyond(edge: float, end: float) -> Array:
        pitch = float(axis[1] - axis[0])
        steps = int(np.clip(np.ceil(abs(end - edge) / pitch), 1, 24))
        return np.linspace(edge, end, steps + 1)[1:]

    left = beyond(float(axis[0]), low)[::-1] if low < axis[0] - 1e-9 else np.empty(0)
    right = beyond(float(axis[-1]), high) if high > axis[-1] + 1e-9 else np.empty(0)
    return np.concatenate([left, axis, right])
