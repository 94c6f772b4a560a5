"""The camera backwards: which pixel sees a point, along which ray, and how large it is there."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from designlab.core.types import Array
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.render.engine import mi
from designlab.simulation.render.tables import bilinear, on_device

TABLE_MM = 0.25  # pitch of the table of where the camera sees a point
BEYOND_MM = 2.5  # around the view, since lifted points are seen elsewhere than those below them


@dataclass(frozen=True, eq=False)
class ProjectedPoints:
    """Points as the camera sees them: fractional pixel, slopes of the ray, area of a pixel there (mm2)."""

    column: Any
    row: Any
    slope_x: Any
    slope_y: Any
    area: Any


@dataclass(frozen=True, eq=False)
class Eye:
    """Where the camera sees points of the plane z = 0, and how.

    `tables` has shape (7, rows, columns): column, row, slope_x, slope_y, area of a pixel in mm2, and
    divergence and determinant of the growth of slopes along x and y, which make the area grow with height.
    """

    x_mm: float
    y_mm: float
    tables: Array

    @cached_property
    def _loaded(self) -> list[Any]:
        return [on_device(t) for t in self.tables]

    def look(self, x: Any, y: Any, z: Any) -> "ProjectedPoints":
        """How the camera sees points (mm, Dr.Jit arrays)."""
        rows, columns = self.tables.shape[1:]

        def at(table: int, x: Any, y: Any) -> Any:
            u, v = (x - self.x_mm) / TABLE_MM, (y - self.y_mm) / TABLE_MM
            return bilinear(self._loaded[table], u, v, rows, columns)

        x0, y0 = mi.Float(x), mi.Float(y)
        for _ in range(3):
            x0, y0 = x - at(2, x0, y0) * z, y - at(3, x0, y0) * z
        # Height widens or narrows the area that a pixel sees.
        area = at(4, x0, y0) * (1 + z * at(5, x0, y0) + z * z * at(6, x0, y0))
        return ProjectedPoints(at(0, x0, y0), at(1, x0, y0), at(2, x0, y0), at(3, x0, y0), area)

    @staticmethod
    def of(rays: Rays) -> "Eye":
        """Turn a camera's rays round."""
        low_x, low_y = float(rays.x_mm.min()) - BEYOND_MM, float(rays.y_mm.min()) - BEYOND_MM
        x = np.arange(low_x, float(rays.x_mm.max()) + BEYOND_MM + TABLE_MM, TABLE_MM)
        y = np.arange(low_y, float(rays.y_mm.max()) + BEYOND_MM + TABLE_MM, TABLE_MM)
        grid_x, grid_y = np.meshgrid(x, y)
        row, column = _pixel(rays, grid_x, grid_y)
        slope_x, slope_y = (_extended(slope, row, column) for slope in (rays.slope_x, rays.slope_y))
        xr, xc, yr, yc = *_slopes(rays.x_mm), *_slopes(rays.y_mm)
        area = _extended(np.abs(xc * yr - xr * yc), row, column)
        sxy, sxx, syy, syx = (s / TABLE_MM for s in (*_slopes(slope_x), *_slopes(slope_y)))
        tables = [column, row, slope_x, slope_y, area, sxx + syy, sxx * syy - sxy * syx]
        return Eye(low_x, low_y, np.array(tables))


def _pixel(rays: Rays, x: Array, y: Array) -> tuple[Array, Array]:
    """Fractional pixel (row, column) whose ray passes the points of z = 0, also beyond the picture."""
    rows, columns = rays.x_mm.shape
    row, column = np.full(x.shape, (rows - 1) / 2), np.full(x.shape, (columns - 1) / 2)
    xr, xc, yr, yc = *_slopes(rays.x_mm), *_slopes(rays.y_mm)
    for _ in range(20):
        miss_x, miss_y = x - _extended(rays.x_mm, row, column), y - _extended(rays.y_mm, row, column)
        a, b, c, d = (_inside(table, row, column) for table in (xr, xc, yr, yc))
        determinant = a * d - b * c
        row = row + (d * miss_x - b * miss_y) / determinant
        column = column + (a * miss_y - c * miss_x) / determinant
    return row, column


def _slopes(values: Array) -> tuple[Array, Array]:
    """Growth a row and a column."""
    by_row, by_column = np.gradient(values)
    return np.asarray(by_row), np.asarray(by_column)


def _inside(values: Array, row: Array, column: Array) -> Array:
    return np.asarray(map_coordinates(values, [row, column], order=1, mode="nearest"))


def _extended(values: Array, row: Array, column: Array) -> Array:
    """Interpolate in a picture, and go on linearly beyond it."""
    rows, columns = values.shape
    r, c = np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)
    by_row, by_column = _slopes(values)
    beyond = (row - r) * _inside(by_row, r, c) + (column - c) * _inside(by_column, r, c)
    return np.asarray(map_coordinates(values, [r, c], order=3, mode="nearest") + beyond)
