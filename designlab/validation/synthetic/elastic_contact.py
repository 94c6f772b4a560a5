"""Frictionless contact of a round probe with a bonded elastic layer, exact within linear elasticity.

The layer has thickness h, Young's modulus E and Poisson's ratio nu, and is bonded to a rigid base. With
E* = E / (1 - nu^2) a Hankel component p(q) of the pressure sinks the surface by 2 S(qh) / (E* q) p(q);
S is the layer's response as a share of the half space's. Written as p(q) = E*/2 int_0^a chi(t) cos(qt) dt, a
pressure vanishes outside the contact radius a, and the probe's profile determines chi through a Fredholm
equation of the second kind,

    (pi/2) chi(t) - int_0^a K(t, s) chi(s) ds = g(t),    K = int_0^inf (1 - S(qh)) cos(qs) cos(qt) dq,

the method of Lebedev and Ufliand (1958) and of Hayes et al. (1972, J. Biomechanics 5, 541). It is solved by
Nystrom's method with Gauss-Legendre nodes: no grid, no iteration over the contact, none of the code of the
contact solver that simulates a press.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import j0

from designlab.core.types import Array

DEPTH_OF_DECAY = 28.0  # qh at which 1 - S, which falls as (qh)^2 exp(-2 qh), is below 1e-20
LEAST_NODES = 40
NODES_PER_THICKNESS = 10.0  # chi varies over lengths of the layer's thickness
WAVES_PER_THICKNESS = 20.0  # nodes in q for each thickness of distance: 28 / 2 would just resolve the cosines


def layer_share(x: Array, poisson: float) -> Array:
    """Sinking S of a bonded layer's surface under a cosine of pressure, as a share of the half space's.

    Parameters
    ----------
    x : array
        Wave number times thickness, greater than 0.
    poisson : float
        Poisson's ratio, in (0, 0.5].
    """
    k = 3.0 - 4.0 * poisson
    # numerator and denominator times 2 exp(-2x), so that nothing overflows
    decay = np.exp(-2.0 * x)
    numerator = -k * np.expm1(-4.0 * x) - 4.0 * x * decay
    rest = 2.0 * x**2 + 5.0 - 12.0 * poisson + 8.0 * poisson**2
    return np.asarray(numerator / (k * (1.0 + decay**2) + 2.0 * rest * decay))


@dataclass(frozen=True)
class ElasticBase:
    """Elastic layer that is bonded to a rigid base.

    Attributes
    ----------
    modulus_mpa : float
        Young's modulus (MPa).
    poisson : float
        Poisson's ratio, in (0, 0.5].
    thickness_mm : float
        Thickness (mm).
    """

    modulus_mpa: float
    poisson: float
    thickness_mm: float

    def __post_init__(self) -> None:
        for name in ("modulus_mpa", "thickness_mm"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)}: must be above 0")
        if not 0 < self.poisson <= 0.5:
            raise ValueError(f"poisson = {self.poisson}: must lie in (0, 0.5]")

    @property
    def plane_modulus_mpa(self) -> float:
        """Plane-strain modulus E / (1 - nu^2) (MPa)."""
        return self.modulus_mpa / (1.0 - self.poisson**2)


@dataclass(frozen=True)
class RoundContact:
    """Solved contact of a round probe.

    Attributes
    ----------
    base : ElasticBase
        The layer.
    depth_mm : float
        How far the probe's foremost point lies below the undeformed surface (mm).
    contact_radius_mm : float
        Radius of the contact (mm).
    nodes_mm, weights_mm, density : array, shape (nodes,)
        Gauss-Legendre nodes and weights on the contact radius, and chi there (no unit).
    source : callable
        Right side g of the integral equation at distances from the axis (mm).
    """

    base: ElasticBase
    depth_mm: float
    contact_radius_mm: float
    nodes_mm: Array
    weights_mm: Array
    density: Array
    source: Callable[[Array], Array]

    @cached_property
    def force_n(self) -> float:
        """Force on the probe (N)."""
        return float(np.pi * self.base.plane_modulus_mpa * self.weights_mm @ self.density)

    @cached_property
    def edge_density(self) -> float:
        """Value of chi at the contact's edge; 0 for a smooth probe, whose pressure ends without a step."""
        return float(self._density_at(np.array([self.contact_radius_mm]))[0])

    def _transform(self, wave: Array) -> Array:
        """Cosine transform of chi (mm) at wave numbers (1/mm)."""
        return np.asarray(np.cos(np.outer(wave, self.nodes_mm)) @ (self.weights_mm * self.density))

    def _density_at(self, t_mm: Array) -> Array:
        """Value of chi at any distances from the axis within the contact, by the integral equation itself."""
        wave, share = missing_share(self.base, 2.0 * self.contact_radius_mm)
        missing = np.cos(np.outer(t_mm.ravel(), wave)) @ (share * self._transform(wave))
        return np.asarray(2.0 / np.pi * (self.source(t_mm) + missing.reshape(t_mm.shape)))

    def surface_mm(self, r_mm: Array) -> Array:
        """Height of the deformed surface, positive into the gel, negative where it bulges.

        It follows from the pressure everywhere, so that within the contact it repeats the probe's profile.

        Parameters
        ----------
        r_mm : array, any shape
            Distances from the axis, at least 0 (mm). Time and memory grow with their number; for a picture,
            interpolate between some hundreds.
        """
        r = np.asarray(r_mm, dtype=float)
        flat = r.ravel()
        # int_0^min(a, r) chi(s) / sqrt(r^2 - s^2) ds, with s = r sin(angle)
        angle, weight = _gauss_legendre(len(self.nodes_mm))
        inside = np.minimum(self.contact_radius_mm / np.maximum(flat, 1e-300), 1.0)
        last = np.arcsin(inside)[:, None]
        at = flat[:, None] * np.sin(0.5 * last * (angle + 1.0))
        half_space = (self._density_at(at) @ weight) * 0.5 * last[:, 0]
        wave, share = missing_share(self.base, self.contact_radius_mm + float(flat.max(initial=0.0)))
        missing = j0(np.outer(flat, wave)) @ (share * self._transform(wave))
        return np.asarray(half_space - missing).reshape(r.shape)

    def pressure_mpa(self, r_mm: Array) -> Array:
        """Pressure at distances from the axis (MPa), 0 outside the contact.

        Parameters
        ----------
        r_mm : array, any shape
            Distances from the axis (mm).
        """
        radius = self.contact_radius_mm
        r = np.asarray(r_mm, dtype=float)
        fit = np.polynomial.Legendre.fit(
            self.nodes_mm / radius, self.density, min(len(self.nodes_mm) - 1, 60), domain=[0.0, 1.0]
        )
        slope = fit.deriv()
        within = np.minimum(r.ravel() / radius, 1.0)[:, None]
        # int_r^a chi'(s) / sqrt(s^2 - r^2) ds; s^2 = r^2 + (a^2 - r^2) x^2 takes the root away
        node, weight = _gauss_legendre(len(self.nodes_mm))
        reach = np.sqrt(1.0 - within**2)
        distance = np.sqrt(within**2 + (reach * 0.5 * (node + 1.0)) ** 2)
        inner = (slope(distance) / np.maximum(distance, 1e-300)) @ (0.5 * weight) * reach[:, 0] / radius
        with np.errstate(divide="ignore", invalid="ignore"):
            edge = np.where(reach[:, 0] > 0, self.edge_density / (reach[:, 0] * radius), 0.0)
        pressure = 0.5 * self.base.plane_modulus_mpa * (edge - inner)
        return np.asarray(np.where(r.ravel() < radius, pressure, 0.0)).reshape(r.shape)

    @cached_property
    def bulge_mm(self) -> tuple[float, float]:
        """Greatest rise of the surface outside the contact, and its distance from the axis (mm)."""
        from scipy.optimize import minimize_scalar

        span = 8.0 * self.base.thickness_mm + 2.0 * self.contact_radius_mm
        grid = self.contact_radius_mm + span * np.linspace(0.0, 1.0, 161) ** 2
        peak = min(max(int(self.surface_mm(grid).argmin()), 1), len(grid) - 2)
        found = minimize_scalar(
            lambda r: float(self.surface_mm(np.array([r]))[0]),
            bounds=(grid[peak - 1], grid[peak + 1]),
            method="bounded",
            options={"xatol": 1e-6 * self.base.thickness_mm},
        )
        return max(-float(found.fun), 0.0), float(found.x)


@lru_cache(maxsize=64)
def _rule(number: int) -> tuple[Array, Array]:
    return np.polynomial.legendre.leggauss(number)


def _gauss_legendre(least: int) -> tuple[Array, Array]:
    """Nodes and weights of a Gauss-Legendre rule on [-1, 1] with some more nodes than `least`."""
    # few different rules, as finding one takes longer than all else; 20 % between them
    return _rule(int(np.ceil(1.2 ** np.ceil(np.log(least) / np.log(1.2)))))


def missing_share(base: ElasticBase, distance_mm: float) -> tuple[Array, Array]:
    """Nodes in q (1/mm), and weights times 1 - S(qh), that resolve cosines over `distance_mm`."""
    node, weight = _gauss_legendre(80 + int(WAVES_PER_THICKNESS * distance_mm / base.thickness_mm))
    x = 0.5 * DEPTH_OF_DECAY * (node + 1.0)
    share = 0.5 * DEPTH_OF_DECAY * weight * (1.0 - layer_share(x, base.poisson))
    return x / base.thickness_mm, share / base.thickness_mm


def _solve(base: ElasticBase, radius_mm: float, *sources: Callable[[Array], Array]) -> tuple[Array, ...]:
    """Nodes, weights, and chi for each right side of the integral equation."""
    node, weight = _gauss_legendre(LEAST_NODES + int(NODES_PER_THICKNESS * radius_mm / base.thickness_mm))
    nodes, weights = 0.5 * radius_mm * (node + 1.0), 0.5 * radius_mm * weight
    wave, share = missing_share(base, 2.0 * radius_mm)
    cosines = np.cos(np.outer(nodes, wave))
    kernel = (cosines * share) @ cosines.T
    matrix = 0.5 * np.pi * np.eye(len(nodes)) - kernel * weights
    found = np.linalg.solve(matrix, np.stack([source(nodes) for source in sources], axis=1))
    return nodes, weights, *found.T


def press_flat_punch(base: ElasticBase, *, punch_radius_mm: float, depth_mm: float) -> RoundContact:
    """Press the flat end of a round cylinder with a sharp edge into the layer.

    Parameters
    ----------
    base : ElasticBase
        The layer.
    punch_radius_mm : float
        Radius of the cylinder, which is the contact's (mm).
    depth_mm : float
        Depth (mm).

    Raises
    ------
    ValueError
        If a length is not above 0.
    """
    _check_lengths(punch_radius_mm=punch_radius_mm, depth_mm=depth_mm)

    def source(t: Array) -> Array:
        return np.full_like(t, depth_mm)

    nodes, weights, density = _solve(base, punch_radius_mm, source)
    return RoundContact(base, depth_mm, punch_radius_mm, nodes, weights, density, source)


def press_paraboloid(base: ElasticBase, *, tip_radius_mm: float, depth_mm: float) -> RoundContact:
    """Press a paraboloid r^2 / (2 R) into the layer, which is Hertz's approximation of a ball.

    Parameters
    ----------
    base : ElasticBase
        The layer.
    tip_radius_mm : float
        Radius of curvature R at the tip (mm).
    depth_mm : float
        Depth (mm).

    Raises
    ------
    ValueError
        If a length is not above 0.
    """
    _check_lengths(tip_radius_mm=tip_radius_mm, depth_mm=depth_mm)
    return _press_smooth(base, lambda t: t**2 / tip_radius_mm, np.inf, tip_radius_mm, depth_mm)


def press_ball(
    base: ElasticBase, *, ball_radius_mm: float, depth_mm: float, dome_radius_mm: float = np.inf
) -> RoundContact:
    """Press a ball into the layer, or into one that is bent towards it but answers as if it were flat.

    Parameters
    ----------
    base : ElasticBase
        The layer.
    ball_radius_mm : float
        Radius of the ball (mm).
    depth_mm : float
        Depth (mm).
    dome_radius_mm : float
        Radius of the layer's surface (mm): its distance from the ball adds to the ball's own.

    Raises
    ------
    ValueError
        If a length is not above 0.
    """
    _check_lengths(ball_radius_mm=ball_radius_mm, depth_mm=depth_mm, dome_radius_mm=dome_radius_mm)
    # artanh(t / R) = 0.5 ln((R + t) / (R - t)); profiles add, and so do these parts of g.
    return _press_smooth(
        base,
        lambda t: t * (np.arctanh(t / ball_radius_mm) + np.arctanh(t / dome_radius_mm)),
        min(ball_radius_mm, dome_radius_mm),
        1 / (1 / ball_radius_mm + 1 / dome_radius_mm),
        depth_mm,
    )


def _press_smooth(
    base: ElasticBase, profile: Callable[[Array], Array], end_mm: float, tip_radius_mm: float, depth_mm: float
) -> RoundContact:
    """Contact of a probe without edges: its radius is where the pressure ends without a step.

    `profile` is the part of g that the probe's shape takes away, `end_mm` the radius of the probe.
    """
    # No layer is touched wider than the thin incompressible one, whose contact has radius 2 sqrt(R d).
    most = min(2.05 * float(np.sqrt(tip_radius_mm * depth_mm)), end_mm * (1.0 - 1e-12))

    def at_edge(radius: float) -> tuple[float, Array, Array, Array, Array]:
        nodes, weights, level, shape = _solve(base, radius, np.ones_like, profile)
        wave, share = missing_share(base, 2.0 * radius)
        edge = share * np.cos(radius * wave) @ np.cos(np.outer(wave, nodes)) * weights
        balance = depth_mm * (1.0 + edge @ level) - (float(profile(np.asarray(radius))) + edge @ shape)
        return float(balance), nodes, weights, level, shape

    radius = float(brentq(lambda a: at_edge(a)[0], 1e-6 * most, most, xtol=1e-12 * most, rtol=1e-12))
    _, nodes, weights, level, shape = at_edge(radius)
    return RoundContact(
        base, depth_mm, radius, nodes, weights, depth_mm * level - shape, lambda t: depth_mm - profile(t)
    )


def _check_lengths(**lengths_mm: float) -> None:
    """Refuse lengths that are not above 0, by name."""
    for name, value in lengths_mm.items():
        if not value > 0:
            raise ValueError(f"{name} = {value}: must be above 0")
