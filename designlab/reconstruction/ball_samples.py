"""What ball presses teach: samples of colour change, place and slope."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array, Mask
from designlab.reconstruction.ball_view import ball_view
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.gel_fit import GelFit, fit_gel
from designlab.reconstruction.height import normals
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
from designlab.reconstruction.setup import Setup, require_possible

_FLAT_PIXELS, _AROUND_PIXELS = 500, 2000
# Share of the circle that teaches the rim; beyond it a circle read off too large would teach bare membrane.
_RIM = 0.95
# Radii of the circle around a ball that tell how large its contact is, where the thickness is known. Further
# out slopes are so small that colours tell as much of what the dent does to the light.
_NEAR = 1.3
_STEEPEST = 0.9  # contact radius over the ball's: no camera sees gel of 64 deg


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
    base_p, base_q = (0.0, 0.0) if membrane is None else (membrane.p, membrane.q)

    def samples(ball: BallPress, change: Array, rim: bool) -> Samples:
        view = ball_view(ball, setup, membrane)
        u = (view.r_px / ball.contact_radius_px).ravel()
        if membrane is not None:
            u[~membrane.seen.ravel()] = np.nan
        if ball.covered is not None:
            u[ball.covered.ravel()] = np.nan
        if rim:
            p, q = view.ball_slopes
            p, q = p - base_p, q - base_q
        else:
            p, q = view.pressed_slopes((base_p, base_q))
            if setup.smoothing_px:
                p, q = (gaussian_filter(slope, setup.smoothing_px) for slope in (p, q))
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
        See `lab.calibrate`; centres are best refined before. Where the thickness is stated, changes relative
        to the same place and pixels near the contacts are compared, whatever the setup says.

    Raises
    ------
    ValueError
        If a value of the setup is out of bounds, a circle is too large for the ball, or balls are too few.
    """
    require_possible(setup)
    if setup.thickness_mm is not None and setup.label_bias is not None:
        return KnownGel(list(balls), setup, None)
    reach, compared = setup.flat_beyond, setup
    if setup.thickness_mm is not None:
        # bright and dark places then tell the same of a slope
        reach, compared = min(_NEAR, setup.flat_beyond), setup._replace(relative_to="place")
    _, spread, changes = _changes(balls, background, compared, membrane)
    fit = fit_gel(
        balls,
        [change / spread for change in changes],
        [ball_view(ball, setup, membrane) for ball in balls],
        smoothing_px=setup.smoothing_px,
        reach=reach,
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
        named = f"{ball.file}: " if ball.file else f"balls[{number}]."
        if image.shape != background.shape or not np.isfinite(image).all():
            raise ValueError(f"{named}image: must be finite of shape {background.shape}, got {image.shape}")
        changes.append(relative_change(image, background, setup))
        most = _STEEPEST * setup.radius_px(ball)
        if not 0 < setup.contact_radius_px(ball) < most:
            raise ValueError(
                f"{named}contact_radius_px: must be above 0 and below {_STEEPEST:g} of the ball's "
                f"radius, {most * (1 + (setup.label_bias or 0.0)):.4g} px, got {ball.contact_radius_px:g}"
            )
        away_px = ball_view(ball, setup, membrane).r_px
        circle = away_px < ball.contact_radius_px
        shown = away_px < _RIM * ball.contact_radius_px
        if membrane is not None:
            shown &= membrane.seen
        if not shown.any():
            raise ValueError(f"{named}centre_px: the contact lies outside the picture of the gel")
        if ball.covered is not None and not (shown & ~ball.covered).any():
            raise ValueError(f"{named}centre_px: printed markers cover the whole contact")
        inside.append(changes[-1][circle if ball.covered is None else circle & ~ball.covered])
    spread = np.sqrt((np.concatenate(inside) ** 2).mean(axis=0))
    if not (spread > 0).all():
        raise ValueError("balls: each channel must change colour in the contacts")
    return background, spread, changes


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
