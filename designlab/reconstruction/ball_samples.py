"""What ball presses teach: samples of colour change, place and slope."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array, Mask
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.balls import BallPress, slopes_on_ball
from designlab.reconstruction.gel_fit import GelFit, ball_slopes, fit_gel
from designlab.reconstruction.height import Boundary, normals
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import Samples
from designlab.reconstruction.pictures import (
    colour_change,
    level_of,
    noise_share,
    smoothed,
    smoothing_for,
    thinned,
)

_FLAT_PIXELS, _AROUND_PIXELS = 500, 2000
# Share of the circle that teaches the rim; beyond it a circle read off too large would teach bare membrane.
_RIM = 0.95
CURVATURE_DIGITS = 3  # of 1/mm, so that balls on a dome share what is computed of their surfaces
USUAL_THICKNESS = 1.5  # radii of the ball
LIFTED_ROUNDS = 3
_STEEPEST = 0.9  # contact radius over the ball's: no camera sees gel of 64 deg


class Setup(NamedTuple):
    """What is fixed by the lab and the physics, not by fitting.

    Attributes
    ----------
    ball_radius_mm, mm_per_px : float
        Ball, of those that state no radius of their own, and scale of the pictures at the membrane.
    detail : float
        Height finer than this share of the balls' mean contact radius (the standard deviation of a Gaussian)
        is taken from a second map, which is taught almost the whole contact circle; 0 does without. See
        `LabCalibration`.
    flat_beyond : float
        From this many contact radii on the membrane counts as flat.
    smoothing_px : float
        Gaussian smoothing of the colour change, against grain and the blocks of compressed video.
    boundary : str
        Of the integration, see `integrate`.
    thickness_mm : float, optional
        Thickness of the gel. What is absent is fitted to the balls, see `known_gel`.
    label_bias : float, optional
        By how much more than the contact the circles measure that were read off, as a share of it.
    poisson : float
        Poisson's ratio of the gel; silicones have little less than 0.5.
    weighted : bool
        Weigh each pixel in the integration by the inverse of its expected error, which is learned from balls
        left out of the calibration.
    skin_mm : float
        How far the coating rounds what the gel is pressed to (standard deviation of a Gaussian).
    relative_to : str
        What changes of colour are shares of: the ``mean`` of the untouched gel, or the untouched gel at the
        same ``place``, which is noisier in dark corners and takes off what uneven light does to all slopes.
    """

    ball_radius_mm: float
    mm_per_px: float
    detail: float = 0.5
    flat_beyond: float = 2.5
    smoothing_px: float = 2.0
    boundary: Boundary = "dirichlet"
    weighted: bool = True
    thickness_mm: float | None = None
    label_bias: float | None = None
    poisson: float = 0.49
    skin_mm: float = 0.0
    relative_to: Literal["mean", "place"] = "mean"

    @property
    def rounding_px(self) -> float:
        """By how much the slopes that colours show are smoothed: by the coating, then with the colours."""
        return math.hypot(self.smoothing_px, self.skin_mm / self.mm_per_px)

    def radius_mm(self, ball: BallPress) -> float:
        """Radius of a ball."""
        return self.ball_radius_mm if ball.radius_mm is None else ball.radius_mm

    def radius_px(self, ball: BallPress) -> float:
        """Radius of a ball in pixels."""
        return self.radius_mm(ball) / self.mm_per_px

    def contact_radius_px(self, ball: BallPress) -> float:
        """Radius within which the gel touches the ball: of the circle read off, less its bias."""
        return ball.contact_radius_px / (1 + (self.label_bias or 0.0))


def ball_samples(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, membrane: Membrane | None
) -> tuple[Array, Array, list[list[Samples]]]:
    """Samples of each ball, for each map that `lab.LabCalibration` needs.

    Parameters
    ----------
    balls, background, setup, membrane
        See `lab.calibrate`.

    Returns
    -------
    background : array, shape (rows, columns, channels)
        The untouched gel, checked.
    spread : array, shape (channels,)
        Root mean square colour change over the contacts: the unit of colour.
    parts : list of list of Samples
        Samples of each ball: the surface of the gel inside and around the contact, then, unless
        `setup.detail` is 0, the ball to almost all of the circle read off.

    Raises
    ------
    ValueError
        If there are fewer than two balls, shapes differ, or nothing changes colour.
    """
    background, spread, changes = _changes(balls, background, setup, membrane)
    position = positions(background.shape)

    def samples(ball: BallPress, change: Array, rim: bool) -> Samples:
        p, q, r_px = ball_truth(ball, setup, membrane)
        u = (r_px / ball.contact_radius_px).ravel()
        if membrane is not None:
            p, q = p - membrane.p, q - membrane.q
            u[~membrane.seen.ravel()] = np.nan
        if not rim:
            touched = r_px < setup.contact_radius_px(ball)
            around = gel_slopes(ball, setup, membrane)
            p, q = (np.where(touched, own, gel) for own, gel in zip((p, q), around, strict=True))
            if setup.rounding_px:
                p, q = (gaussian_filter(slope, setup.rounding_px) for slope in (p, q))
        contact = np.flatnonzero(u < (_RIM if rim else 1.0))
        beyond = np.flatnonzero((u >= 1.0) & (u <= setup.flat_beyond))
        around_px = thinned(beyond, 0 if rim else _AROUND_PIXELS)
        flat = thinned(np.flatnonzero(u > setup.flat_beyond), _FLAT_PIXELS)
        slope = -normals(p, q)[..., :2].reshape(-1, 2)
        pixels = np.concatenate([contact, around_px, flat])
        return Samples(
            change.reshape(-1, change.shape[-1])[pixels] / spread,
            position[pixels],
            np.concatenate(
                [slope[contact], slope[around_px], np.zeros((flat.size, 2)) if rim else slope[flat]]
            ),
            # every press counts alike, whatever its size
            np.concatenate(
                [
                    np.full(contact.size, 3 * _FLAT_PIXELS / contact.size),
                    np.full(around_px.size, 1.5 * _FLAT_PIXELS / max(around_px.size, 1)),
                    np.ones(flat.size),
                ]
            ),
        )

    parts = [
        [samples(ball, change, rim) for ball, change in zip(balls, changes, strict=True)]
        for rim in ((False, True) if setup.detail > 0 else (False,))
    ]
    return background, spread, parts


def shape_samples(
    images: Sequence[Array],
    background: Array,
    slopes: Sequence[tuple[Array, Array]],
    regions: Sequence[Mask],
    setup: Setup,
) -> tuple[Array, list[Samples]]:
    """Samples of presses whose slopes are known at every pixel. Parameters as `lab.calibrate_on_shapes`.

    Returns
    -------
    spread : array, shape (channels,)
        Root mean square colour change over the regions: the unit of colour.
    presses : list of Samples
        Samples of each press.
    """
    changes = [relative_change(image, background, setup) for image in images]
    inside = np.concatenate([change[region] for change, region in zip(changes, regions, strict=True)])
    spread = np.sqrt((inside**2).mean(axis=0))
    if not (spread > 0).all():
        raise ValueError("images: each channel must change colour in the regions")
    position = positions(background.shape)
    presses = []
    for change, (p, q), region in zip(changes, slopes, regions, strict=True):
        # colours are smoothed, and follow the slopes so
        p, q = (gaussian_filter(slope, setup.smoothing_px) for slope in (p, q))
        own, rest = np.flatnonzero(region), np.flatnonzero(~region)
        flat = thinned(rest, _FLAT_PIXELS)
        pixels = np.concatenate([own, flat])
        presses.append(
            Samples(
                change.reshape(-1, change.shape[-1])[pixels] / spread,
                position[pixels],
                -normals(p, q)[..., :2].reshape(-1, 2)[pixels],
                # every press counts alike, whatever its size
                np.concatenate([np.full(own.size, 4.5 * _FLAT_PIXELS / own.size), np.ones(flat.size)]),
            )
        )
    return spread, presses


class KnownGel(NamedTuple):
    """Balls on a gel whose thickness is known.

    Attributes
    ----------
    balls : list of BallPress
        The balls; if something was fitted, their circles have the common bias alone and no scatter.
    setup : Setup
        The setup with thickness and bias stated.
    fit : GelFit, optional
        The fit with its intervals; None where both were stated.
    """

    balls: list[BallPress]
    setup: Setup
    fit: GelFit | None


def known_gel(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, membrane: Membrane | None = None
) -> KnownGel:
    """Fit what is not stated of thickness and bias to the balls, see `gel_fit.fit_gel`.

    Parameters
    ----------
    balls, background, setup, membrane
        See `lab.calibrate`; centres are best refined before.

    Raises
    ------
    ValueError
        If a value of the setup is out of bounds, a circle is too large for the ball, or balls are too few.
    """
    _check(setup)
    if setup.thickness_mm is not None and setup.label_bias is not None:
        return KnownGel(list(balls), setup, None)
    _, spread, changes = _changes(balls, background, setup, membrane)
    fit = fit_gel(
        balls,
        [change / spread for change in changes],
        [_about_contact(ball, setup, membrane)[:2] for ball in balls],
        ball_radii_mm=[relative_radius_mm(ball, setup, membrane) for ball in balls],
        mm_per_px=setup.mm_per_px,
        smoothing_px=setup.rounding_px,
        reach=setup.flat_beyond,
        poisson=setup.poisson,
        thickness_mm=setup.thickness_mm,
        label_bias=setup.label_bias,
    )
    bias = fit.label_bias.value if setup.label_bias is None else setup.label_bias
    circles = [
        replace(ball, contact_radius_px=radius * (1 + bias))
        for ball, radius in zip(balls, fit.contact_radii_px.tolist(), strict=True)
    ]
    known = setup._replace(thickness_mm=fit.thickness_mm.value, label_bias=bias)
    return KnownGel(circles, known, fit)


def _changes(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, membrane: Membrane | None
) -> tuple[Array, Array, list[Array]]:
    """Checked background, spread of colour over the circles, and change of colour of each ball."""
    background = np.asarray(background, dtype=float)
    if background.ndim != 3 or (background.mean(axis=(0, 1)) <= 0).any():
        raise ValueError("background: must have shape (rows, columns, channels) and light in each channel")
    if len(balls) < 2:
        raise ValueError(f"balls: at least 2 are needed, got {len(balls)}")
    changes, inside = [], []
    for number, ball in enumerate(balls):
        image = np.asarray(ball.image, dtype=float)
        if image.shape != background.shape or not np.isfinite(image).all():
            raise ValueError(
                f"balls[{number}].image: must be finite of shape {background.shape}, got {image.shape}"
            )
        changes.append(relative_change(image, background, setup))
        most = _STEEPEST * setup.radius_px(ball)
        if not 0 < setup.contact_radius_px(ball) < most:
            raise ValueError(
                f"balls[{number}].contact_radius_px: must be above 0 and below {_STEEPEST:g} of the ball's "
                f"radius, {most * (1 + (setup.label_bias or 0.0)):.4g} px, got {ball.contact_radius_px:g}"
            )
        circle = ball_truth(ball, setup, membrane)[2] < ball.contact_radius_px
        if not circle.any():
            raise ValueError(f"balls[{number}].centre_px: the contact lies outside the picture")
        inside.append(changes[-1][circle])
    spread = np.sqrt((np.concatenate(inside) ** 2).mean(axis=0))
    if not (spread > 0).all():
        raise ValueError("balls: each channel must change colour in the contacts")
    return background, spread, changes


def _check(setup: Setup) -> None:
    """Refuse lengths, bias and Poisson's ratio that no gel has, by name."""
    for name in ("ball_radius_mm", "mm_per_px", "thickness_mm"):
        value = getattr(setup, name)
        if value is not None and not 0 < value < math.inf:
            raise ValueError(f"{name}: must be above 0 mm and finite, got {value:g}")
    if setup.label_bias is not None and not -0.5 < setup.label_bias < 1:
        raise ValueError(f"label_bias: must lie between -0.5 and 1, got {setup.label_bias:g}")
    if not 0 < setup.poisson <= 0.5:
        raise ValueError(f"poisson: must lie above 0 and be at most 0.5, got {setup.poisson:g}")


def touched_px(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> tuple[float, float]:
    """Column and row at the middle of a ball's contact: its axis, on a plane membrane.

    It lies below the ball's centre along the membrane's normal, nearer to the axis the deeper the ball is in.
    """
    if membrane is None:
        return ball.centre_px
    contact_mm = setup.contact_radius_px(ball) * setup.mm_per_px
    depth_mm = ball_surface(ball, setup, membrane).depth_mm(contact_mm)
    return membrane.touched_from(ball.centre_px, setup.radius_px(ball) - depth_mm / setup.mm_per_px)


def relative_radius_mm(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> float:
    """Radius of a ball on a plane that is pressed as the membrane is: their curvatures add up."""
    if membrane is None:
        return setup.radius_mm(ball)
    first = membrane.touched_from(ball.centre_px, setup.radius_px(ball))
    bent = membrane.curvature_at(first)
    return 1 / (1 / setup.radius_mm(ball) + round(bent, CURVATURE_DIGITS))


def ball_surface(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> BallSurface:
    """Surface of the gel under a ball; of one of usual thickness where that is not known yet."""
    radius_mm = relative_radius_mm(ball, setup, membrane)
    return BallSurface(radius_mm, setup.thickness_mm or USUAL_THICKNESS * radius_mm, setup.poisson)


def gel_slopes(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> tuple[Array, Array]:
    """Slopes p, q of the indentation at the pixels of a ball's picture, inside its contact and around it."""
    x_px, y_px, slope = _about_contact(ball, setup, membrane)
    surface, pitch_mm = ball_surface(ball, setup, membrane), setup.mm_per_px
    contact_mm = setup.contact_radius_px(ball) * pitch_mm
    if slope == (0.0, 0.0):
        return ball_slopes(surface, x_px * pitch_mm, y_px * pitch_mm, contact_mm)
    # the gel moves along the normal of the membrane, and distances run along the membrane
    rise = slope[0] * x_px + slope[1] * y_px
    r_mm = pitch_mm * np.sqrt(x_px**2 + y_px**2 + rise**2)
    steep = pitch_mm * math.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    ratio = steep * surface.slope(r_mm, contact_mm) / np.maximum(r_mm, 1e-9)
    return np.asarray(ratio * (x_px + slope[0] * rise)), np.asarray(ratio * (y_px + slope[1] * rise))


def ball_truth(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> tuple[Array, Array, Array]:
    """Slopes p, q of a ball at the pixels of its picture, and distances from its contact's middle (px)."""
    p, q = slopes_on_ball(*axis_places(ball, setup, membrane), ball_radius_px=setup.radius_px(ball))
    x_px, y_px, slope = _about_contact(ball, setup, membrane)
    return p, q, np.sqrt(x_px**2 + y_px**2 + (slope[0] * x_px + slope[1] * y_px) ** 2)


def axis_places(ball: BallPress, setup: Setup, membrane: Membrane | None = None) -> tuple[Array, Array]:
    """Places that the pixels see, to the right of and above the axis of a ball (px)."""
    x_px, y_px, _ = _about_contact(ball, setup, membrane)
    middle = touched_px(ball, setup, membrane)
    return x_px + (middle[0] - ball.centre_px[0]), y_px + (ball.centre_px[1] - middle[1])


def _about_contact(
    ball: BallPress, setup: Setup, membrane: Membrane | None
) -> tuple[Array, Array, tuple[float, float]]:
    """Places that the pixels see from a contact's middle, to the right and up (px), and the slope there.

    A camera looks aslant beside its axis: gel that a ball has lifted is seen where other gel was.
    """
    middle = touched_px(ball, setup, membrane)
    rows, columns = np.indices(np.asarray(ball.image).shape[:2])
    at_rest = np.asarray(columns - middle[0]), np.asarray(middle[1] - rows)
    if membrane is None:
        return *at_rest, (0.0, 0.0)
    slope, surface = membrane.slope_at(middle), ball_surface(ball, setup, membrane)
    contact_mm, (x_px, y_px) = setup.contact_radius_px(ball) * setup.mm_per_px, at_rest
    for _ in range(LIFTED_ROUNDS):
        r_px = np.sqrt(x_px**2 + y_px**2 + (slope[0] * x_px + slope[1] * y_px) ** 2)
        lifted_px = surface.height_mm(r_px * setup.mm_per_px, contact_mm) / setup.mm_per_px
        x_px, y_px = at_rest[0] + membrane.sight_x * lifted_px, at_rest[1] + membrane.sight_y * lifted_px
    return x_px, y_px, slope


def relative_change(image: Array, background: Array, setup: Setup, mask: Mask | None = None) -> Array:
    """Smoothed change of colour relative to the untouched gel, see `Setup.relative_to`."""
    level = level_of(background) if setup.relative_to == "place" else background.mean(axis=(0, 1))
    return smoothed((image - background) / level, setup.smoothing_px, mask)


def smoothing_by(balls: Sequence[BallPress], background: Array) -> float:
    """Smoothing (px) by the noise of ball presses: what differs from pixel to pixel."""
    shares = []
    for ball in balls:
        change = colour_change(np.asarray(ball.image, dtype=float), background)
        # of second differences nothing smooth is left
        rough = (change[:, 2:] - 2 * change[:, 1:-1] + change[:, :-2]) / math.sqrt(6)
        rows, columns = np.indices(change.shape[:2])
        away = np.hypot(columns - ball.centre_px[0], rows - ball.centre_px[1])
        shares.append(noise_share(rough, change, away < ball.contact_radius_px))
    return smoothing_for(shares)


def positions(shape: tuple[int, ...]) -> Array:
    """Positions of the pixels, -1..1 across the picture, shape (rows * columns, 2)."""
    y, x = np.meshgrid(np.linspace(1, -1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)
