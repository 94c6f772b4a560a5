"""Resampling gives the picture of a camera of another pose or lens by moving that of the nominal camera.

A membrane looks much the same from a place a fraction of a millimetre away. So a picture is not traced anew
but resampled: every pixel takes the light of the membrane point it sees from where the nominal picture has
it.
"""

from collections.abc import Iterator
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from designlab.core.splines import coefficients, look_up
from designlab.core.types import Array
from designlab.sensor.camera import View, Vignetting
from designlab.sensor.design import Design
from designlab.simulation.optics.viewing_rays import rays
from geometries.elastomer import base_mm

if TYPE_CHECKING:
    from scipy.sparse import csr_array

MOST_PX = 16  # by which pictures are continued in proportion beyond their edges
ITERATIONS = 6
SETTLED_PX = 1e-6  # steps below which no further ones are taken


class SeenPoints:
    """Membrane points that the pixels of a design see, and where in its picture a point is seen.

    Parameters
    ----------
    design : Design
        The design.
    view : View
        The part of the camera's sensor.
    """

    def __init__(self, design: Design, view: View) -> None:
        self.design, self.view = design, view
        self.pad = min(MOST_PX, view.rows - 1, view.columns - 1)
        self.points_mm = np.stack(seen_mm(design, view))

    @cached_property
    def _splines(self) -> Array:
        return coefficients(self.points_mm, self.pad)

    @cached_property
    def _px_per_mm(self) -> Array:
        """How far row and column move with a point's x and y, shape (2, 2, rows, columns)."""
        (x_row, x_column), (y_row, y_column) = (np.gradient(part) for part in self.points_mm)
        determinant = x_row * y_column - x_column * y_row
        return np.asarray(np.array([[y_column, -x_column], [-y_row, x_row]]) / determinant)

    def place(self, points_mm: Array) -> Array:
        """Row and column where points are seen, shape (2, rows, columns), by Newton's method."""
        place = np.indices(points_mm.shape[1:]).astype(float)
        for _ in range(ITERATIONS):
            off = points_mm - look_up(self._splines, place, self.pad)
            step = (self._px_per_mm * off).sum(axis=1)
            place = place + step
            if np.abs(step).max() < SETTLED_PX:
                break
        return np.asarray(place)


class Warp:
    """Resampling of pictures of one design in one view into those of another.

    Parameters
    ----------
    nominal, changed : SeenPoints
        What their pixels see; the designs differ in their cameras alone.
    """

    def __init__(self, nominal: SeenPoints, changed: SeenPoints) -> None:
        self._pad = nominal.pad
        self._place = nominal.place(changed.points_mm)
        self._before: Array | float = 1.0
        self._after: Array | float = 1.0
        if nominal.design.camera.vignetting != Vignetting():
            self._before, self._after = (of.design.camera.vignette(of.view) for of in (nominal, changed))

    def __call__(self, light: NDArray[np.floating]) -> NDArray[np.floating]:
        """Resample light, shape (n, rows, columns), by cubic splines."""
        moved = look_up(coefficients(light / self._before, self._pad), self._place, self._pad)
        return np.asarray(moved * self._after, dtype=light.dtype)

    def straight(self, light: NDArray[np.floating]) -> NDArray[np.floating]:
        """Resample light, shape (n, rows, columns), by straight lines between pixels: many at once."""
        layers = np.asarray(light / self._before, dtype=np.float32).reshape(len(light), -1)
        moved = (self._lines @ layers.T).T.reshape(light.shape)
        return np.asarray(moved * self._after, dtype=light.dtype)

    @cached_property
    def _lines(self) -> "csr_array":
        """Weights of all pixels in each of the resampled picture."""
        from scipy.sparse import csr_array

        shape = self._place.shape[1:]
        place = self._place.reshape(2, -1) + self._pad
        last = np.array(shape)[:, None] + 2 * self._pad - 1
        low = np.clip(np.floor(place), 0, last - 1).astype(int)
        share = np.clip(place - low, 0.0, 1.0)
        parts = []
        for corner in np.ndindex(2, 2):
            weight = np.where(np.array(corner)[:, None], share, 1.0 - share).prod(axis=0)
            wide = low + np.array(corner)[:, None] - self._pad
            for factor, pixel in _continued(wide, shape):
                entries = weight * factor
                (there,) = np.nonzero(entries)
                parts.append((entries[there], there, pixel[there]))
        entries, to, of = (np.concatenate(part) for part in zip(*parts, strict=True))
        # Entries of one pixel in another are added up.
        return csr_array((entries.astype(np.float32), (to, of)), shape=(share.shape[1],) * 2)


def _continued(place: NDArray[np.intp], shape: tuple[int, ...]) -> Iterator[tuple[Array, NDArray[np.intp]]]:
    """Pixels, each with its factor, that make up places of a picture, (2, n), continued beyond its edges.

    There it goes on as before the edge: twice what is at the edge, less what the mirrored place has.
    """
    last = np.array(shape)[:, None] - 1
    edge = np.clip(place, 0, last)
    beyond = (place != edge).astype(float)
    for parts in product((0, 1), repeat=2):
        mirrored = np.array(parts)[:, None]
        factor = np.where(mirrored, -beyond, 1.0 + beyond).prod(axis=0)
        row, column = np.where(mirrored, 2 * edge - place, edge)
        yield factor, row * shape[1] + column


def seen_mm(design: Design, view: View) -> tuple[Array, Array]:
    """Point (x, y) of the untouched membrane that every pixel sees."""
    found = rays(design, view)
    x, y = found.x_mm, found.y_mm
    if design.elastomer.shape == "flat":
        return x, y
    for _ in range(ITERATIONS):
        z = np.nan_to_num(base_mm(design.elastomer, x, y))
        x, y = found.x_mm + found.slope_x * z, found.y_mm + found.slope_y * z
    return x, y
