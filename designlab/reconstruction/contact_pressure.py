"""Pressure under the height that a picture shows, and where something touches the gel."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label
from scipy.sparse import csr_array

from designlab.core.images import resize_area
from designlab.core.types import Array, Mask
from designlab.mechanics.surface_pressure import ITERATIONS, PRESSED_IN, SurfacePressure, pressure_under
from designlab.reconstruction.setup import Setup

Mode = Literal["accurate", "video"]

LEAST_TOUCHED = 0.03  # of the highest pressure, above which contacts are told apart
BLUR = 2.0  # standard deviations of the smoothing, within which a point is blurred
ABOVE_REST = 3.0  # root mean squares of what pressure does not explain, by which a contact presses in


class Effort(NamedTuple):
    """How finely pressure is solved for: points along the longer side, iterations, and where contact ends.

    Contact is where pressure is above a share of the highest of the same contact: coarse points blur edges.
    """

    points: int
    iterations: int
    touched: float


EFFORT: dict[Mode, Effort] = {
    "accurate": Effort(140, ITERATIONS, 0.1),
    "video": Effort(64, 30, 0.15),
}


@dataclass(frozen=True, eq=False)
class PressureSolver:
    """Solves for pressure on coarser points than the picture has.

    Parameters
    ----------
    setup : Setup
        Pitch of the pixels, and the gel.
    shape : tuple of int
        Rows and columns of heights.
    """

    setup: Setup
    shape: tuple[int, int]

    @cached_property
    def _coarser(self) -> dict[Mode, tuple[csr_array, csr_array]]:
        """Means over the points, down and across the picture."""

        def means(effort: Effort) -> tuple[csr_array, csr_array]:
            coarser = max(1.0, max(self.shape) / effort.points)
            down, across = (
                csr_array(resize_area(np.eye(side, dtype=np.float32), round(side / coarser), side))
                for side in self.shape
            )
            return down, across

        return {mode: means(effort) for mode, effort in EFFORT.items()}

    def under(self, height_mm: Array, effort: Mode) -> SurfacePressure:
        """Pressure over the modulus that gives the gel these heights (mm, pressed in positive)."""
        assert self.setup.thickness_mm is not None  # of every calibration
        down, across = self._coarser[effort]
        small = (across @ (down @ height_mm).T).T
        return pressure_under(
            np.ascontiguousarray(small, dtype=height_mm.dtype),
            poisson=self.setup.poisson,
            thickness_mm=self.setup.thickness_mm,
            pitch_mm=self.setup.mm_per_px * height_mm.shape[1] / small.shape[1],
            iterations=EFFORT[effort].iterations,
        )


def contact_of(found: SurfacePressure, shape: tuple[int, ...], touched: float, smoothing_px: float) -> Mask:
    """Where the pressure of each contact is a share of its own highest, on the pixels of the picture.

    No contact is what goes less deep than a contact does somewhere, presses the surface in no deeper than
    what pressure does not explain of it anyway, or is no larger than a point of the blurred picture.
    """
    pressure, near = found.pressure, np.ones((3, 3))
    parts, count = label(pressure > LEAST_TOUCHED * pressure.max(), near)
    peaks = np.array([0.0, *(pressure[parts == part].max() for part in range(1, count + 1))])
    least = np.where(parts > 0, touched * peaks.astype(pressure.dtype)[parts], np.inf)
    islands, count = label(pressure > least, near)
    deep = PRESSED_IN * found.height_mm.max()
    for island in range(1, count + 1):
        own = islands == island
        if found.height_mm[own].max() < deep or found.lift_mm(own) < ABOVE_REST * found.rest_mm:
            # nor is what is beside it larger by it
            pressure, least = np.where(own, 0, pressure), np.where(own, np.inf, least)
    pressure = at_pixels(pressure, shape)
    for axis, length in enumerate(shape):
        low, _ = _between(length, least.shape[axis])
        # a contact may end half a point beyond its last
        least = np.minimum(least.take(low, axis), least.take(low + 1, axis))
    islands, count = label(pressure > least, near)
    areas = np.bincount(islands.ravel(), minlength=count + 1)
    areas[0] = 0
    large = areas > min(np.pi * (BLUR * smoothing_px) ** 2, 0.99 * areas.max())
    return np.asarray(large[islands])


def at_pixels(values: Array, shape: tuple[int, ...]) -> Array:
    """Values on points, at the pixels of a picture, by linear interpolation."""
    for axis, length in enumerate(shape):
        low, share = _between(length, values.shape[axis])
        share = np.expand_dims(share.astype(values.dtype), 1 - axis)
        values = (1 - share) * values.take(low, axis) + share * values.take(low + 1, axis)
    return values


def _between(pixels: int, points: int) -> tuple[NDArray[np.int_], Array]:
    """For each pixel of a side the point before it, and the share of the way to the next."""
    at = np.clip((np.arange(pixels) + 0.5) * points / pixels - 0.5, 0, points - 1)
    low = np.minimum(at.astype(int), points - 2)
    return low, at - low
