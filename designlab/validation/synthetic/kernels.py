"""Inner loops over pairs of points and cells, compiled: array by array they would be bound by memory."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from designlab.core.types import Array


@njit(cache=True)
def _facing(point: Array, normal: Array, centre: Array, facing: Array) -> tuple[float, float, float]:
    """Both cosines times the distance, and the squared distance, of a point and a cell."""
    here, there, square = 0.0, 0.0, 0.0
    for axis in range(3):
        way = centre[axis] - point[axis]
        here += normal[axis] * way
        there -= facing[axis] * way
        square += way * way
    return here, there, square


@njit(cache=True)
def exchange(points: Array, normals: Array, centres: Array, facing: Array, exponents: Array) -> Array:
    """Cosine times cosine over squared distance, shape (points, cells).

    A cell of the law cos^m sends (m + 1) / 2 cos^(m - 1) of what a Lambertian one of equal flux does.

    Parameters
    ----------
    points, normals : array, shape (points, 3)
        Receiving points (mm) and their unit normals.
    centres, facing : array, shape (cells, 3)
        Centres of the cells (mm) and their unit normals.
    exponents : array, shape (cells,)
        Exponent m of each.
    """
    found = np.empty((len(points), len(centres)))
    for n in range(len(points)):
        for k in range(len(centres)):
            here, there, square = _facing(points[n], normals[n], centres[k], facing[k])
            if here <= 0.0 or there <= 0.0:
                found[n, k] = 0.0
                continue
            value = here * there / (square * square + 1e-18)
            power = exponents[k]
            if power != 1.0:
                # What faces away has no light already; the least cosine keeps its power finite.
                cosine = max(there / math.sqrt(square + 1e-18), 1e-6)
                value *= (power + 1) / 2 * cosine ** (power - 1)
            found[n, k] = value
    return found


@njit(cache=True)
def form_factors(points: Array, normals: Array, centres: Array, facing: Array, areas: Array) -> Array:
    """Irradiance on patches per radiosity of others, (points, senders), see `light.form_factors`."""
    found = np.empty((len(points), len(centres)))
    for n in range(len(points)):
        for k in range(len(centres)):
            here, there, square = _facing(points[n], normals[n], centres[k], facing[k])
            square += 1e-9
            found[n, k] = (
                max(here, 0.0) * max(there, 0.0) * areas[k] / (square * (math.pi * square + areas[k]))
            )
    return found


@njit(cache=True)
def visible_share(
    points: Array, table: Array, column: NDArray[np.int64], centres: Array, half_down: Array, step_rad: float
) -> Array:
    """Share of every cell that stands above the horizon, (points, cells), see `shadow.Horizon`.

    Parameters
    ----------
    points : array, shape (points, 3)
        Places (mm).
    table : array, shape (points, azimuths)
        Slope of their horizons for every azimuth that was prepared.
    column : array
        Column of each azimuth, numbered by steps of `step_rad`.
    centres, half_down : array, shape (cells, 3)
        Centres of the cells and half their extent downwards (mm).
    """
    turns = 2 * math.pi / step_rad
    share = np.empty((len(points), len(centres)))
    for n in range(len(points)):
        x, y, z = points[n]
        highest = table[n].max()
        for k in range(len(centres)):
            dx, dy = centres[k, 0] - x, centres[k, 1] - y
            run = math.sqrt(dx * dx + dy * dy) + 1e-9
            slope = (centres[k, 2] - z) / run
            along = (dx * half_down[k, 0] + dy * half_down[k, 1]) / run
            half = abs(half_down[k, 2] - slope * along) / run + 1e-6
            if slope - half >= highest:  # above the horizon whatever its azimuth, as most are
                share[n, k] = 1.0
                continue
            place = math.atan2(dy, dx) / step_rad % turns
            low = int(place)
            below, above = table[n, column[low]], table[n, column[low + 1]]
            horizon = below + (place - low) * (above - below)
            share[n, k] = min(max((slope - horizon + half) / (2 * half), 0.0), 1.0)
    return share


@njit(cache=True, fastmath={"nnan"})
def steepest(z: NDArray[np.float32], strides: NDArray[np.int64], pitch_mm: float, none: float) -> Array:
    """Slope from each point of rows to the highest later one at some distances (grid steps)."""
    rows, columns = z.shape
    found = np.full((rows, columns), np.float32(none))
    for row in range(rows):
        own, best = z[row], found[row]
        for stride in strides:
            scale = np.float32(1.0 / (stride * pitch_mm))
            for k in range(columns - stride):
                best[k] = max(best[k], (own[k + stride] - own[k]) * scale)
    return found.astype(np.float64)


@njit(cache=True)
def bilinear(grid: Array, row: Array, column: Array, nearest: bool) -> Array:
    """Values of a grid between its points; beyond it those of its edge, or none.

    Parameters
    ----------
    grid : array, shape (rows, columns)
        Values.
    row, column : array, shape (n,)
        Places.
    nearest : bool
        Whether values of the edge count beyond it; 0 does else.
    """
    rows, columns = grid.shape
    found = np.zeros(len(row))
    for n in range(len(row)):
        r, c = row[n], column[n]
        if nearest:
            r, c = min(max(r, 0.0), rows - 1.0), min(max(c, 0.0), columns - 1.0)
        elif not (0.0 <= r <= rows - 1 and 0.0 <= c <= columns - 1):
            continue
        i, j = min(int(r), max(rows - 2, 0)), min(int(c), max(columns - 2, 0))
        below, right = min(i + 1, rows - 1), min(j + 1, columns - 1)
        u, v = r - i, c - j
        upper = grid[i, j] + v * (grid[i, right] - grid[i, j])
        lower = grid[below, j] + v * (grid[below, right] - grid[below, j])
        found[n] = upper + u * (lower - upper)
    return found


@njit(cache=True)
def _corner(x: float, y: float) -> float:
    """Integral of 1 / r over the rectangle from the origin to a corner, by Love's closed form."""
    if x == 0.0 or y == 0.0:
        return 0.0
    return x * math.asinh(y / abs(x)) + y * math.asinh(x / abs(y))


@njit(cache=True)
def _answer(x: float, y: float, size: float, smooth: Array, step: float) -> float:
    """Integral of 1 / r less a smooth part over a square, from a point x, y off its middle."""
    square = x * x + y * y
    r, half = math.sqrt(square), size / 2
    place = r / step
    low = int(place)
    if low + 1 >= len(smooth):
        return 0.0
    if square > 9.0 * size * size:
        near = size * size / r * (1.0 + size * size / (24.0 * square))
    else:
        left, right, below, above = x - half, x + half, y - half, y + half
        near = _corner(right, above) - _corner(left, above) - _corner(right, below) + _corner(left, below)
    return float(near - size * size * (smooth[low] + (place - low) * (smooth[low + 1] - smooth[low])))


@njit(cache=True)
def sinking(points: Array, centres: Array, sizes: Array, smooth: Array, step: float) -> Array:
    """Answer of an elastic layer at points to squares of unit pressure, see `boundary_elements`.

    Parameters
    ----------
    points, centres : array, shapes (points, 2) and (squares, 2)
        Places, and middles of the squares (mm).
    sizes : array, shape (squares,)
        Sides of the squares (mm).
    smooth, step : array, float
        Smooth part of the answer at distances that far apart (mm); beyond the last there is no answer.
    """
    found = np.empty((len(points), len(centres)))
    for n in range(len(points)):
        for k in range(len(centres)):
            dx, dy = points[n, 0] - centres[k, 0], points[n, 1] - centres[k, 1]
            found[n, k] = _answer(dx, dy, sizes[k], smooth, step)
    return found


@njit(cache=True)
def sunk(points: Array, centres: Array, sizes: Array, pressure: Array, smooth: Array, step: float) -> Array:
    """Answer at points to the pressures of all squares together; arguments as in `sinking`."""
    found = np.zeros(len(points))
    for n in range(len(points)):
        for k in range(len(centres)):
            dx, dy = points[n, 0] - centres[k, 0], points[n, 1] - centres[k, 1]
            found[n] += pressure[k] * _answer(dx, dy, sizes[k], smooth, step)
    return found


@njit(cache=True)
def covered(points: Array, centres: Array, sizes: Array) -> NDArray[np.bool_]:
    """Which points lie within any of some squares."""
    found = np.zeros(len(points), dtype=np.bool_)
    for n in range(len(points)):
        for k in range(len(centres)):
            away = max(abs(points[n, 0] - centres[k, 0]), abs(points[n, 1] - centres[k, 1]))
            if away <= 0.5 * sizes[k]:
                found[n] = True
                break
    return found
