"""What ball presses teach: samples of colour change, place and slope."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from designlab.core.types import Array, Mask
from designlab.reconstruction.balls import BallPress, ball_gradients, smoothed
from designlab.reconstruction.height import Boundary, normals
from designlab.reconstruction.methods import Samples
from designlab.reconstruction.pictures import thinned

_FLAT_PIXELS = 500
# Share of the circle that teaches the rim; beyond it a circle read off too large would teach bare membrane.
_RIM = 0.95


class Setup(NamedTuple):
    """What is fixed by the lab and the physics, not by fitting.

    Attributes
    ----------
    ball_radius_mm, mm_per_px : float
        Ball and scale of the pictures at the membrane.
    trusted : float
        Share of the contact radius within which the membrane follows the ball. It leaves the ball before
        the circle that one sees.
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
    weighted : bool
        Weigh each pixel in the integration by the inverse of its expected error, which is learned from balls
        left out of the calibration.
    """

    ball_radius_mm: float
    mm_per_px: float
    trusted: float = 0.78
    detail: float = 0.5
    flat_beyond: float = 2.5
    smoothing_px: float = 2.0
    boundary: Boundary = "dirichlet"
    weighted: bool = True


def ball_samples(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, base: tuple[Array, Array] | None
) -> tuple[Array, Array, list[list[Samples]]]:
    """Samples of each ball, for each map that `lab.LabCalibration` needs.

    Parameters
    ----------
    balls, background, setup, base
        See `lab.calibrate`.

    Returns
    -------
    background : array, shape (rows, columns, channels)
        The untouched gel, checked.
    spread : array, shape (channels,)
        Root mean square colour change over the contacts: the unit of colour.
    parts : list of list of Samples
        Samples of each ball from the trusted part of its contact, then, unless `setup.detail` is 0, from
        almost all of it.

    Raises
    ------
    ValueError
        If there are fewer than two balls, shapes differ, or nothing changes colour.
    """
    background = np.asarray(background, dtype=float)
    if background.ndim != 3 or (background.mean(axis=(0, 1)) <= 0).any():
        raise ValueError("background: must have shape (rows, columns, channels) and light in each channel")
    if len(balls) < 2:
        raise ValueError(f"balls: at least 2 are needed, got {len(balls)}")
    changes, truths = [], []
    for number, ball in enumerate(balls):
        image = np.asarray(ball.image, dtype=float)
        if image.shape != background.shape or not np.isfinite(image).all():
            raise ValueError(
                f"balls[{number}].image: must be finite of shape {background.shape}, got {image.shape}"
            )
        changes.append(relative_change(image, background, setup.smoothing_px, None))
        truths.append(ball_truth(ball, setup))
        if not (truths[-1][2] < setup.trusted * ball.contact_radius_px).any():
            raise ValueError(f"balls[{number}].centre_px: the contact lies outside the picture")
    inside = [
        change[r_px < ball.contact_radius_px]
        for change, (_, _, r_px), ball in zip(changes, truths, balls, strict=True)
    ]
    spread = np.sqrt((np.concatenate(inside) ** 2).mean(axis=0))
    if not (spread > 0).all():
        raise ValueError("balls: each channel must change colour in the contacts")
    base_p, base_q = base or (np.zeros(background.shape[:2]), np.zeros(background.shape[:2]))
    position = positions(background.shape)

    def samples(change: Array, p: Array, q: Array, u: Array, share: float) -> Samples:
        contact = np.flatnonzero(u < share)
        flat = thinned(np.flatnonzero(u > setup.flat_beyond), _FLAT_PIXELS)
        relative = -normals(p - base_p, q - base_q)[..., :2].reshape(-1, 2)
        pixels = np.concatenate([contact, flat])
        return Samples(
            change.reshape(-1, change.shape[-1])[pixels] / spread,
            position[pixels],
            np.concatenate([relative[contact], np.zeros((flat.size, 2))]),
            # every press counts alike, whatever its size
            np.concatenate([np.full(contact.size, 3 * _FLAT_PIXELS / contact.size), np.ones(flat.size)]),
        )

    parts = [
        [
            samples(change, p, q, (r_px / ball.contact_radius_px).ravel(), share)
            for change, (p, q, r_px), ball in zip(changes, truths, balls, strict=True)
        ]
        for share in ((setup.trusted, _RIM) if setup.detail > 0 else (setup.trusted,))
    ]
    return background, spread, parts


def ball_truth(ball: BallPress, setup: Setup) -> tuple[Array, Array, Array]:
    """Slopes p, q of the ball at the pixels of its picture, and their distance from its centre (px)."""
    rows, columns = np.asarray(ball.image).shape[:2]
    return ball_gradients(
        (rows, columns), ball.centre_px, ball_radius_mm=setup.ball_radius_mm, mm_per_px=setup.mm_per_px
    )


def relative_change(image: Array, background: Array, smoothing_px: float, mask: Mask | None) -> Array:
    """Smoothed change of colour relative to the mean background."""
    return smoothed((image - background) / background.mean(axis=(0, 1)), smoothing_px, mask)


def positions(shape: tuple[int, ...]) -> Array:
    """Positions of the pixels, -1..1 across the picture, shape (rows * columns, 2)."""
    y, x = np.meshgrid(np.linspace(1, -1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)
