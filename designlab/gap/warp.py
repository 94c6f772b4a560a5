"""What a camera of another pose or lens shows, by moving what the nominal one does.

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

from designlab.camera import View, Vignetting
from designlab.design import Design
from designlab.gap.splines import coefficients, look_up
from designlab.viewing import rays
from geometries.elastomer import base_mm

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]
MOST_PX = 16  # by which pictures are continued in proportion beyond their edges
ITERATIONS = 6
SETTLED_PX = 1e-6  # steps below which no further ones are taken


class Warp:
    """Resampling of pictures of one design in one view into those of another.

    Parameters
    ----------
    nominal, changed : Design
        The designs; they differ in their cameras alone.
    view : View
        The part of the camera's sensor.
    """

    def __init__(self, nominal: Design, changed: Design, view: View) -> None:
        self._pad = min(MOST_PX, view.rows - 1, view.columns - 1)
        self._place = self._inverse(np.stack(seen_mm(nominal, view)), np.stack(seen_mm(changed, view)))
        self._before: Array | float = 1.0
        self._after: Array | float = 1.0
        if nominal.camera.vignetting != Vignetting():
            self._before, self._after = nominal.camera.vignette(view), changed.camera.vignette(view)

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

    def _inverse(self, nominal: Array, changed: Array) -> Array:
        """Row and column where the nominal picture shows what each pixel of the other sees."""
        place = np.indices(nominal.shape[1:]).astype(float)
        slopes = np.stack([np.stack(np.gradient(part)) for part in nominal])  # of (x, y) by (row, column)
        per_mm = np.linalg.inv(np.moveaxis(slopes, (0, 1), (-2, -1)))
        found = coefficients(nominal, self._pad)
        for _ in range(ITERATIONS):
            off = changed - look_up(found, place, self._pad)
            step = np.einsum("rkab,brk->ark", per_mm, off)
            place = place + step
            if np.abs(step).max() < SETTLED_PX:
                break
        return place


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
