"""Presses along the normal of a dome: solved where their place is the apex, then turned to where it is.

A sphere looks the same from each of its points. So the press is made on the apex of the same dome, along the
axis, by whichever model of contact there is. The pressed membrane is then turned about the sphere's centre,
and its height along z is found over every point of the sensor's own grid.
"""

import math
from dataclasses import replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter
from scipy.optimize import elementwise

from designlab.core.types import Array, Mask
from designlab.simulation.contact.approach import named
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import ROUNDING_MM, Surface
from geometries.elastomer import STEEPEST_DEG, Elastomer, base_gradient, base_mm, inside

FURTHEST_DEG = 75.0  # from the place of the press, around the sphere's centre, to what is moved by it
SPARE_MM = 0.1  # around what is moved
EXACT_MM = 1e-7  # of heights along z


class Turn(NamedTuple):
    """The turn about a dome's centre that brings its apex to the place of a press.

    Attributes
    ----------
    place_mm : (float, float, float)
        That place in the sensor frame (mm).
    normal : (float, float, float)
        Unit normal there, into the gel.
    """

    place_mm: tuple[float, float, float]
    normal: tuple[float, float, float]

    @property
    def matrix(self) -> Array:
        """Axes of the turned frame as columns: the shortest turn from z to the normal, shape (3, 3)."""
        x, y, z = self.normal
        cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
        return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))

    def back(self, points: Array) -> Array:
        """Points of the sensor frame in the turned frame (mm), shape (..., 3)."""
        return np.asarray((points - np.array(self.place_mm)) @ self.matrix)

    def forth(self, points: Array) -> Array:
        """Points of the turned frame in the sensor frame (mm), shape (..., 3)."""
        return np.asarray(points @ self.matrix.T + np.array(self.place_mm))


def turn_of(elastomer: Elastomer, press: Press) -> Turn | None:
    """The turn to a press along the normal; None where that is the axis.

    Raises
    ------
    ValueError
        If the press lies beside the gel, or the gel is neither flat nor a dome.
    """
    if press.direction == "axis" or elastomer.shape == "flat" or press.centre_mm == (0.0, 0.0):
        return None
    if elastomer.shape != "dome":
        raise ValueError(
            f"press.direction: 'normal' is simulated on flat gels and domes, elastomer.shape is "
            f"{elastomer.shape!r}; press along the axis"
        )
    x, y = press.centre_mm
    z = float(base_mm(elastomer, x, y))
    if not inside(elastomer, x, y) or math.isnan(z):
        raise ValueError(f"press.centre_mm: {named(press)} at ({x:g}, {y:g}) mm lies beside the gel")
    p, q = (float(slope) for slope in base_gradient(elastomer, x, y))
    length = math.sqrt(1.0 + p * p + q * q)
    return Turn((x, y, z), (-p / length, -q / length, 1.0 / length))


def reach_mm(untouched: Surface, elastomer: Elastomer, turn: Turn) -> float:
    """How far from the place of a press, in the turned frame, the membrane must be known (mm)."""
    assert elastomer.radius_mm is not None  # of a dome
    x, y = np.meshgrid(untouched.x_mm[[0, -1]], untouched.y_mm[[0, -1]])
    away = np.hypot(x - turn.place_mm[0], y - turn.place_mm[1]).max()
    return min(float(away) + SPARE_MM, elastomer.radius_mm * math.sin(math.radians(FURTHEST_DEG)))


def turned(made: Surface, untouched: Surface, elastomer: Elastomer, turn: Turn, press: Press) -> Surface:
    """A membrane pressed at the apex as it is over the sensor's own grid, pressed at its place.

    Parameters
    ----------
    made : Surface
        The membrane pressed at the apex.
    untouched : Surface
        The undeformed membrane on the grid that is asked for.
    elastomer, turn, press : Elastomer, Turn, Press
        The dome, where it is pressed, and the press.

    Raises
    ------
    ValueError
        If the membrane gets so steep against the axis that heights over (x, y) cannot express it.
    """
    pressed = _Pressed(made, elastomer, turn)
    pressed.require_upright(press)
    x, y = np.meshgrid(untouched.x_mm, untouched.y_mm)
    start = turn.back(np.stack([x, y, untouched.base_mm], axis=-1))
    rise, up = pressed.most_rise_mm, turn.matrix[2]
    near = pressed.on_sphere(start, pressed.extent_mm + max(rise) * math.hypot(up[0], up[1]))
    found = elementwise.find_root(
        pressed.over, (np.full(int(near.sum()), -rise[0]), rise[1]), args=tuple(start[near].T),
        tolerances={"xatol": EXACT_MM},
    )  # fmt: skip
    height = np.zeros_like(untouched.base_mm)
    height[near] = np.where(found.success, found.x, 0.0)
    end = start + height[..., None] * up
    contact = pressed.sample(made.contact.astype(float), end, order=1) > 0.5
    return replace(
        made,
        x_mm=untouched.x_mm,
        y_mm=untouched.y_mm,
        height_mm=height,
        base_mm=untouched.base_mm,
        base_p=untouched.base_p,
        base_q=untouched.base_q,
        contact=contact & near,
        moved=partial(pressed.sideways, start, near),
    )


class _Pressed:
    """A membrane pressed at the apex, as a function of points in the turned frame."""

    def __init__(self, made: Surface, elastomer: Elastomer, turn: Turn) -> None:
        self.made, self.elastomer, self.turn = made, elastomer, turn
        self.smooth = spline_filter(made.height_mm, order=3)

    @cached_property
    def extent_mm(self) -> float:
        """Distance from the place within which the membrane has moved."""
        rows, columns = np.nonzero(np.abs(self.made.height_mm) > ROUNDING_MM)
        return float(np.hypot(self.made.x_mm[columns], self.made.y_mm[rows]).max(initial=0.0)) + SPARE_MM

    @cached_property
    def most_rise_mm(self) -> tuple[float, float]:
        """How far a point of the membrane may lie below and above where it was, along z (mm)."""
        steepest = math.cos(math.radians(STEEPEST_DEG))
        low, high = float(self.made.height_mm.min()), float(self.made.height_mm.max())
        return (SPARE_MM - min(low, 0.0)) / steepest, (SPARE_MM + high) / steepest

    def on_sphere(self, points: Array, within_mm: float) -> Mask:
        """Which points of the sphere lie so near to the place that the press may move them."""
        assert self.elastomer.radius_mm is not None
        furthest = self.elastomer.radius_mm * (1 - math.cos(math.radians(FURTHEST_DEG)))
        with np.errstate(invalid="ignore"):  # no number where there is no membrane
            near = np.hypot(points[..., 0], points[..., 1]) < within_mm
            return np.asarray(near & (points[..., 2] < furthest))

    def over(self, rise: Array, u: Array, v: Array, w: Array) -> Array:
        """How far points, risen along z of the sensor, lie over the pressed membrane (mm)."""
        up = self.turn.matrix[2]
        points = np.stack([u + rise * up[0], v + rise * up[1], w + rise * up[2]], axis=-1)
        return np.asarray(points[..., 2] - self._base(points) - self.sample(self.smooth, points))

    def sample(self, field: Array, points: Array, *, order: int = 3) -> Array:
        """A field of the pressed membrane, splines as coefficients, zero beyond its grid."""
        made = self.made
        places = (made.y_mm[0] - points[..., 1], points[..., 0] - made.x_mm[0])
        rows, columns = (np.nan_to_num(place / made.pitch_mm, nan=-1e3) for place in places)
        return np.asarray(
            map_coordinates(field, [rows, columns], order=order, mode="constant", prefilter=False)
        )

    def _base(self, points: Array) -> Array:
        """The sphere; beyond its steepest part, which nothing moves, straight on."""
        radius = self.elastomer.radius_mm
        assert radius is not None
        edge = radius * math.sin(math.radians(STEEPEST_DEG))
        r = np.hypot(points[..., 0], points[..., 1])
        held = np.minimum(r, edge)
        height = held**2 / (radius + np.sqrt(radius**2 - held**2))
        return np.asarray(height + math.tan(math.radians(STEEPEST_DEG)) * (r - held))

    def require_upright(self, press: Press) -> None:
        """Raise `ValueError` where the membrane that has moved is too steep against the axis."""
        p, q = self.made.gradient
        upright = np.stack([-p, -q, np.ones_like(p)], axis=-1) @ self.turn.matrix[2]
        upright = upright / np.sqrt(1 + p**2 + q**2)
        touched = np.abs(self.made.height_mm) > ROUNDING_MM + 0.01 * float(self.made.height_mm.max())
        steepest = math.degrees(math.acos(float(np.clip(upright[touched].min(), -1.0, 1.0))))
        if steepest > STEEPEST_DEG:
            x, y = press.centre_mm
            raise ValueError(
                f"press.centre_mm: {named(press)} at ({x:g}, {y:g}) mm makes the membrane {steepest:.3g} deg "
                f"steep against the axis; heights over (x, y) express {STEEPEST_DEG:g} deg or less. Press "
                "less deep or nearer to the apex, a rounder probe, or along the axis"
            )

    def sideways(self, start: Array, near: Mask) -> tuple[Array, Array]:
        """How far the skin moved along x and y of the sensor (mm)."""
        along = [spline_filter(field, order=3) for field in self.made.sideways_mm]
        moved = np.stack([self.sample(field, start) for field in (*along, self.smooth)], axis=-1)
        moved = np.where(near[..., None], moved, 0.0) @ self.turn.matrix.T
        return moved[..., 0], moved[..., 1]
