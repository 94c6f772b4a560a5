"""The undeformed membrane in a picture: where a curved gel, or what a lens bends, is laid on an even grid.

A map from pictures to shape takes one size of a pixel and a plane gel. On a dome, or behind a fisheye,
neither holds. With the geometry of the sensor known, pictures are laid on a grid of the membrane first, seen
along z; there both hold again, but for the slopes of the membrane itself.
"""

from typing import Any, NamedTuple, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.core.types import Array, Mask

_ROUNDS = 30  # of Newton's method; three do on smooth lenses
_NEAR = 0.005  # grid steps, from which a point is found


class Membrane(NamedTuple):
    """The undeformed membrane on a grid in the sensor frame, and where pictures show it.

    Attributes
    ----------
    columns, rows : array, shape (grid rows, grid columns)
        Column and row of the picture that shows each point; pixel centres are whole numbers.
    seen : bool array, same shape
        Points that the picture shows, of the gel.
    height_mm, p, q : array, same shape
        Height and slopes of the membrane.
    sight_x, sight_y : array, same shape
        Slopes dx/dz and dy/dz of the viewing rays: what is lifted is seen where other gel was.
    mm_per_px : float
        Step of the grid.
    picture_px : tuple of int
        Rows and columns of the pictures.
    """

    columns: Array
    rows: Array
    seen: Mask
    height_mm: Array
    p: Array
    q: Array
    sight_x: Array
    sight_y: Array
    mm_per_px: float
    picture_px: tuple[int, int]

    @classmethod
    def of(
        cls,
        places_mm: tuple[Array, Array],
        height_mm: Array,
        slopes: tuple[Array, Array],
        sight: tuple[Array, Array],
        gel: Mask,
    ) -> Self:
        """Lay out what the pixels of a picture see.

        Parameters
        ----------
        places_mm : pair of arrays, shape (rows, columns)
            Point of the membrane, x and y, that each pixel sees.
        height_mm : array, same shape
            Height of the undeformed membrane there.
        slopes, sight : pair of arrays, same shape
            Its slopes, and those of the viewing rays, see the class.
        gel : bool array, same shape
            Pixels that see the gel.

        Raises
        ------
        ValueError
            If hardly any pixel does.
        """
        if gel.sum() < 100:
            raise ValueError(f"picture: shows the gel in {int(gel.sum())} pixels alone")
        x_mm, y_mm = places_mm
        across, down = np.gradient(x_mm, axis=1), -np.gradient(y_mm, axis=0)
        step = float(np.sqrt(np.median(np.abs(across * down)[gel])))
        edges = [(float(at[gel].min()), float(at[gel].max())) for at in (x_mm, y_mm)]
        axes = [low + step * np.arange(int((high - low) / step + 1e-6) + 1) for low, high in edges]
        grid_x, grid_y = np.meshgrid(axes[0], axes[1][::-1])
        columns, rows, found = _pixels_of(x_mm, y_mm, grid_x, grid_y, gel)

        def at(values: Array) -> Array:
            return np.asarray(
                map_coordinates(np.nan_to_num(values), [rows, columns], order=1, mode="nearest")
            )

        seen = found & (at(gel.astype(float)) > 0.999)
        (p, q), (sight_x, sight_y) = ((at(x), at(y)) for x, y in (slopes, sight))
        rows_px, columns_px = x_mm.shape
        return cls(columns, rows, seen, at(height_mm), p, q, sight_x, sight_y, step, (rows_px, columns_px))

    def laid_out(self, image: NDArray[Any]) -> NDArray[Any]:
        """A picture, or values at its pixels, on the grid, by linear interpolation.

        Raises
        ------
        ValueError
            If it has another size.
        """
        if image.shape[:2] != self.picture_px:
            rows, columns = self.picture_px
            raise ValueError(
                f"image: must be {columns} x {rows} pixels, as the calibration is, got "
                f"{image.shape[1]} x {image.shape[0]}"
            )
        values = np.ascontiguousarray(image if image.ndim == 3 else image[..., None])
        found = np.empty((*self.columns.shape, values.shape[2]), dtype=values.dtype)
        _sampled(values, self.columns.astype(np.float32), self.rows.astype(np.float32), found)
        return found if image.ndim == 3 else found[..., 0]

    def slope_at(self, place_px: tuple[float, float]) -> tuple[float, float]:
        """Slopes p and q at a column and row of the grid."""
        return _value_at(self.p, place_px), _value_at(self.q, place_px)

    def height_at(self, place_px: tuple[float, float]) -> float:
        """Height (mm) at a column and row of the grid."""
        return _value_at(self.height_mm, place_px)

    def touched_from(self, axis_px: tuple[float, float], radius_px: float) -> tuple[float, float]:
        """Column and row of the grid where a ball touches whose axis is at a place, both in steps."""
        place = axis_px
        for _ in range(_ROUNDS):
            right, up = self._aside(place, radius_px)
            place = axis_px[0] + right, axis_px[1] - up
        return place

    def axis_of(self, place_px: tuple[float, float], radius_px: float) -> tuple[float, float]:
        """Column and row of the axis of a ball that touches at a place; the inverse of `touched_from`."""
        right, up = self._aside(place_px, radius_px)
        return place_px[0] - right, place_px[1] + up

    def _aside(self, place_px: tuple[float, float], radius_px: float) -> tuple[float, float]:
        """How far the normal leads to the right and up from the centre of a ball to where it touches."""
        p, q = self.slope_at(place_px)
        length = np.sqrt(1 + p * p + q * q)
        return float(-radius_px * p / length), float(-radius_px * q / length)

    def curvature_at(self, place_px: tuple[float, float]) -> float:
        """Mean curvature (1/mm) at a column and row of the grid, positive for a dome that bulges outwards."""
        length = np.sqrt(1 + self.p**2 + self.q**2)
        across = np.gradient(self.p / length, self.mm_per_px, axis=1)
        up = -np.gradient(self.q / length, self.mm_per_px, axis=0)
        return _value_at((across + up) / 2, place_px)


def _value_at(values: Array, place_px: tuple[float, float]) -> float:
    column, row = place_px
    return float(map_coordinates(values, [[row], [column]], order=1, mode="nearest")[0])


def _pixels_of(
    x_mm: Array, y_mm: Array, grid_x: Array, grid_y: Array, gel: Mask
) -> tuple[Array, Array, Mask]:
    """Columns and rows of the pixels that see points, by Newton's method, and which were found."""
    maps = [np.nan_to_num(each) for each in (x_mm, y_mm)]
    slopes = [np.gradient(each, axis=axis) for each in maps for axis in (1, 0)]
    height, width = x_mm.shape
    near_row, near_column = np.unravel_index(
        int(np.where(gel, np.hypot(x_mm - grid_x.mean(), y_mm - grid_y.mean()), np.inf).argmin()), gel.shape
    )
    columns, rows = np.full(grid_x.shape, float(near_column)), np.full(grid_x.shape, float(near_row))
    step = grid_x[0, 1] - grid_x[0, 0]
    for _ in range(_ROUNDS):
        at = [rows, columns]
        x, y, xc, xr, yc, yr = (
            map_coordinates(each, at, order=1, mode="nearest") for each in (*maps, *slopes)
        )
        off_x, off_y = grid_x - x, grid_y - y
        if max(np.abs(off_x).max(), np.abs(off_y).max()) < _NEAR * step / 2:
            break
        determinant = xc * yr - xr * yc
        determinant = np.where(np.abs(determinant) < 1e-12, 1e-12, determinant)
        # no step leads out of the picture, where nothing is known
        columns = np.clip(columns + (off_x * yr - off_y * xr) / determinant, 0, width - 1)
        rows = np.clip(rows + (off_y * xc - off_x * yc) / determinant, 0, height - 1)
    found = (np.abs(off_x) < _NEAR * step) & (np.abs(off_y) < _NEAR * step)
    return columns, rows, np.asarray(found)


@njit(cache=True, nogil=True)
def _sampled(image: Any, columns: Any, rows: Any, found: Any) -> None:
    height, width, channels = image.shape
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            column = min(max(columns[i, j], np.float32(0)), np.float32(width - 1))
            row = min(max(rows[i, j], np.float32(0)), np.float32(height - 1))
            left, top = min(int(column), width - 2), min(int(row), height - 2)
            across, down = column - left, row - top
            for k in range(channels):
                above = (1 - across) * image[top, left, k] + across * image[top, left + 1, k]
                below = (1 - across) * image[top + 1, left, k] + across * image[top + 1, left + 1, k]
                found[i, j, k] = (1 - down) * above + down * below
