"""Contact of a rigid probe with an elastic layer: pressure, friction, force and the deformed surface."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from designlab.core.types import Array
from designlab.mechanics.grid_response import MARGIN, kernel, symbol, wavenumber
from designlab.mechanics.layer import ElasticLayer

Mask = NDArray[np.bool_]
Operator = Callable[[Array], Array]
DEEPEST = 0.95  # of the thickness: the deepest press that is tried for a force
TOLERANCE = 1e-4  # relative change of the traction in an iteration at which it is taken for settled
FORCE_TOLERANCE = 1e-4  # of a stated force
MOST_ITERATIONS = 600
ROUGH = 48  # points a side of the grid on which the depth of a force is looked for first
NEARLY, CATCH = 1.15, 1.3  # how far that may be off, and depths within which gel that bulges may touch
CELLS = 16  # sizes of grids are multiples of it, so that responses kept serve for many presses
STIFFENED_TO = 0.8  # of the thickness, the deepest press of those elements that stick
SLIPS = 0.98  # of the most that friction holds; from there to all of it a point counts ever less as held
RELAXED_AFTER = 5  # rounds of friction after pressure
STIFFENING = 0.55  # of a sticking contact by finite strain, found by finite elements (docs/validation.md)
MOST_ROUNDS = 40  # of friction after pressure, and of depths for a stated force


class NotConverged(RuntimeError):
    """A contact problem whose solution was not found; no surface is given for it."""


class OutOfReach(ValueError):
    """A force that no permitted depth reaches; the text says which depth was tried and what it gives."""


class TooLittle(OutOfReach):
    """A force so small that at its depth no point of the grid touches."""


@dataclass(frozen=True, eq=False)
class ContactSolution:
    """What a probe does to the surface of a layer, on the grid of the gap.

    Attributes
    ----------
    layer : ElasticLayer
        The layer.
    pitch_mm : float
        Distance of neighbouring grid points (mm).
    depth_mm : float
        How far the probe went beyond first touch (mm).
    pressure_mpa : array, shape (rows, columns)
        Pressure on the layer, zero outside the contact.
    traction_mpa : array, shape (2, rows, columns)
        Tangential traction on the layer along columns and rows.
    friction : float
        Coefficient of friction.
    """

    layer: ElasticLayer
    pitch_mm: float
    depth_mm: float
    pressure_mpa: Array
    traction_mpa: Array
    friction: float = 0.0

    def on(self, shape: tuple[int, ...], origin: tuple[int, int]) -> "ContactSolution":
        """Put it on a larger grid of the same pitch; the origin is where its first point lies on that."""
        around = [
            (start, whole - start - own)
            for start, whole, own in zip(origin, shape, self.pressure_mpa.shape, strict=True)
        ]
        pressure = np.pad(self.pressure_mpa, around)
        traction = np.pad(self.traction_mpa, [(0, 0), *around]) if self.friction else _none(pressure)
        return replace(self, pressure_mpa=pressure, traction_mpa=traction)

    @property
    def touched(self) -> Mask:
        """Where the probe touches the layer, shape (rows, columns)."""
        return self.pressure_mpa > 0

    @cached_property
    def force_n(self) -> float:
        """Force along the normal (N): of the linear layer, stiffened where a contact sticks.

        Against nonlinear finite elements of a neo-Hookean layer the linear force is right to 4 % up to half
        the thickness where the contact slips. Where it sticks it is up to 15 % low there; dividing it by
        1 - 0.55 (depth / thickness)^2 leaves 3 %, up to 0.6 of the thickness; deeper it stays what it is at
        0.8. Between, the share of the force that does not slip counts.
        """
        linear = float(self.pressure_mpa.sum()) * self.pitch_mm**2
        depth = min(self.depth_mm / self.layer.thickness_mm, STIFFENED_TO)
        return linear / (1 - STIFFENING * self.stuck * depth**2)

    @cached_property
    def stuck(self) -> float:
        """Share of the pressure where the probe carries the skin along without slip."""
        if self.friction == 0:
            return 0.0
        pressure, traction = self.pressure_mpa[self.touched], self._traction[self.touched]
        # By degrees: with whole points the force would jump where one begins to slip, and some stated forces
        # would have no depth.
        held = np.clip((1 - traction / (self.friction * pressure)) / (1 - SLIPS), 0.0, 1.0)
        return float((held * pressure).sum() / pressure.sum())

    @property
    def tangential_force_n(self) -> tuple[float, float]:
        """Force along columns and rows (N)."""
        x, y = self.traction_mpa.sum(axis=(1, 2)) * self.pitch_mm**2
        return float(x), float(y)

    @property
    def contact_area_mm2(self) -> float:
        """Area of the contact (mm2)."""
        return float(self.touched.sum()) * self.pitch_mm**2

    @property
    def contact_radius_mm(self) -> float:
        """Radius of a circle of the area of the contact (mm)."""
        return math.sqrt(self.contact_area_mm2 / math.pi)

    def needed_friction(self, share: float = 0.95) -> float:
        """Coefficient of friction that this share of the force needs not to slip."""
        pressure, ratio = self.pressure_mpa[self.touched], self._traction[self.touched]
        order = np.argsort(ratio / pressure)
        carried = np.cumsum(pressure[order])
        return float((ratio / pressure)[order][np.searchsorted(carried, share * carried[-1])])

    @property
    def _traction(self) -> Array:
        return np.asarray(np.hypot(*self.traction_mpa))

    def displacement(
        self, shape: tuple[int, int], origin: tuple[int, int], *, smoothing_mm: float = 0.0
    ) -> Array:
        """Displacement of the surface into the layer on a grid of the same pitch.

        Parameters
        ----------
        shape : (int, int)
            Rows and columns of that grid.
        origin : (int, int)
            Row and column on it of this solution's first point; they may lie outside.
        smoothing_mm : float
            Standard deviation of a normal distribution that the displacement is averaged over (mm), which
            keeps its volume.

        Returns
        -------
        array, shape (rows, columns)
            Displacement in mm, positive into the layer; negative where the layer bulges.
        """
        return self._moved(shape, origin, ("zz", "zx", "zy"), smoothing_mm)

    def tangential_displacement(
        self, shape: tuple[int, int], origin: tuple[int, int], *, smoothing_mm: float = 0.0
    ) -> Array:
        """Displacement of the surface along columns and rows; arguments as in `displacement`.

        Returns
        -------
        array, shape (2, rows, columns)
            Displacement in mm.
        """
        x = self._moved(shape, origin, ("xz", "xx", "xy"), smoothing_mm)
        y = self._moved(shape, origin, ("yz", "xy", "yy"), smoothing_mm)
        return np.stack([x, y])

    def _moved(
        self,
        shape: tuple[int, int],
        origin: tuple[int, int],
        parts: tuple[str, str, str],
        smoothing_mm: float,
    ) -> Array:
        box = self.pressure_mpa.shape
        low = [min(0, start) for start in origin]
        high = [max(whole, start + own) for whole, start, own in zip(shape, origin, box, strict=True)]
        margin = MARGIN * self.layer.thickness_mm / self.pitch_mm
        rows, columns = (
            fft.next_fast_len(math.ceil(b - a + margin), real=True) for a, b in zip(low, high, strict=True)
        )
        row, column = origin[0] - low[0], origin[1] - low[1]
        here = np.s_[row : row + box[0], column : column + box[1]]
        spectrum: Any = 0.0
        for part, load in zip(parts, (self.pressure_mpa, *self.traction_mpa), strict=True):
            if load.any():
                spread = np.zeros((rows, columns))
                spread[here] = load
                response = symbol(_unit(self.layer), self.pitch_mm, rows, columns, part)
                spectrum = spectrum + response * fft.rfft2(spread, workers=2)
        if np.isscalar(spectrum):
            return np.zeros(shape)
        if smoothing_mm:
            spectrum *= np.exp(-((wavenumber(self.pitch_mm, rows, columns)[2] * smoothing_mm) ** 2) / 2)
        whole = fft.irfft2(spectrum, s=(rows, columns), workers=2) / self.layer.modulus_mpa
        return np.asarray(whole[-low[0] : shape[0] - low[0], -low[1] : shape[1] - low[1]])


def press(
    gap_mm: Array,
    layer: ElasticLayer,
    *,
    pitch_mm: float,
    depth_mm: float | None = None,
    force_n: float | None = None,
    deepest_mm: float | None = None,
    friction: float = 0.0,
    shift_mm: tuple[float, float] = (0.0, 0.0),
    lean: tuple[float, float] = (0.0, 0.0),
    twist_deg: float = 0.0,
    axis: tuple[float, float] = (0.0, 0.0),
) -> ContactSolution:
    """Press a rigid probe into an elastic layer, to a depth or with a force.

    The layer answers linearly (`ElasticLayer`). Pressure is nowhere negative, the surface lies nowhere above
    the probe, and where there is pressure both meet. With friction the probe carries the surface along with
    it as far as traction stays below the coefficient times the pressure (Coulomb), for a press that grows in
    one step.

    Parameters
    ----------
    gap_mm : array, shape (rows, columns)
        Distance from the untouched surface to the probe at first touch (mm), at least 0 where that is the
        lowest point; infinite where there is no probe, as everywhere beyond the grid.
    layer : ElasticLayer
        The layer.
    pitch_mm : float
        Distance of neighbouring grid points (mm).
    depth_mm : float, optional
        How far the probe goes beyond first touch (mm), above 0 and below the thickness of the layer.
    force_n : float, optional
        Force on the probe (N), above 0, instead of a depth.
    deepest_mm : float, optional
        Deepest press that is tried for a force (mm); 0.95 of the layer's thickness when absent.
    friction : float
        Coefficient of friction; 0 slips freely, infinity sticks.
    shift_mm : (float, float)
        How far the probe then moves sideways, along columns and rows (mm).
    lean : (float, float)
        How far it moves sideways for each mm of depth, along columns and rows: the tangent of the angle
        between its path and the normal.
    twist_deg : float
        How far the probe then turns, from columns to rows (degrees).
    axis : (float, float)
        Column and row of the axis that it turns about, fractional.

    Returns
    -------
    ContactSolution

    Raises
    ------
    ValueError
        If an argument breaks its rule.
    OutOfReach
        If no permitted depth reaches the force.
    NotConverged
        If no solution was found.

    Notes
    -----
    Pressure follows from conjugate gradients that keep it positive: Polonsky and Keer (1999), Wear 231, 206.
    """
    if (depth_mm is None) == (force_n is None):
        raise ValueError("depth_mm, force_n: state one of them")
    for field, value, unit in (("depth_mm", depth_mm, "mm"), ("force_n", force_n, "N")):
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"{field}: must be above 0 {unit} and finite, got {value:g}")
    if depth_mm is not None and depth_mm >= layer.thickness_mm:
        raise ValueError(
            f"depth_mm: must be below the thickness of the layer, {layer.thickness_mm:g} mm, got {depth_mm:g}"
        )
    if not 0 < pitch_mm < math.inf:
        raise ValueError(f"pitch_mm: must be above 0 mm and finite, got {pitch_mm:g}")
    if not friction >= 0:
        raise ValueError(f"friction: must be at least 0, got {friction:g}")
    problem = _Problem(
        gap_mm, layer, pitch_mm, friction, _carried(gap_mm.shape, pitch_mm, shift_mm, twist_deg, axis), lean
    )
    if depth_mm is not None:
        return problem.at(depth_mm)
    assert force_n is not None
    return problem.under(force_n, deepest_mm or DEEPEST * layer.thickness_mm)


def _carried(
    shape: tuple[int, ...],
    pitch_mm: float,
    shift_mm: tuple[float, float],
    twist_deg: float,
    axis: tuple[float, float],
) -> Array:
    """Where a probe that moves sideways and turns carries each point that sticks to it (mm)."""
    x, y = np.arange(shape[1])[None, :] - axis[0], np.arange(shape[0])[:, None] - axis[1]
    turn = math.radians(twist_deg)
    along = pitch_mm * (x * (math.cos(turn) - 1) - y * math.sin(turn))
    across = pitch_mm * (x * math.sin(turn) + y * (math.cos(turn) - 1))
    return np.stack([shift_mm[0] + along, shift_mm[1] + across])


class _Try(NamedTuple):
    """What one depth gave: logarithms of the depth and of its force over that stated."""

    depth: float
    error: float
    solution: ContactSolution
    pull: float = 0.0  # the error, or less of it, by which the next depth is laid between two


class _Problem:
    """One probe over one layer, solved for one depth after another."""

    def __init__(
        self,
        gap_mm: Array,
        layer: ElasticLayer,
        pitch_mm: float,
        friction: float,
        target: Array,
        lean: tuple[float, float] | Array,
    ) -> None:
        self.gap, self.layer, self.pitch, self.friction = gap_mm, layer, pitch_mm, friction
        self.unit = _unit(layer)  # tractions below are shares of the modulus
        self.here = np.isfinite(gap_mm)
        if not self.here.any():
            raise ValueError("gap_mm: no point of the grid is below the probe")
        self.size = CELLS * math.ceil(max(gap_mm.shape) / CELLS)
        self.target, self.lean = target, np.reshape(lean, (2, 1, 1))
        self.pressure: Array | None = None
        self.traction = np.zeros((2, *gap_mm.shape)) if friction else _none(gap_mm)

    def at(self, depth_mm: float) -> ContactSolution:
        """Solve for a depth, from the last solution."""
        overlap = np.where(self.here, depth_mm - self.gap, 0.0)
        if not (overlap > 0).any():
            raise ValueError(f"depth_mm: the probe does not touch the layer at {depth_mm:g} mm")
        if self.pressure is None:
            self.pressure = np.maximum(overlap, 0.0)
        pressure = _pressure(self._operator("zz"), overlap, self.here, self.pressure)
        if self.friction > 0:
            pressure = self._with_friction(overlap, pressure, self.target + depth_mm * self.lean)
        self.pressure = pressure
        modulus = self.layer.modulus_mpa
        traction = modulus * self.traction if self.friction else self.traction
        return ContactSolution(self.layer, self.pitch, depth_mm, modulus * pressure, traction, self.friction)

    def _with_friction(self, overlap: Array, pressure: Array, target: Array) -> Array:
        """Pressure and traction in turn, until neither changes the other."""
        normal, sideways = self._operator("zz"), self._tangential
        last: Array | None = None
        for number in range(MOST_ROUNDS):
            carried = target - np.stack([self._operator("xz")(pressure), self._operator("yz")(pressure)])
            held = pressure > 0
            most = np.multiply(self.friction, pressure, where=held, out=np.zeros_like(pressure))
            self.traction = _traction(sideways, carried, most, held, self.traction)
            lifted = self._operator("zx")(self.traction[0]) + self._operator("zy")(self.traction[1])
            if last is not None and number > RELAXED_AFTER:
                lifted = (lifted + last) / 2  # on contacts wide for the layer they overshoot
            last = lifted
            before, pressure = pressure, _pressure(normal, overlap - lifted, self.here, pressure)
            if abs(pressure.sum() / before.sum() - 1) < FORCE_TOLERANCE:
                return pressure
        raise NotConverged(f"friction: pressure and friction did not settle in {MOST_ROUNDS} rounds")

    def _tangential(self, traction: Array) -> Array:
        x, y = traction
        cross = self._operator("xy")
        return np.stack([self._operator("xx")(x) + cross(y), cross(x) + self._operator("yy")(y)])

    def under(self, force_n: float, deepest_mm: float) -> ContactSolution:
        """Find the depth of a force: force grows as a power of depth, so logarithms are followed."""
        step = math.ceil(max(self.gap.shape) / ROUGH)
        if step > 1:  # a rough grid tells how deep it is, and so how little of the grid is needed
            row, column = np.unravel_index(int(self.gap.argmin()), self.gap.shape)
            every = np.s_[row % step :: step, column % step :: step]  # with the point that touches first
            rough = self._of(self.gap[every], self.pitch * step, self.target[:, *every])
            try:
                depth = rough.under(force_n, deepest_mm).depth_mm
            except TooLittle:
                return self._followed(force_n, 2 * float(self.gap.min()) + self.pitch)
            most = min(NEARLY * depth, deepest_mm)
            used = self.gap < CATCH * most
            rows, columns = (np.flatnonzero(used.any(axis=axis)) for axis in (1, 0))
            part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            own = self._of(self.gap[part], self.pitch, self.target[:, *part])
            return own._followed(force_n, depth).on(self.gap.shape, (int(rows[0]), int(columns[0])))
        deepest = self.at(deepest_mm)
        if deepest.force_n < force_n * (1 - FORCE_TOLERANCE):
            raise OutOfReach(
                f"force_n: {force_n:g} N is not reached; the deepest press of {deepest_mm:.3g} mm takes "
                f"{deepest.force_n:.3g} N"
            )
        return self._followed(force_n, deepest_mm)

    def _of(self, gap: Array, pitch_mm: float, target: Array) -> "_Problem":
        """Put the same problem on another grid."""
        return _Problem(gap, self.layer, pitch_mm, self.friction, target, self.lean)

    def _followed(self, force_n: float, depth_mm: float) -> ContactSolution:
        """Find the depth between one with too little force and one with too much, as soon as both are known.

        Where points begin to slip or to touch, the force jumps. A force within the jump has no depth; the
        nearer side of it is taken then.
        """
        depth, power = math.log(depth_mm), 1.5
        sides: dict[bool, _Try] = {}  # the nearest tried, by whether it is too deep
        last: _Try | None = None
        for _ in range(MOST_ROUNDS):
            if math.exp(depth) <= self.gap.min():
                raise TooLittle(
                    f"force_n: {force_n:g} N is too little for a grid of {self.pitch:g} mm, no point of "
                    "which touches then"
                )
            solution = self.at(math.exp(depth))
            tried = _Try(depth, math.log(solution.force_n / force_n), solution)
            if abs(tried.error) < FORCE_TOLERANCE / 2:  # the other half is for those who correct the force
                return solution
            deep = tried.error > 0
            if len(sides) == 2 and last is not None and deep == (last.error > 0):
                other = sides[not deep]  # Illinois rule: it would not move by itself
                sides[not deep] = other._replace(pull=other.pull / 2)
            sides[deep] = tried._replace(pull=tried.error)
            if len(sides) < 2:
                if last is not None:
                    power = max((tried.error - last.error) / (tried.depth - last.depth), 1.0)
                depth -= tried.error / power
            else:
                low, high = sides[False], sides[True]
                if high.depth - low.depth < FORCE_TOLERANCE:
                    return min(low, high, key=lambda side: abs(side.error)).solution
                depth = (low.depth * high.pull - high.depth * low.pull) / (high.pull - low.pull)
            last = tried
        raise NotConverged(f"force_n: no depth was found for {force_n:g} N in {MOST_ROUNDS} tries")

    def _operator(self, part: str) -> Operator:
        """Displacement on the grid that a load on it makes."""
        spectrum, padded = kernel(self.unit, self.pitch, self.size, part)
        rows, columns = self.gap.shape

        def apply(load: Array) -> Array:
            spread = fft.rfft2(load, s=(padded, padded))
            return np.asarray(fft.irfft2(spread * spectrum, s=(padded, padded))[:rows, :columns])

        return apply


def _pressure(compliance: Operator, overlap: Array, here: Mask, start: Array) -> Array:
    """Pressure that moves the surface by the overlap where it is positive, and at least by it elsewhere."""
    moved = compliance(start)
    pressure = start * max(float((start * overlap).sum() / (start * moved).sum()), 1e-6)
    direction, before, follow = np.zeros_like(pressure), 1.0, 0.0
    for _ in range(MOST_ITERATIONS):
        above = compliance(pressure) - overlap
        held = pressure > 0
        now = float((above[held] ** 2).sum())
        if now == 0.0:  # as where the contact is one cell
            held = held | (here & (above < 0))
            now = float((above[held] ** 2).sum())
            if now == 0.0:
                return pressure
        direction = np.where(held, above + follow * (now / before) * direction, 0.0)
        answer = compliance(direction)
        step = float((above[held] * direction[held]).sum() / (answer[held] * direction[held]).sum())
        last, before = pressure, now
        pressure = np.where(held, pressure - step * direction, 0.0)
        released = pressure < 0
        pressure = np.maximum(pressure, 0.0)
        caught = here & ~held & (above < 0) & ~released
        pressure = np.where(caught, -step * above, pressure)
        follow = 0.0 if caught.any() else 1.0
        if np.abs(pressure - last).sum() < TOLERANCE * pressure.sum():
            return np.asarray(pressure)
    raise NotConverged(f"the pressure did not settle in {MOST_ITERATIONS} iterations")


def _traction(compliance: Operator, target: Array, most: Array, held: Mask, start: Array) -> Array:
    """Tangential traction that carries the surface to a target, cut to the most that friction holds."""
    traction = _cut(np.where(held, start, 0.0), most)
    direction, before, follow, slips = np.zeros_like(traction), 1.0, 0.0, np.zeros_like(held)
    for _ in range(MOST_ITERATIONS):
        beyond = np.where(held, compliance(traction) - target, 0.0)
        # Where it slips already and is pulled on, only a pull back could change anything.
        slips &= (beyond * traction).sum(axis=0) < 0
        beyond = np.where(slips, 0.0, beyond)
        now = float((beyond**2).sum())
        if now == 0.0:
            return traction
        direction = np.where(slips | ~held, 0.0, beyond + follow * (now / before) * direction)
        step = float((beyond * direction).sum() / (compliance(direction) * direction).sum())
        last, before = traction, now
        free = traction - step * direction
        traction = _cut(free, most)
        cut = held & (np.hypot(*free) > most)
        follow = 0.0 if (cut & ~slips).any() else 1.0
        slips = slips | cut
        if np.abs(traction - last).sum() <= TOLERANCE * np.abs(traction).sum():
            return traction
    raise NotConverged(f"friction: the traction did not settle in {MOST_ITERATIONS} iterations")


def _none(like: Array) -> Array:
    """No traction on a grid, which takes no memory."""
    return np.broadcast_to(np.zeros(1), (2, *like.shape))


def _cut(traction: Array, most: Array) -> Array:
    size = np.hypot(*traction)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(size > most, traction * (most / size), traction))


def _unit(layer: ElasticLayer) -> ElasticLayer:
    """Layer of unit modulus: shapes do not depend on it, and tractions are in proportion to it."""
    return replace(layer, modulus_mpa=1.0)
