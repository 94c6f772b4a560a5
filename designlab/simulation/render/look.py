"""What each pixel sees of a membrane whose radiance is known."""

from functools import lru_cache

import numpy as np

from designlab.core.types import Array, Single
from designlab.simulation.contact.surface import Surface
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.render.engine import dr
from designlab.simulation.render.nodes import NodeTables
from designlab.simulation.render.tables import bilinear, on_device

SUBPIXELS = 2  # look-ups along each side of a pixel


def look(grids: Single, surface: Surface, rays: Rays) -> Single:
    """Average radiance of the membrane that each pixel sees, shape (groups, rows, columns)."""
    x0, y0, slope_x, slope_y = (on_device(column) for column in _looked(rays))
    grid = NodeTables.of(surface)
    x, y = x0, y0
    for _ in range(8):
        z = grid.sample(grid.z, x, y)
        x, y = x0 + slope_x * z, y0 + slope_y * z
    at = grid.place(x, y)
    shape = grid.rows, grid.columns
    seen = [bilinear(on_device(image), *at, *shape) for image in grids]
    dr.eval(*seen)
    pixels = [dr.block_sum(values, SUBPIXELS**2) / SUBPIXELS**2 for values in seen]
    return np.stack([np.asarray(values).reshape(rays.x_mm.shape) for values in pixels])


@lru_cache(maxsize=4)
def _looked(rays: Rays) -> list[Single]:
    """Look-ups of all pixels, those of one pixel side by side: x, y (mm) at height zero, and slopes."""
    columns = rays.x_mm, rays.y_mm, rays.slope_x, rays.slope_y
    return [np.ascontiguousarray(_subdivided(values), dtype=np.float32).ravel() for values in columns]


def _subdivided(values: Array) -> Array:
    """Values at the centres of sub-pixels, linear across each pixel, shape (rows, columns, sub-pixels)."""
    down, right = (np.gradient(values, axis=axis) for axis in (0, 1))
    offsets = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
    return np.stack([values + i * down + j * right for i in offsets for j in offsets], axis=-1)
