"""Surface of an elastic layer under a ball, from its contact radius."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from designlab.core.types import Array
from designlab.mechanics.contact import press
from designlab.mechanics.layer import ElasticLayer

_DEPTHS = (0.04, 0.08, 0.13, 0.19, 0.26, 0.34, 0.43)  # of the ball's radius, tabulated
_CELLS = 18  # of the grid for the radius of the circle in which the ball cuts the plane
_REACH = 4.0  # contact radii to which slopes are tabulated
_DISTANCES = np.linspace(0.0, _REACH, 201)


@dataclass(frozen=True)
class BallSurface:
    """Surface of a bonded elastic layer that a ball is pressed into, without friction.

    Its shape depends on the ratios of depth, ball and thickness and on Poisson's ratio, not on the modulus.
    It is solved at some depths (`mechanics.contact.press`) and interpolated between.

    Parameters
    ----------
    ball_radius_mm, thickness_mm : float
        Radius of the ball and thickness of the layer (mm).
    poisson : float
        Poisson's ratio of the layer.
    """

    ball_radius_mm: float
    thickness_mm: float
    poisson: float

    def depth_mm(self, contact_radius_mm: float) -> float:
        """Depth at which the ball touches the layer within a circle of this radius (mm)."""
        radii, depths, _ = self._solved
        # depth is nearly in proportion to the contact's area
        area = (contact_radius_mm / self.ball_radius_mm) ** 2
        return self.ball_radius_mm * float(np.interp(area, radii**2, depths))

    def contact_share(self, contact_radius_mm: float) -> float:
        """Contact radius over that of the circle in which the ball, as deep, cuts the untouched surface."""
        depth = self.depth_mm(contact_radius_mm)
        return contact_radius_mm / math.sqrt(depth * (2 * self.ball_radius_mm - depth))

    def slope(self, r_mm: Array, contact_radius_mm: float) -> Array:
        """Slope dz/dr of the height, any shape; positive beyond the deepest trough around the contact.

        Parameters
        ----------
        r_mm : array
            Distances from the axis of the ball (mm).
        contact_radius_mm : float
            Contact radius (mm).
        """
        radii, _, slopes = self._solved
        radius = contact_radius_mm / self.ball_radius_mm
        upper = int(np.clip(np.searchsorted(radii, radius), 1, len(radii) - 1))
        share = float(np.clip((radius - radii[upper - 1]) / (radii[upper] - radii[upper - 1]), 0, 1))
        # slopes in contacts are known; of what is beyond, the ratio to that at the rim is interpolated
        beyond = (1 - share) * slopes[upper - 1] + share * slopes[upper]
        within = np.minimum(r_mm, contact_radius_mm)
        ball = -within / np.sqrt(
            np.maximum(self.ball_radius_mm**2 - within**2, 1e-3 * self.ball_radius_mm**2)
        )
        return np.asarray(ball * np.interp(r_mm / contact_radius_mm, _DISTANCES, beyond, right=0.0))

    @cached_property
    def _solved(self) -> tuple[Array, Array, Array]:
        """Contact radii and depths in ball radii, and slopes as shares of that at the rim."""
        return _table(self.thickness_mm / self.ball_radius_mm, self.poisson)


@lru_cache(maxsize=64)
def _table(thickness: float, poisson: float) -> tuple[Array, Array, Array]:
    """`BallSurface._solved` for a ball of radius 1."""
    layer = ElasticLayer(1.0, poisson, thickness)
    radii, slopes = [0.0], []
    for depth in _DEPTHS:
        pitch = math.sqrt(depth * (2 - depth)) / _CELLS
        # a contact with a thin layer is wider than the circle of the ball in its plane
        half = min(math.ceil(1.5 * _CELLS), math.floor(0.99 / pitch))
        y, x = np.mgrid[-half : half + 1, -half : half + 1] * pitch
        gap = 1 - np.sqrt(np.maximum(1 - x**2 - y**2, 0.0))
        gap[x**2 + y**2 >= 1] = np.inf
        solution = press(gap, layer, pitch_mm=pitch, depth_mm=depth)
        radius = solution.contact_radius_mm
        count = math.ceil(_REACH * radius / pitch) + 2
        row = solution.displacement((1, count), (-half, -half))[0]
        middle = (np.arange(count - 1) + 0.5) * pitch
        rim = -radius / math.sqrt(1 - radius**2)
        found = np.interp(_DISTANCES * radius, middle, np.diff(row) / pitch) / rim
        slopes.append(np.where(_DISTANCES <= 1, 1.0, found))
        radii.append(radius)
    return np.array(radii), np.array([0.0, *_DEPTHS]), np.array([slopes[0], *slopes])
