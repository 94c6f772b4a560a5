"""Surface of an elastic layer under a ball, from its contact radius, exact within linear elasticity.

With S(qh) the layer's response as a share of a half space's, the pressure under a ball of radius R that
touches within the radius a has a density chi with

    (pi/2) chi(t) - int_0^a K(t, s) chi(s) ds = d - t artanh(t/R),   K = int_0^inf (1 - S) cos qs cos qt dq

(Lebedev and Ufliand 1958; Hayes et al. 1972, J. Biomechanics 5, 541). The pressure of a ball ends without a
step, chi(a) = 0, and since chi is linear in the depth d, the contact radius gives the depth. A layer that
bulges with the curvature k leaves a gap wider by k r^2 / 2, which takes k t^2 more from the right side.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.special import i1e, j1

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
    bulge_per_mm : float
        Mean curvature of the untouched layer, positive for a dome (1/mm), which falls away from the camera;
        a hollow must be wider than the ball. Heights and slopes are of the indentation alone.
    skin_mm : float
        How far a coating rounds the indentation (standard deviation of a Gaussian), see `slope`.
    """

    ball_radius_mm: float
    thickness_mm: float
    poisson: float
    bulge_per_mm: float = 0.0
    skin_mm: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a hollow in which the ball would touch at a ring."""
        if 1 + self.bulge_per_mm * self.ball_radius_mm <= 0:
            raise ValueError(
                f"bulge_per_mm: the gel's hollow must be wider than the ball of "
                f"{2 * self.ball_radius_mm:g} mm, got a radius of {-1 / self.bulge_per_mm:.3g} mm"
            )

    def depth_mm(self, contact_radius_mm: float) -> float:
        """Depth at which the ball touches the layer within a circle of this radius (mm)."""
        # depth is nearly in proportion to the contact's area
        radius = contact_radius_mm / self.ball_radius_mm
        ratio = self._solved[0](min(radius, _RADII[-1]))
        return self.ball_radius_mm * radius**2 * float(ratio)

    def contact_share(self, contact_radius_mm: float) -> float:
        """Contact radius over that of the circle in which the ball, as deep, cuts the untouched surface."""
        depth = min(self.depth_mm(contact_radius_mm), self.ball_radius_mm)
        chord = depth * (2 * self.ball_radius_mm - depth)  # its square, on a plane
        flatter = 1 + self.bulge_per_mm * (self.ball_radius_mm - depth)
        cut = 2 * chord / (flatter + math.sqrt(flatter**2 + self.bulge_per_mm**2 * chord))
        return contact_radius_mm / math.sqrt(cut)

    def slope(self, r_mm: Array, contact_radius_mm: float) -> Array:
        """Slope dz/dr of the height, any shape; positive beyond the deepest trough around the contact.

        Parameters
        ----------
        r_mm : array
            Distances from the axis of the ball (mm).
        contact_radius_mm : float
            Contact radius (mm).
        """
        if not self.skin_mm:
            return self._bare_slope(r_mm, contact_radius_mm)
        distance = _distances(contact_radius_mm)
        rounded = _rounded(distance, self._bare_slope(distance, contact_radius_mm), self.skin_mm)
        return np.asarray(np.interp(r_mm, distance, rounded, right=0.0))

    def gradient(self, x_mm: Array, y_mm: Array, contact_radius_mm: float) -> tuple[Array, Array]:
        """Slopes dz/dx and dz/dy of the height at places from the axis (mm)."""
        r_mm = np.hypot(x_mm, y_mm)
        ratio = self.slope(r_mm, contact_radius_mm) / np.maximum(r_mm, 1e-9)
        return np.asarray(ratio * x_mm), np.asarray(ratio * y_mm)

    def _bare_slope(self, r_mm: Array, contact_radius_mm: float) -> Array:
        # slopes in contacts are known; of what is beyond, the ratio to that at the rim is interpolated
        beyond = self._solved[1](np.clip(contact_radius_mm / self.ball_radius_mm, _RADII[0], _RADII[-1]))
        within = np.minimum(r_mm, contact_radius_mm)
        ball = within / np.sqrt(np.maximum(self.ball_radius_mm**2 - within**2, 1e-3 * self.ball_radius_mm**2))
        shape = -ball - self.bulge_per_mm * within
        return np.asarray(shape * np.interp(r_mm / contact_radius_mm, _DISTANCES, beyond, right=0.0))

    def height_of(self, contact_radius_mm: float) -> Callable[[Array], Array]:
        """Height of the indentation (mm) as a function of the distance from the axis (mm).

        It is the sum of the slopes from far away.
        """
        distance = _distances(contact_radius_mm)
        slope = self.slope(distance, contact_radius_mm)
        steps = np.diff(distance) * (slope[1:] + slope[:-1]) / 2
        height = -np.concatenate([np.cumsum(steps[::-1])[::-1], [0.0]])
        return lambda r_mm: np.asarray(np.interp(r_mm, distance, height))

    @cached_property
    def _solved(self) -> tuple[BSpline, BSpline]:
        bulge = self.bulge_per_mm * self.ball_radius_mm
        return _table(self.thickness_mm / self.ball_radius_mm, self.poisson, bulge)


def _distances(contact_radius_mm: float) -> Array:
    """Distances from the axis at which a surface is summed up and rounded (mm)."""
    return contact_radius_mm * np.concatenate([np.linspace(0, 1, 65)[:-1], _DISTANCES[1:]])


def _rounded(distance: Array, slope: Array, sigma: float) -> Array:
    """Radial slopes of a surface around an axis that a Gaussian in the plane smooths."""
    step = np.gradient(distance)
    step[[0, -1]] /= 2
    apart = np.subtract.outer(distance, distance) / sigma
    weight = np.exp(-(apart**2) / 2) * i1e(np.outer(distance, distance) / sigma**2) * distance * step
    # A Gaussian leaves slopes in proportion to the distance as they are, also one thinner than a step.
    kept = weight @ distance
    return np.asarray(weight @ slope * distance / np.where(kept > 0, kept, 1.0))


@lru_cache(maxsize=64)
def _table(thickness: float, poisson: float, bulge: float) -> tuple[BSpline, BSpline]:
    """Splines over the contact radius of a ball of radius 1: depth over its square, slopes over the rim's."""
    solved = [_contact(radius, thickness, poisson, bulge) for radius in _RADII]
    depths = np.array([depth for depth, _ in solved]) / _RADII**2
    return make_interp_spline(_RADII, depths, k=3), make_interp_spline(
        _RADII, np.array([slopes for _, slopes in solved]), k=3
    )


def _contact(radius: float, thickness: float, poisson: float, bulge: float) -> tuple[float, Array]:
    """Depth of a ball of radius 1, and slopes at `_DISTANCES` radii from its axis as shares of the rim's."""
    layer = ElasticLayer(1.0, poisson, thickness)
    q, dq = _rule(_waves(2 * radius, thickness), _DEEP / thickness)
    missing = dq * (1 - layer.normal(q) * q / (2 * (1 - poisson**2)))
    t, dt = _rule(_NODES, radius)
    cosines = np.cos(np.outer(t, q))
    matrix = 0.5 * np.pi * np.eye(t.size) - (cosines * missing) @ cosines.T * dt

    def gap(t: Array | float) -> Array:
        return np.asarray(t * np.arctanh(t) + bulge * t**2)

    level, shape = np.linalg.solve(matrix, np.stack([np.ones_like(t), gap(t)], axis=1)).T
    # chi at the rim by the equation itself, for the depth and for the ball's shape
    rim = (missing * np.cos(radius * q)) @ cosines.T * dt
    depth = float((gap(radius) + rim @ shape) / (1 + rim @ level))
    chi = depth * level - shape

    q, dq = _rule(_waves((1 + _REACH) * radius, thickness), _DEEP / thickness)
    missing = dq * (1 - layer.normal(q) * q / (2 * (1 - poisson**2)))
    wave = missing * q * (np.cos(np.outer(q, t)) @ (dt * chi))
    chi_slope = make_interp_spline(
        t, 2 / np.pi * (-np.arctanh(t) - t / (1 - t**2) - 2 * bulge * t - np.sin(np.outer(t, q)) @ wave), k=3
    )
    r = _DISTANCES[2:] * radius
    # int_0^a chi'(s) s / (r sqrt(r^2 - s^2)) ds with s = r sin(angle)
    angle, weight = _rule(_NODES, 1.0)
    last = np.arcsin(radius / r)[:, None]
    sine = np.sin(angle * last)
    half_space = (chi_slope(r[:, None] * sine) * sine * last) @ weight
    slopes = half_space + j1(np.outer(r, q)) @ wave
    return depth, np.concatenate([[1.0, 1.0], slopes / -(radius / np.sqrt(1 - radius**2) + bulge * radius)])


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
