"""What the pixels of a ball's picture see: the ball, and the gel around it, on a plane or on a dome."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.balls import BallPress, slopes_on_ball
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.setup import Setup

CURVATURE_DIGITS = 3  # of 1/mm, so that balls on a dome share what is computed of their surfaces
USUAL_THICKNESS = 1.5  # radii of the ball
_ROUNDS = 6  # each leaves an eighth of the error, on a dome of 35 mm seen from 41 mm


class BallView(NamedTuple):
    """What each pixel sees of a ball and of the gel that it presses.

    Attributes
    ----------
    x_px, y_px : array, shape (rows, columns)
        How far to the right of the ball's axis, and above it, the point lies that a pixel sees.
    foot_x_px, foot_y_px : array, same shape
        How far to the right and up the foot of that point lies from the middle of the contact, on the plane
        that touches the undeformed membrane there.
    slope : pair of float
        Slopes of that plane.
    ball_radius_px, mm_per_px, contact_mm : float
        Radius of the ball, size of a pixel, and contact radius.
    surface : BallSurface
        The gel under the ball.
    """

    x_px: Array
    y_px: Array
    foot_x_px: Array
    foot_y_px: Array
    slope: tuple[float, float]
    ball_radius_px: float
    mm_per_px: float
    contact_mm: float
    surface: BallSurface

    @property
    def r_px(self) -> Array:
        """Distance from the middle of the contact, along the plane."""
        return np.asarray(np.sqrt(self.foot_x_px**2 + self.foot_y_px**2 + self._rise_px**2))

    @property
    def ball_slopes(self) -> tuple[Array, Array]:
        """Slopes p, q of the ball."""
        return slopes_on_ball(self.x_px, self.y_px, ball_radius_px=self.ball_radius_px)

    def part(self, box: tuple[slice, slice]) -> "BallView":
        """What the pixels of a part of the picture see."""
        fields = ("x_px", "y_px", "foot_x_px", "foot_y_px")
        return self._replace(**{name: getattr(self, name)[box] for name in fields})

    def gel_slopes(self, *, coated: bool = True) -> tuple[Array, Array]:
        """Slopes p, q of the indentation, inside the contact and around it; of the bare gel on demand.

        The gel is a surface of revolution about the membrane's normal where the ball touched first.
        """
        surface = self.surface if coated else replace(self.surface, skin_mm=0.0)
        r_mm = self.mm_per_px * self.r_px
        base = surface.bulge_per_mm * r_mm
        pressed = self._turned(base + surface.slope(r_mm, self.contact_mm))
        p, q = (own - rest for own, rest in zip(pressed, self._turned(base), strict=True))
        return np.asarray(p), np.asarray(q)

    def pressed_slopes(self, base: tuple[Array | float, Array | float]) -> tuple[Array, Array]:
        """Slopes p, q of the indentation: the ball's over those of the base where it touches, gel around.

        A coating rounds both. The gel takes the curvature that its base has in the middle of the contact.
        """
        touched = self.r_px * self.mm_per_px < self.contact_mm
        bare = self.gel_slopes(coated=False)
        coated = self.gel_slopes() if self.surface.skin_mm else bare
        p, q = (
            np.where(touched, ball - rest, gel) + (rounded - gel)
            for ball, rest, gel, rounded in zip(self.ball_slopes, base, bare, coated, strict=True)
        )
        return p, q

    @property
    def coating_mm(self) -> Array:
        """How much higher the gel stands than without its coating; lower where that rounds a crest."""
        bare, r_mm = replace(self.surface, skin_mm=0.0), self.mm_per_px * self.r_px
        with_it, without = (each.height_of(self.contact_mm)(r_mm) for each in (self.surface, bare))
        return np.asarray(with_it - without)

    @property
    def _rise_px(self) -> Array:
        return np.asarray(self.slope[0] * self.foot_x_px + self.slope[1] * self.foot_y_px)

    def _turned(self, radial: Array) -> tuple[Array, Array]:
        """Slopes p, q in the sensor's frame of what rises radially over the plane."""
        length = math.sqrt(1 + self.slope[0] ** 2 + self.slope[1] ** 2)
        # the plane's normal, tilted against the way from the middle
        tilt = radial / np.maximum(self.r_px, 1e-9)
        up = 1 / length - tilt * self._rise_px
        p, q = (
            (slope / length + tilt * foot) / up
            for slope, foot in zip(self.slope, (self.foot_x_px, self.foot_y_px), strict=True)
        )
        return p, q


def touched_px(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> tuple[float, float]:
    """Column and row at the middle of a ball's contact: its axis, on a plane membrane.

    It lies below the ball's centre along the membrane's normal, nearer to the axis the deeper the ball is in.
    """
    if membrane is None:
        return ball.centre_px
    contact_mm = setup.contact_radius_px(ball) * setup.mm_per_px
    depth_mm = ball_surface(ball, setup, membrane).depth_mm(contact_mm)
    return membrane.touched_from(ball.centre_px, setup.radius_px(ball) - depth_mm / setup.mm_per_px)


def ball_surface(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> BallSurface:
    """Surface of the gel under a ball; of one of usual thickness where that is not known yet."""
    radius_mm, bulge = setup.radius_mm(ball), 0.0
    if membrane is not None:
        first = membrane.touched_from(ball.centre_px, setup.radius_px(ball))
        bulge = round(membrane.curvature_at(first), CURVATURE_DIGITS)
    thickness_mm = setup.thickness_mm or USUAL_THICKNESS * radius_mm
    return BallSurface(radius_mm, thickness_mm, setup.poisson, bulge, setup.skin_mm)


def ball_view(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> BallView:
    """What the pixels of a ball's picture see.

    A camera looks aslant beside its axis: gel that a ball has lifted is seen where other gel was. On a dome
    the gel is lifted along the membrane's normal, and so aside.

    Parameters
    ----------
    ball, setup, membrane
        See `lab.calibrate`; the plane membrane of a camera far away when absent.
    """
    surface, pitch_mm = ball_surface(ball, setup, membrane), setup.mm_per_px
    contact_mm = setup.contact_radius_px(ball) * pitch_mm
    middle = touched_px(ball, setup, membrane)
    rows, columns = np.indices(np.asarray(ball.image).shape[:2])
    x_px, y_px = np.asarray(columns - middle[0]), np.asarray(middle[1] - rows)
    given = setup.radius_px(ball), pitch_mm, contact_mm, surface
    if membrane is None:
        return BallView(x_px, y_px, x_px, y_px, (0.0, 0.0), *given)
    slope = membrane.slope_at(middle)
    rest_px = (membrane.height_mm - membrane.height_at(middle)) / pitch_mm
    height_mm = surface.height_of(contact_mm)
    seen_x, seen_y, foot_x, foot_y = x_px, y_px, x_px, y_px
    for _ in range(_ROUNDS):
        rise_px = slope[0] * foot_x + slope[1] * foot_y
        r_mm = pitch_mm * np.sqrt(foot_x**2 + foot_y**2 + rise_px**2)
        over_mm = surface.bulge_per_mm * r_mm**2 / 2 + height_mm(r_mm)
        # along the plane's normal, whose part along z this is
        over_px = over_mm / pitch_mm / math.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
        lifted_px = rise_px + over_px - rest_px
        seen_x, seen_y = x_px + membrane.sight_x * lifted_px, y_px + membrane.sight_y * lifted_px
        foot_x, foot_y = seen_x + slope[0] * over_px, seen_y + slope[1] * over_px
    axis_x, axis_y = middle[0] - ball.centre_px[0], ball.centre_px[1] - middle[1]
    return BallView(seen_x + axis_x, seen_y + axis_y, foot_x, foot_y, slope, *given)
