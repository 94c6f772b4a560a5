"""Calibration as a lab does it: ball presses in, a map from pictures to height and normals out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from designlab.metrics import normal_error_deg
from designlab.reconstruct.balls import BallPress, ball_gradients, smoothed
from designlab.reconstruct.height import Boundary, gradients_of, integrate, normals, sharpen
from designlab.reconstruct.methods import (
    Kernel,
    Method,
    Polynomial,
    Predictor,
    Samples,
    expected_error,
    expected_error_without_each,
    slope_gradients,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_FLAT_PIXELS = 500
_TOLERANCE = 1e-4  # of a weighted integration: far below a micrometre


class Setup(NamedTuple):
    """What is fixed by the lab and the physics, not by fitting.

    Attributes
    ----------
    ball_radius_mm, mm_per_px : float
        Ball and scale of the pictures at the membrane.
    trusted : float
        Share of the contact radius within which the membrane follows the ball. It leaves the ball before
        the circle that one sees.
    flat_beyond : float
        From this many contact radii on the membrane counts as flat.
    smoothing_px : float
        Gaussian smoothing of the colour change, against grain and the blocks of compressed video.
    sharpening : tuple of float
        Strength and width (px) of `sharpen`, which gives back part of the rim that smoothing took.
    boundary : str
        Of the integration, see `integrate`.
    weighted : bool
        Weigh each pixel in the integration by the inverse of its expected error, which is learned from balls
        left out of the calibration.
    """

    ball_radius_mm: float
    mm_per_px: float
    trusted: float = 0.86
    flat_beyond: float = 2.5
    smoothing_px: float = 2.0
    sharpening: tuple[float, float] = (0.7, 4.0)
    boundary: Boundary = "dirichlet"
    weighted: bool = True


class Shape(NamedTuple):
    """Reconstructed indentation: height (mm) above the undeformed membrane, and its slopes p and q."""

    height_mm: Array
    p: Array
    q: Array


@dataclass(frozen=True, eq=False)
class LabCalibration:
    """A calibration made from ball presses.

    Attributes
    ----------
    background : array, shape (rows, columns, channels)
        The untouched gel.
    setup : Setup
        Scale, ball, smoothing.
    spread : array, shape (channels,)
        Root mean square colour change over the contacts: the unit of colour.
    predictor : callable
        The fitted map, see `methods`.
    expected_error : callable, optional
        Expected squared error of the slopes, see `methods.expected_error`.
    """

    background: Array
    setup: Setup
    spread: Array
    predictor: Predictor
    expected_error: Predictor | None = None

    def gradients(self, image: ArrayLike, *, mask: Mask | None = None) -> tuple[Array, Array]:
        """Slopes p = dz/dx, q = dz/dy of the indentation, pixel by pixel.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            A press.
        mask : bool array, shape (rows, columns), optional
            Pixels that show the bare membrane; printed markers left out. They are filled from around.
        """
        return self._gradients(self._signal(image, mask))

    def _gradients(self, signal: Array) -> tuple[Array, Array]:
        p, q = slope_gradients(self.predictor(signal, _position(self.background.shape))).T.reshape(
            2, *self.background.shape[:2]
        )
        return p, q

    def _weights(self, signal: Array, mask: Mask | None) -> Array | None:
        """Weights of the pixels in the integration; None where all are alike."""
        shape = self.background.shape[:2]
        if self.expected_error is None:
            return None if mask is None else mask.astype(float)
        weights = 1 / self.expected_error(signal, _position(self.background.shape)).reshape(shape)
        weights /= weights.max()
        return weights if mask is None else weights * mask

    def reconstruct(self, image: ArrayLike, *, mask: Mask | None = None, robust: bool = False) -> Shape:
        """Height and slopes that agree with each other.

        Slopes are those of the integrated height: what no surface can have is left out of them.

        Parameters
        ----------
        image, mask
            See `gradients`; masked pixels have no weight in the integration.
        robust : bool
            See `integrate`.
        """
        signal = self._signal(image, mask)
        p, q = self._gradients(signal)
        setup = self.setup
        height = integrate(
            p,
            q,
            pitch_mm=setup.mm_per_px,
            boundary=setup.boundary,
            weights=self._weights(signal, mask),
            robust=robust,
            tolerance=_TOLERANCE,
        )
        strength, sigma_px = setup.sharpening
        height = sharpen(height, strength=strength, sigma_px=sigma_px)
        return Shape(height, *gradients_of(height, pitch_mm=setup.mm_per_px))

    def _signal(self, image: ArrayLike, mask: Mask | None) -> Array:
        image = np.asarray(image, dtype=float)
        if image.shape != self.background.shape:
            raise ValueError(
                f"image: must have the shape of the background {self.background.shape}, got {image.shape}"
            )
        if mask is not None and (mask.shape != image.shape[:2] or mask.dtype != bool or not mask.any()):
            raise ValueError(f"mask: must be bool of shape {image.shape[:2]} with a pixel to use")
        change = _change(image, self.background, self.setup.smoothing_px, mask) / self.spread
        return change.reshape(-1, self.background.shape[-1])


class LeftOut(NamedTuple):
    """Errors on balls that were left out of the calibration in turn, means over the balls.

    Attributes
    ----------
    trusted_deg, circle_deg : float
        Mean angle between normals within the trusted part of the contact circle, and within all of it.
    height_mm : float
        Root mean square error of height within the trusted part; the mean of each ball is free, since its
        depth is not known.
    """

    trusted_deg: float
    circle_deg: float
    height_mm: float

    @property
    def combined(self) -> float:
        """Product of `circle_deg` and `height_mm`, by which `choose_method` chooses.

        What brings normals nearer to the ball where the membrane is about to leave it makes the contact too
        high. A product weighs relative gains in either alike, with no unit and no weight to choose.
        """
        return self.circle_deg * self.height_mm


def calibrate(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    *,
    method: Method | None = None,
    base: tuple[Array, Array] | None = None,
) -> LabCalibration:
    """Calibrate on ball presses.

    Parameters
    ----------
    balls : sequence of BallPress
        At least two, at different places.
    background : array, shape (rows, columns, channels)
        The untouched gel.
    setup : Setup
        Scale, ball and what is known of the gel.
    method : Method, optional
        See `methods`; `Polynomial()` when absent.
    base : pair of arrays, shape (rows, columns), optional
        Slopes of the undeformed membrane, for a dome; a plane when absent.

    Raises
    ------
    ValueError
        If there are fewer than two balls, or shapes differ.
    """
    background, spread, presses = _prepare(balls, background, setup, base)
    method = method or Polynomial()
    error = None
    if setup.weighted:
        error = expected_error(presses, _predicted(method.fit_without_each(presses), presses))
    return LabCalibration(background, setup, spread, method.fit(presses), error)


def _predicted(fits: Sequence[Predictor], presses: Sequence[Samples]) -> list[Array]:
    """Slopes of each press by its own fit."""
    return [fit(press.signal, press.position) for fit, press in zip(fits, presses, strict=True)]


def refine_centres(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    *,
    method: Method | None = None,
    rounds: int = 4,
) -> list[BallPress]:
    """Move each ball's centre to where its own reconstructed normals meet.

    A centre read off a picture is good to a pixel, which is a degree on a small ball. Each ball is
    reconstructed by a calibration on the others; its normals point to the centre, which then replaces the
    one read off, and so on. Valid on a flat gel.

    Parameters
    ----------
    balls, background, setup, method
        See `calibrate`.
    rounds : int
        Times that all balls are moved.
    """
    balls = list(balls)
    plain = setup._replace(sharpening=(0.0, 1.0), weighted=False)
    rows, columns = np.indices(np.asarray(background).shape[:2])
    reach_px = setup.ball_radius_mm / setup.mm_per_px
    for _ in range(rounds):
        moved = []
        for ball, shape in zip(balls, _left_out(balls, background, plain, method), strict=True):
            normal = normals(shape.p, shape.q)
            r = np.hypot(columns - ball.centre_px[0], rows - ball.centre_px[1])
            near = r < 0.9 * setup.trusted * ball.contact_radius_px
            column = np.median((columns - normal[..., 0] * reach_px)[near])
            row = np.median((rows + normal[..., 1] * reach_px)[near])
            moved.append(ball.moved((float(column), float(row))))
        balls = moved
    return balls


def left_out_errors(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, *, method: Method | None = None
) -> LeftOut:
    """Errors on each ball of a calibration on the others, on a flat gel. Parameters as `calibrate`."""
    errors = []
    for ball, shape in zip(balls, _left_out(balls, background, setup, method), strict=True):
        p, q, r_px = _truth(ball, setup)
        error_deg = normal_error_deg(normals(shape.p, shape.q), normals(p, q))
        inside = r_px < ball.contact_radius_px
        trusted = r_px < setup.trusted * ball.contact_radius_px
        cap = np.sqrt(np.maximum(setup.ball_radius_mm**2 - (r_px * setup.mm_per_px) ** 2, 0.0))
        height = (shape.height_mm - cap)[trusted]
        errors.append((error_deg[trusted].mean(), error_deg[inside].mean(), height.std()))
    return LeftOut(*(float(mean) for mean in np.mean(errors, axis=0)))


def choose_method(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    methods: Sequence[Method] = (Polynomial(), Polynomial(position_degrees=(2, 2, 2, 1)), Kernel()),
) -> tuple[Method, list[tuple[Method, LeftOut]]]:
    """The method with the least `LeftOut.combined` error on balls left out, and all errors.

    Parameters
    ----------
    balls, background, setup
        See `calibrate`.
    methods : sequence of Method
        Candidates.
    """
    if not methods:
        raise ValueError("methods: must hold a candidate")
    table = [(method, left_out_errors(balls, background, setup, method=method)) for method in methods]
    return min(table, key=lambda row: row[1].combined)[0], table


def _left_out(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, method: Method | None
) -> list[Shape]:
    """Each ball as reconstructed by a calibration on the others."""
    background, spread, presses = _prepare(balls, background, setup, None)
    calibration = LabCalibration(background, setup, spread, _nothing)
    fits = (method or Polynomial()).fit_without_each(presses)
    errors: Sequence[Predictor | None] = [None] * len(balls)
    if setup.weighted:
        errors = expected_error_without_each(presses, _predicted(fits, presses))
    return [
        replace(calibration, predictor=fit, expected_error=error).reconstruct(ball.image)
        for ball, fit, error in zip(balls, fits, errors, strict=True)
    ]


def _nothing(signal: Array, position: Array) -> Array:
    return np.zeros((len(signal), 2))


def _prepare(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, base: tuple[Array, Array] | None
) -> tuple[Array, Array, list[Samples]]:
    """The background, the unit of colour, and the samples of each ball."""
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
        changes.append(_change(image, background, setup.smoothing_px, None))
        truths.append(_truth(ball, setup))
        if not (truths[-1][2] < setup.trusted * ball.contact_radius_px).any():
            raise ValueError(f"balls[{number}].centre_px: the contact lies outside the picture")
    inside = [
        change[r_px < ball.contact_radius_px]
        for change, (_, _, r_px), ball in zip(changes, truths, balls, strict=True)
    ]
    spread = np.sqrt((np.concatenate(inside) ** 2).mean(axis=0))
    if not (spread > 0).all():
        raise ValueError("balls: each channel must change colour in the contacts")
    position = _position(background.shape)
    presses = []
    for change, (p, q, r_px), ball in zip(changes, truths, balls, strict=True):
        u = (r_px / ball.contact_radius_px).ravel()
        contact, flat = np.flatnonzero(u < setup.trusted), np.flatnonzero(u > setup.flat_beyond)
        flat = flat[np.linspace(0, flat.size - 1, min(_FLAT_PIXELS, flat.size)).round().astype(int)]
        base_p, base_q = base or (np.zeros_like(p), np.zeros_like(q))
        relative = -normals(p - base_p, q - base_q)[..., :2].reshape(-1, 2)
        pixels = np.concatenate([contact, flat])
        presses.append(
            Samples(
                change.reshape(-1, change.shape[-1])[pixels] / spread,
                position[pixels],
                np.concatenate([relative[contact], np.zeros((flat.size, 2))]),
                # every press counts alike, whatever its size
                np.concatenate([np.full(contact.size, 3 * _FLAT_PIXELS / contact.size), np.ones(flat.size)]),
            )
        )
    return background, spread, presses


def _truth(ball: BallPress, setup: Setup) -> tuple[Array, Array, Array]:
    rows, columns = np.asarray(ball.image).shape[:2]
    return ball_gradients(
        (rows, columns), ball.centre_px, ball_radius_mm=setup.ball_radius_mm, mm_per_px=setup.mm_per_px
    )


def _change(image: Array, background: Array, smoothing_px: float, mask: Mask | None) -> Array:
    """Smoothed change of colour relative to the mean background."""
    return smoothed((image - background) / background.mean(axis=(0, 1)), smoothing_px, mask)


def _position(shape: tuple[int, ...]) -> Array:
    y, x = np.meshgrid(np.linspace(1, -1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    return np.stack([x.ravel(), y.ravel()], axis=1)
