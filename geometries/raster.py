"""Height of a triangle mesh over any points of the plane: a vectorised vertical ray cast."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    import trimesh

_TRIANGLES_AT_ONCE = 1 << 14


def height_map(mesh: "trimesh.Trimesh", x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Height of the mesh's highest surface over each point, seen from +z.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Any triangle mesh (mm).
    x, y : array_like
        Points (mm), broadcast against each other; they need not form a grid.

    Returns
    -------
    ndarray
        Height in mm, -inf where a vertical line misses the mesh. Vertical facets have no height of their own.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    heights = np.full(x.size, -np.inf)
    if x.size == 0:
        return heights.reshape(x.shape)
    points = _BandedPoints(x.ravel(), y.ravel())
    corners = np.asarray(mesh.triangles, dtype=float)
    for start in range(0, len(corners), _TRIANGLES_AT_ONCE):
        block = _not_vertical(corners[start : start + _TRIANGLES_AT_ONCE])
        triangle, point = points.candidates(block[:, :, :2])
        inside, z = _interpolated(block[triangle], points.x[point], points.y[point])
        np.maximum.at(heights, point[inside], z[inside])
    return heights.reshape(x.shape)


class _BandedPoints:
    """Points sorted into bands of y, and by x within a band: the points near a triangle are a few slices."""

    def __init__(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
        self.x, self.y = x, y
        self._bands = max(1, min(4096, int(np.sqrt(x.size))))
        self._y0, self._x0 = y.min(), x.min()
        self._step = max((y.max() - self._y0) / self._bands, 1e-12)
        self._x_scale = 0.5 / max(x.max() - self._x0, 1e-12)
        key = self._band(y) + self._scaled_x(x)
        self._order = np.argsort(key, kind="stable")
        self._key = key[self._order]

    def candidates(self, triangles: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pairs (triangle, point) that include every point inside a triangle; `triangles` is (n, 3, 2)."""
        first, last = self._band(triangles[:, :, 1].min(axis=1)), self._band(triangles[:, :, 1].max(axis=1))
        owner, offset = _expanded((last - first + 1).astype(np.int64))
        band = first[owner] + offset
        low, high = _extent_in_band(
            triangles[owner], self._y0 + band * self._step, self._y0 + (band + 1) * self._step
        )
        slack = 1e-9 / self._x_scale
        start = np.searchsorted(self._key, band + self._scaled_x(low - slack), side="left")
        stop = np.searchsorted(self._key, band + self._scaled_x(high + slack), side="right")
        slice_owner, place = _expanded(np.maximum(stop - start, 0))
        return owner[slice_owner], self._order[start[slice_owner] + place]

    def _band(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.clip(np.floor((y - self._y0) / self._step), 0, self._bands - 1))

    def _scaled_x(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Place of x within its band's key interval: 0 to 0.5 for the points themselves."""
        return np.asarray(np.clip((x - self._x0) * self._x_scale, -0.2, 0.7))


def _expanded(counts: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return owner and running number of each item, for owners that have `counts` items each."""
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def _extent_in_band(
    triangles: NDArray[np.float64], y_low: NDArray[np.float64], y_high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Range of x that each triangle, shape (n, 3, 2), covers between `y_low` and `y_high`, slightly wider."""
    slack = 1e-6 * (y_high - y_low)
    y_low, y_high = y_low - slack, y_high + slack
    low, high = np.full(len(triangles), np.inf), np.full(len(triangles), -np.inf)
    for corner in range(3):
        start, end = triangles[:, corner], triangles[:, (corner + 1) % 3]
        rise = end[:, 1] - start[:, 1]
        lower, upper = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
        crosses = (lower <= y_high) & (upper >= y_low)
        for y, fallback in ((y_low, start[:, 0]), (y_high, end[:, 0])):
            share = np.clip((y - start[:, 1]) / np.where(rise == 0, 1.0, rise), 0.0, 1.0)
            x = np.where(rise == 0, fallback, start[:, 0] + share * (end[:, 0] - start[:, 0]))
            low = np.where(crosses, np.minimum(low, x), low)
            high = np.where(crosses, np.maximum(high, x), high)
    return low, high


def _not_vertical(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Drop triangles, shape (n, 3, 3), that a vertical line meets in nothing or in a segment."""
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    doubled_area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    longest = np.maximum(np.sum(a**2, axis=1), np.sum(b**2, axis=1))
    return np.asarray(corners[doubled_area > 1e-9 * longest])


def _interpolated(
    corners: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Whether each point lies in its triangle, shape (n, 3, 3), and the triangle's height there."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    doubled_area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    of_b = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / doubled_area
    of_c = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / doubled_area
    inside = (of_b >= -1e-7) & (of_c >= -1e-7) & (of_b + of_c <= 1 + 1e-7)
    return inside, a[:, 2] + of_b * (b[:, 2] - a[:, 2]) + of_c * (c[:, 2] - a[:, 2])
