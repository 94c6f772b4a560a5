"""Frictionless contact of a probe of any shape with a bonded elastic layer, by boundary elements.

The layer is that of `elastic_contact`. A point load sinks its surface at a distance r by

    G(r) = [1 / r - int_0^inf (1 - S(qh)) J0(qr) dq] / (pi E*),

the half space's answer less a smooth part. Squares of even pressure cover what may be touched, small where
contact ends and large within. The first part of each is integrated in closed form (Love 1929), the smooth
part taken at its middle. Pressures follow from a dense system of equations at the middles, and the contact
from the rule that nothing pulls and nothing is pierced. Neither grid nor Fourier transform is shared with the
contact solver that simulates a press.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import j0

from designlab.core.types import Array, Mask
from designlab.validation.synthetic import kernels
from designlab.validation.synthetic.elastic_contact import ElasticBase, missing_share

Wanted = Callable[[Array, Array], Array]

FURTHEST = 12.0  # thicknesses; exp(-0.74 r / h) of a load's answer is left at a distance r
TABLE_STEP = 0.01  # thicknesses, between distances at which the smooth part is kept
ACROSS, PER_THICKNESS = 20, 5  # the largest elements: so many across what may be touched, and in a thickness
FINEST = 1 / 160  # of what may be touched: elements where contact ends
MOST_ELEMENTS = 2500
CATCH = 0.3  # depths; gel that bulges may touch parts of the probe that are so far above it
LEAST_SHARE = 1e-6  # of the depth, by which a surface may lie within the probe
MOST_ROUNDS = 60


class Unsolved(RuntimeError):
    """A contact for which no set of touched elements was found."""


@dataclass(frozen=True, eq=False)
class ElementContact:
    """Solved contact.

    Attributes
    ----------
    base : ElasticBase
        The layer.
    centre_mm : array, shape (elements, 2)
        Middles of the touched squares (mm).
    size_mm : array, shape (elements,)
        Their sides (mm).
    pressure_mpa : array, shape (elements,)
        Pressure on each.
    """

    base: ElasticBase
    centre_mm: Array
    size_mm: Array
    pressure_mpa: Array

    @property
    def force_n(self) -> float:
        """Force on the probe (N)."""
        return float(self.pressure_mpa @ self.size_mm**2)

    @property
    def contact_area_mm2(self) -> float:
        """Area of the contact (mm2)."""
        return float((self.size_mm**2).sum())

    def surface_mm(self, x_mm: Array, y_mm: Array) -> Array:
        """Height of the deformed surface at points, positive into the gel, negative where it bulges (mm)."""
        points = np.stack([np.ravel(x_mm), np.ravel(y_mm)], axis=1).astype(float)
        sunk = kernels.sunk(points, self.centre_mm, self.size_mm, self.pressure_mpa, *_smooth_part(self.base))
        return np.asarray(sunk / (np.pi * self.base.plane_modulus_mpa)).reshape(np.shape(x_mm))

    def touched(self, x_mm: Array, y_mm: Array) -> Mask:
        """Which points lie within touched squares."""
        half = self.size_mm[:, None] / 2
        low, high = (self.centre_mm - half).min(axis=0), (self.centre_mm + half).max(axis=0)
        found = (x_mm >= low[0]) & (x_mm <= high[0]) & (y_mm >= low[1]) & (y_mm <= high[1])
        points = np.stack([x_mm[found], y_mm[found]], axis=1)
        found[found] = kernels.covered(points, self.centre_mm, self.size_mm)
        return np.asarray(found)


def press_any(
    base: ElasticBase, wanted: Wanted, *, middle_mm: tuple[float, float], half_mm: float, depth_mm: float
) -> ElementContact:
    """Press a probe into the layer.

    Parameters
    ----------
    base : ElasticBase
        The layer.
    wanted : callable
        Height at points (x, y) of the probe's upper side over the undeformed surface (mm); -inf beside it.
    middle_mm, half_mm : (float, float), float
        Square about everything that may be touched: its middle and half its side (mm).
    depth_mm : float
        Greatest of these heights.

    Raises
    ------
    Unsolved
        If no set of touched elements was found.
    """
    centre, size = _elements(base, wanted, np.asarray(middle_mm, dtype=float), half_mm, -CATCH * depth_mm)
    height = wanted(*centre.T)
    matrix = kernels.sinking(centre, centre, size, *_smooth_part(base))
    matrix /= np.pi * base.plane_modulus_mpa
    touched = height > 0
    for _ in range(MOST_ROUNDS):
        pressure = np.zeros(len(size))
        pressure[touched] = np.linalg.solve(matrix[np.ix_(touched, touched)], height[touched])
        pulled = pressure < 0
        if pulled.any():
            touched &= ~pulled
            continue
        pierced = ~touched & (matrix[:, touched] @ pressure[touched] < height - LEAST_SHARE * depth_mm)
        if not pierced.any():
            return ElementContact(base, centre[touched], size[touched], pressure[touched])
        touched |= pierced
    raise Unsolved(f"contact with {len(size)} elements: no solution after {MOST_ROUNDS} rounds")


def _elements(
    base: ElasticBase, wanted: Wanted, middle: Array, half_mm: float, least_mm: float
) -> tuple[Array, Array]:
    """Middles and sides of squares over all that may be touched; small about its border and its creases."""
    probe_x, probe_y = (middle[k] + half_mm * np.linspace(-1, 1, 161) for k in (0, 1))
    x, y = np.meshgrid(probe_x, probe_y)
    near = wanted(x, y) > least_mm
    low = np.array([x[near].min(), y[near].min()])
    extent = max(float(np.ptp(x[near])), float(np.ptp(y[near]))) + half_mm / 40
    largest = min(extent / ACROSS, base.thickness_mm / PER_THICKNESS)
    levels = max(int(np.ceil(np.log2(largest / (FINEST * extent)))), 0)
    while True:
        centre, size = _divided(wanted, low - half_mm / 80, extent, largest, levels, least_mm)
        if len(size) <= MOST_ELEMENTS or levels == 0:
            return centre, size
        levels -= 1


def _divided(
    wanted: Wanted, low: Array, extent: float, largest: float, levels: int, least_mm: float
) -> tuple[Array, Array]:
    """Squares of a side, those about a border divided so many times into four."""
    count = int(np.ceil(extent / largest))
    axis = (np.arange(count) + 0.5) * largest
    centre = np.stack([grid.ravel() for grid in np.meshgrid(low[0] + axis, low[1] + axis)], axis=1)
    around = np.stack([g.ravel() for g in np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-1, 1, 7))], axis=1)
    quarters = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]) / 4
    done: list[tuple[Array, Array]] = []
    side = largest
    for level in range(levels + 1):
        # What lies within one side of a square decides whether it is near a border.
        points = centre[:, None] + 1.5 * side * around
        height = wanted(points[..., 0], points[..., 1])
        inside, above = height > least_mm, height > 0
        border = (inside.any(axis=1) & ~inside.all(axis=1)) | (above.any(axis=1) & ~above.all(axis=1))
        divided = border if level < levels else np.zeros(len(centre), dtype=bool)
        done.append((centre[~divided], np.full(np.count_nonzero(~divided), side)))
        centre = (centre[divided][:, None] + side * quarters).reshape(-1, 2)
        side /= 2
    centre, size = (np.concatenate(parts) for parts in zip(*done, strict=True))
    kept = wanted(*centre.T) > least_mm
    return centre[kept], size[kept]


@lru_cache(maxsize=16)
def _smooth_part(base: ElasticBase) -> tuple[Array, float]:
    """What a layer's answer to a point load lacks of the half space's 1 / r, and the step of distances."""
    step = TABLE_STEP * base.thickness_mm
    distance = step * np.arange(int(FURTHEST / TABLE_STEP) + 2)
    wave, share = missing_share(base, float(distance[-1]))
    return np.asarray(j0(np.outer(distance, wave)) @ share), step
