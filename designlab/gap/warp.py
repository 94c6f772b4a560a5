"""What a camera of another pose or lens shows, by moving what the nominal one does.

A membrane looks much the same from a place a fraction of a millimetre away. So a picture is not traced anew
but resampled: every pixel takes the light of the membrane point it sees from where the nominal picture has
it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.camera import View, Vignetting
from designlab.design import Design
from designlab.viewing import rays
from geometries.elastomer import base_mm

Array = NDArray[np.float64]
MOST_PX = 16  # by which pictures are continued in proportion beyond their edges
ITERATIONS = 6
ORDER = 3  # of the splines


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

    def __call__(self, light: NDArray[np.floating], *, order: int = ORDER) -> NDArray[np.floating]:
        """Resample light, shape (n, rows, columns), by splines of an order."""
        moved = np.stack([self._at(layer, self._place, order) for layer in light / self._before])
        return np.asarray(moved * self._after, dtype=light.dtype)

    def _inverse(self, nominal: Array, changed: Array) -> Array:
        """Row and column where the nominal picture shows what each pixel of the other sees."""
        place = np.indices(nominal.shape[1:]).astype(float)
        slopes = np.stack([np.stack(np.gradient(part)) for part in nominal])  # of (x, y) by (row, column)
        per_mm = np.linalg.pinv(np.moveaxis(slopes, (0, 1), (-2, -1)))
        for _ in range(ITERATIONS):
            off = changed - np.stack([self._at(part, place) for part in nominal])
            place = place + np.einsum("rkab,brk->ark", per_mm, off)
        return place

    def _at(self, layer: NDArray[np.floating], place: Array, order: int = ORDER) -> Array:
        wide = np.pad(layer, self._pad, mode="reflect", reflect_type="odd")
        return np.asarray(map_coordinates(wide, place + self._pad, order=order, mode="nearest"))


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
