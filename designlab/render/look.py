"""What each pixel sees of a membrane whose radiance is known."""

import numpy as np
from numpy.typing import NDArray

from designlab.press import Surface
from designlab.render.nodes import Grid
from designlab.render.tables import bilinear
from designlab.viewing import Rays

Array = NDArray[np.float64]
Single = NDArray[np.float32]
SUBPIXELS = 2  # look-ups along each side of a pixel


def look(grids: Single, surface: Surface, rays: Rays) -> Single:
    """Average radiance of the membrane that each pixel sees, shape (groups, rows, columns)."""
    import drjit as dr
    import mitsuba as mi

    rows, columns = rays.x_mm.shape
    fine = [
        mi.Float(_subdivided(values).astype(np.float32).ravel())
        for values in (rays.x_mm, rays.y_mm, rays.slope_x, rays.slope_y)
    ]
    x0, y0, slope_x, slope_y = fine
    grid = Grid.of(surface)
    x, y = x0, y0
    for _ in range(8):
        z = grid.sample(grid.z, x, y)
        x, y = x0 + slope_x * z, y0 + slope_y * z
    at = grid.place(x, y)
    shape = grid.rows, grid.columns
    images = [bilinear(mi.Float(np.ascontiguousarray(image).ravel()), *at, *shape) for image in grids]
    dr.eval(*images)
    return np.stack(
        [np.asarray(image).reshape(rows, SUBPIXELS, columns, SUBPIXELS).mean(axis=(1, 3)) for image in images]
    )


def _subdivided(values: Array) -> Array:
    """Values at the centres of sub-pixels, linear between pixel centres and beyond the outer ones."""
    offsets = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    for axis in (0, 1):
        slope = np.gradient(values, axis=axis)
        stacked = np.stack([values + o * slope for o in offsets], axis=axis + 1)
        shape = list(values.shape)
        shape[axis] *= SUBPIXELS
        values = stacked.reshape(shape)
    return values
