"""Surface of an elastic layer under a ball, from its contact radius, exact within linear elasticity.

With S(qh) the layer's response as a share of a half space's, the pressure under a ball of radius R that
touches within the radius a has a density chi with

    (pi/2) chi(t) - int_0^a K(t, s) chi(s) ds = d - t artanh(t/R),   K = int_0^inf (1 - S) cos qs cos qt dq

(Lebedev and Ufliand 1958; Hayes et al. 1972, J. Biomechanics 5, 541). The pressure of a ball ends without a
step, chi(a) = 0, and since chi is linear in the depth d, the contact radius gives the depth.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.special import j1

from designlab.core.types import Array
from designlab.mechanics.layer import ElasticLayer

# Contact radii tabulated, in ball radii: up to slopes of 64 deg.
_RADII = np.array([0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.83, 0.9])
_REACH = 5.0  # contact radii to which slopes are tabulated
# Dense beyond the rim, from which slopes fall off by a root of the distance.
_DISTANCES = np.concatenate([[0.0], 1 + (_REACH - 1) * np.linspace(0, 1, 161) ** 2])
_DEEP = 28.0  # wave number times thickness at which 1 - S is below 1e-20
_NODES = 48


@dataclass(frozen=True)
class BallSurface:
    """Surface of a bonded elastic layer that a ball is pressed into, without friction.

    Its shape depends on the ratios of contact, ball and thickness and on Poisson's ratio, not on the modulus.
    It is solved for some contact radii and interpolated between.

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
        # depth is nearly in proportion to the contact's area
        radius = contact_radius_mm / self.ball_radius_mm
        ratio = self._solved[0](min(radius, _RADII[-1]))
        return self.ball_radius_mm * radius**2 * float(ratio)

    def contact_share(self, contact_radius_mm: float) -> float:
        """Contact radius over that of the circle in which the ball, as deep, cuts the untouched surface."""
        depth = min(self.depth_mm(contact_radius_mm), self.ball_radius_mm)
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
        # slopes in contacts are known; of what is beyond, the ratio to that at the rim is interpolated
        beyond = self._solved[1](np.clip(contact_radius_mm / self.ball_radius_mm, _RADII[0], _RADII[-1]))
        within = np.minimum(r_mm, contact_radius_mm)
        ball = -within / np.sqrt(
            np.maximum(self.ball_radius_mm**2 - within**2, 1e-3 * self.ball_radius_mm**2)
        )
        return np.asarray(ball * np.interp(r_mm / contact_radius_mm, _DISTANCES, beyond, right=0.0))

    def height_mm(self, r_mm: Array, contact_radius_mm: float) -> Array:
        """Height of the indentation at distances from the axis (mm): its slopes summed up from far away."""
        distance = contact_radius_mm * np.concatenate([np.linspace(0, 1, 65)[:-1], _DISTANCES[1:]])
        slope = self.slope(distance, contact_radius_mm)
        steps = np.diff(distance) * (slope[1:] + slope[:-1]) / 2
        height = -np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
        return np.asarray(np.interp(r_mm, distance, height))

    @cached_property
    def _solved(self) -> tuple[BSpline, BSpline]:
        return _table(self.thickness_mm / self.ball_radius_mm, self.poisson)


@lru_cache(maxsize=64)
def _table(thickness: float, poisson: float) -> tuple[BSpline, BSpline]:
    """Splines over the contact radius of a ball of radius 1: depth over its square, slopes over the rim's."""
    solved = [_contact(radius, thickness, poisson) for radius in _RADII]
    depths = np.array([depth for depth, _ in solved]) / _RADII**2
    return make_interp_spline(_RADII, depths, k=3), make_interp_spline(
        _RADII, np.array([slopes for _, slopes in solved]), k=3
    )


def _contact(radius: float, thickness: float, poisson: float) -> tuple[float, Array]:
    """Depth of a ball of radius 1, and slopes at `_DISTANCES` radii from its axis as shares of the rim's."""
    layer = ElasticLayer(1.0, poisson, thickness)
    q, dq = _rule(_waves(2 * radius, thickness), _DEEP / thickness)
    missing = dq * (1 - layer.normal(q) * q / (2 * (1 - poisson**2)))
    t, dt = _rule(_NODES, radius)
    cosines = np.cos(np.outer(t, q))
    matrix = 0.5 * np.pi * np.eye(t.size) - (cosines * missing) @ cosines.T * dt
    level, shape = np.linalg.solve(matrix, np.stack([np.ones_like(t), t * np.arctanh(t)], axis=1)).T
    # chi at the rim by the equation itself, for the depth and for the ball's shape
    rim = (missing * np.cos(radius * q)) @ cosines.T * dt
    depth = float((radius * np.arctanh(radius) + rim @ shape) / (1 + rim @ level))
    chi = depth * level - shape

    q, dq = _rule(_waves((1 + _REACH) * radius, thickness), _DEEP / thickness)
    missing = dq * (1 - layer.normal(q) * q / (2 * (1 - poisson**2)))
    wave = missing * q * (np.cos(np.outer(q, t)) @ (dt * chi))
    chi_slope = make_interp_spline(
        t, 2 / np.pi * (-np.arctanh(t) - t / (1 - t**2) - np.sin(np.outer(t, q)) @ wave), k=3
    )
    r = _DISTANCES[2:] * radius
    # int_0^a chi'(s) s / (r sqrt(r^2 - s^2)) ds with s = r sin(angle)
    angle, weight = _rule(_NODES, 1.0)
    last = np.arcsin(radius / r)[:, None]
    sine = np.sin(angle * last)
    half_space = (chi_slope(r[:, None] * sine) * sine * last) @ weight
    slopes = half_space + j1(np.outer(r, q)) @ wave
    return depth, np.concatenate([[1.0, 1.0], slopes / (-radius / np.sqrt(1 - radius**2))])


def _waves(distance: float, thickness: float) -> int:
    """How many nodes resolve waves as deep as the layer answers over a distance; few different numbers."""
    return math.ceil(80 * 1.2 ** math.ceil(math.log(1 + distance / thickness / 4) / math.log(1.2)))


def _rule(number: int, end: float) -> tuple[Array, Array]:
    """Nodes and weights of a Gauss-Legendre rule on [0, end]."""
    node, weight = _gauss_legendre(number)
    return 0.5 * end * (node + 1), 0.5 * end * weight


@lru_cache
def _gauss_legendre(number: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(number)
