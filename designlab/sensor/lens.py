"""Lens models: from directions to places in the picture and back, in units of the focal length.

Both models are those of OpenCV's calibration (`cv2.projectPoints`, `cv2.fisheye.projectPoints`), so
calibrated coefficients can be used as they are: x points right and y down in the picture.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from designlab.core.types import Array
from geometries.spec import Spec, quantity

TOLERANCE = 1e-13  # focal lengths; a thousandth of a millionth of a pixel

NEGLIGIBLE = 1e-50  # coefficient that no picture shows, but that overflows where it is divided by


class Distortion(Spec):
    """Distortion coefficients of OpenCV; all zero is a lens without distortion."""

    k1: float = quantity(0.0, unit="1", ge=-100, le=100, description="Radial, second order (both lenses).")
    k2: float = quantity(0.0, unit="1", ge=-100, le=100, description="Radial, fourth order (both lenses).")
    k3: float = quantity(0.0, unit="1", ge=-100, le=100, description="Radial, sixth order (both lenses).")
    k4: float = quantity(0.0, unit="1", ge=-100, le=100, description="Radial, eighth order (fisheye only).")
    p1: float = quantity(0.0, unit="1", ge=-1, le=1, description="Tangential, along y (pinhole only).")
    p2: float = quantity(0.0, unit="1", ge=-1, le=1, description="Tangential, along x (pinhole only).")


class Lens(Protocol):
    """A lens of unit focal length."""

    @property
    def furthest(self) -> float:
        """Distance from the centre of the picture up to which the lens can be inverted."""

    def image(self, x: Array, y: Array, forward: Array) -> tuple[Array, Array]:
        """Place in the picture of directions with components right, down and forward."""

    def direction(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Components right, down and forward of the directions seen at places in the picture.

        Raises
        ------
        ValueError
            If the lens shows no direction there, or more than one.
        """


@dataclass(frozen=True)
class Pinhole:
    """Perspective projection with Brown-Conrady distortion.

    x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), y' alike with p1 and p2 exchanged
    (Brown, Photogrammetric Engineering 37, 1971; OpenCV, "Camera Calibration and 3D Reconstruction").
    Beyond the radius where the polynomial turns back, the picture is continued outward in proportion, so
    that nothing far outside the picture falls into it.
    """

    distortion: Distortion

    @property
    def _radial(self) -> tuple[float, ...]:
        return self.distortion.k1, self.distortion.k2, self.distortion.k3

    @property
    def furthest(self) -> float:
        """Distance from the centre of the picture up to which the lens can be inverted."""
        return float(_odd(_turn(self._radial), self._radial))

    def image(self, x: Array, y: Array, forward: Array) -> tuple[Array, Array]:
        """Place in the picture of directions with components right, down and forward."""
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = x / forward, y / forward
        behind = forward <= 0
        if self.distortion == Distortion():
            return np.where(behind, np.nan, x), np.where(behind, np.nan, y)
        radius, turn = np.hypot(x, y), _turn(self._radial)
        share = np.minimum(1.0, turn / np.maximum(radius, 1e-300))
        seen_x, seen_y = self._distorted(x * share, y * share)
        beyond = np.maximum(radius - turn, 0.0) / np.maximum(radius, 1e-300)
        return (
            np.where(behind, np.nan, seen_x + beyond * x),
            np.where(behind, np.nan, seen_y + beyond * y),
        )

    def _distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        p1, p2 = self.distortion.p1, self.distortion.p2
        square = x**2 + y**2
        radial = _even(square, self._radial)
        return (
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2),
            y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y,
        )

    def direction(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Components right, down and forward (always 1) of the directions seen at places in the picture.

        Raises
        ------
        ValueError
            If the lens shows no direction there, or more than one.
        """
        forward = np.ones_like(x)
        if self.distortion == Distortion():
            return x, y, forward
        distance = np.hypot(x, y)
        share = _inverse(distance, self._radial) / np.where(distance > 0, distance, 1.0)
        right, down = x * share, y * share
        if self.distortion.p1 == 0 and self.distortion.p2 == 0:
            return right, down, forward
        right, down = self._newton(x, y, right, down)
        return right, down, forward

    def _newton(self, x: Array, y: Array, right: Array, down: Array) -> tuple[Array, Array]:
        """Newton's method in two dimensions, from the solution without tangential distortion."""
        p1, p2 = self.distortion.p1, self.distortion.p2
        for _ in range(30):
            seen_x, seen_y = self._distorted(right, down)
            off_x, off_y = seen_x - x, seen_y - y
            square = right**2 + down**2
            radial, slope = _even(square, self._radial), 2 * _even_slope(square, self._radial)
            xx = radial + slope * right**2 + 2 * p1 * down + 6 * p2 * right
            yy = radial + slope * down**2 + 6 * p1 * down + 2 * p2 * right
            xy = slope * right * down + 2 * p1 * right + 2 * p2 * down
            area = xx * yy - xy**2
            # A negative area means that the picture is folded over: another direction is seen there too.
            if not (area > 0).all():
                raise ValueError("the tangential distortion folds the picture over")
            if max(np.abs(off_x).max(initial=0.0), np.abs(off_y).max(initial=0.0)) < TOLERANCE:
                return right, down
            right = right - (yy * off_x - xy * off_y) / area
            down = down - (xx * off_y - xy * off_x) / area
        raise ValueError("the tangential distortion cannot be inverted")


@dataclass(frozen=True)
class Fisheye:
    """Equidistant projection with Kannala-Brandt distortion.

    A direction at angle t to the axis appears at t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8) from the centre
    (Kannala, Brandt, IEEE TPAMI 28, 2006; OpenCV, "Fisheye camera model").
    """

    distortion: Distortion

    @property
    def _radial(self) -> tuple[float, ...]:
        k = self.distortion
        return k.k1, k.k2, k.k3, k.k4

    @property
    def _widest(self) -> float:
        return min(_turn(self._radial), np.pi)

    @property
    def furthest(self) -> float:
        """Distance from the centre of the picture up to which the lens can be inverted."""
        return float(_odd(self._widest, self._radial))

    def distance(self, angle: float) -> float:
        """Distance from the centre of the picture of a direction at an angle (radians) to the axis.

        Raises
        ------
        ValueError
            If the lens cannot be inverted up to that angle.
        """
        if angle >= self._widest:
            raise ValueError(
                f"the radial distortion turns back at {np.degrees(self._widest):.4g} deg from the axis, the "
                f"edge of the picture lies at {np.degrees(angle):.4g} deg"
            )
        return float(_odd(angle, self._radial))

    def image(self, x: Array, y: Array, forward: Array) -> tuple[Array, Array]:
        """Place in the picture of directions with components right, down and forward."""
        sideways = np.hypot(x, y)
        angle = np.arctan2(sideways, forward)
        inside = np.minimum(angle, self._widest)
        distance = _odd(inside, self._radial) + (angle - inside)
        on_axis = sideways == 0
        share = np.where(on_axis, 0.0, distance / np.where(on_axis, 1.0, sideways))
        return x * share, y * share

    def direction(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Components right, down and forward of the unit directions seen at places in the picture.

        Raises
        ------
        ValueError
            If the lens shows no direction there, or more than one.
        """
        distance = np.hypot(x, y)
        angle = _inverse(distance, self._radial)
        if (angle >= np.pi).any():
            raise ValueError("the picture reaches 180 deg from the axis")
        share = np.where(distance > 0, np.sin(angle) / np.where(distance > 0, distance, 1.0), 1.0)
        return x * share, y * share, np.cos(angle)


def _even(square: Array, coefficients: Sequence[float]) -> Array:
    """1 + c1 s + c2 s^2 + ... of s, the square of a radius."""
    return np.asarray(np.polynomial.polynomial.polyval(square, (1.0, *coefficients)), dtype=float)


def _even_slope(square: Array, coefficients: Sequence[float]) -> Array:
    """Derivative of `_even` by its argument."""
    slopes = [(k + 1) * c for k, c in enumerate(coefficients)]
    return np.asarray(np.polynomial.polynomial.polyval(square, slopes), dtype=float)


def _odd(radius: Array | float, coefficients: Sequence[float]) -> Array:
    """R (1 + c1 r^2 + c2 r^4 + ...)."""
    if np.isinf(radius).all():
        return np.asarray(np.inf)
    radius = np.asarray(radius, dtype=float)
    return np.asarray(radius * _even(radius**2, coefficients))


def _odd_slopes(coefficients: Sequence[float]) -> tuple[float, ...]:
    """Coefficients of the derivative of `_odd`, as a polynomial of the squared radius without its 1."""
    return tuple((2 * k + 3) * c for k, c in enumerate(coefficients))


def _turn(coefficients: Sequence[float]) -> float:
    """Smallest radius at which `_odd` stops growing; infinite where it never does."""
    slopes = [value if abs(value) > NEGLIGIBLE else 0.0 for value in _odd_slopes(coefficients)]
    roots = np.roots([*reversed(slopes), 1.0])
    real = roots.real[(np.abs(roots.imag) < 1e-9 * np.maximum(np.abs(roots), 1e-300)) & (roots.real > 0)]
    return float(np.sqrt(real.min())) if len(real) else np.inf


def _inverse(distance: Array, coefficients: Sequence[float]) -> Array:
    """Radius at which `_odd` reaches a distance: Newton's method kept inside a shrinking bracket.

    Raises
    ------
    ValueError
        If `_odd` turns back before it reaches the distance.
    """
    if not any(coefficients):
        return distance
    high = _turn(coefficients)
    furthest = float(distance.max(initial=0.0))
    if not furthest < _odd(high, coefficients):
        raise ValueError(
            f"the radial distortion turns back at {float(_odd(high, coefficients)):.4g} focal lengths from "
            f"the centre, the picture reaches {furthest:.4g}"
        )
    if np.isinf(high):
        high = 1.0
        while _odd(high, coefficients) < furthest:
            high *= 2
    low_of, high_of = np.zeros_like(distance), np.full_like(distance, high)
    radius = np.minimum(distance, high / 2)
    slopes = _odd_slopes(coefficients)
    for _ in range(100):
        error = _odd(radius, coefficients) - distance
        if np.abs(error).max(initial=0.0) < TOLERANCE * max(furthest, 1.0):
            break
        low_of, high_of = np.where(error < 0, radius, low_of), np.where(error > 0, radius, high_of)
        slope = _even(radius**2, slopes)
        step = radius - error / np.where(slope > 1e-12, slope, 1e-12)
        radius = np.where((step > low_of) & (step < high_of), step, (low_of + high_of) / 2)
    return radius
