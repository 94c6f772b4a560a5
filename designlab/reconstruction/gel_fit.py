"""Thickness of the gel and bias of the circles read off, from ball presses alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.height import normals
from designlab.reconstruction.methods import Kernel, Samples

THICKNESSES = (0.4, 0.6, 0.9, 1.35, 2.0, 3.0, 4.5)  # tried, in ball radii; the last is nearly a half space
BIASES = (-0.09, -0.02, 0.05, 0.12, 0.19, 0.26)  # tried
NEARER = (0.6, 0.77, 1.0, 1.25, 1.6)  # times the best thickness, tried next
STEPS = (-0.05, -0.025, 0.0, 0.025, 0.05)  # from the best bias, tried next
_PIXELS = 400  # a ball
_DRAWS = 400
_FINE = 121  # values between those tried
_LIKELY = (2.5, 97.5)  # percentiles of 95 %
_SLOPE = 0.3  # unit of slope
_COLOUR = Kernel(ridge=1e-3, colour_scale=1.0, position_scale=1.5, features=120)


class Estimate(NamedTuple):
    """A value with its interval of 95 %; an infinite end is one that the balls do not bound."""

    value: float
    low: float
    high: float


class GelFit(NamedTuple):
    """What ball presses tell of the gel and of their circles.

    Attributes
    ----------
    thickness_mm : Estimate
        Thickness of the gel.
    label_bias : Estimate
        By how much more than the contact the circles measure that were read off, as a share of it.
    misfit : array, shape (thicknesses, biases, balls)
        Mean squared error of the colours of each ball, predicted from its surface by the other balls, in
        squares of their spread, at the thicknesses and biases tried.
    """

    thickness_mm: Estimate
    label_bias: Estimate
    misfit: Array


def fit_gel(
    balls: Sequence[BallPress],
    changes: Sequence[Array],
    *,
    ball_radius_mm: float,
    mm_per_px: float,
    smoothing_px: float,
    reach: float,
    poisson: float,
    thickness_mm: float | None = None,
    label_bias: float | None = None,
    seed: int = 0,
) -> GelFit:
    """Find thickness and bias for which the same slope at the same place has the same colour.

    For a thickness and a bias each ball's surface is known, inside its contact and around it (`BallSurface`).
    Colour as a function of slope and place is learned from all balls but one and predicts the colours of that
    one. A scale of all slopes is free in this, so that flat surfaces gain nothing. The balls count by the
    logarithm of their errors, which is the likelihood of normal errors of unknown size, one for each ball.
    Intervals come from drawing balls with replacement (Efron 1979).

    Parameters
    ----------
    balls : sequence of BallPress
        Ball presses with refined centres.
    changes : sequence of arrays, shape (rows, columns, channels)
        Smoothed changes of colour in units of their spread.
    ball_radius_mm, mm_per_px, smoothing_px, poisson
        As in `ball_samples.Setup`.
    reach : float
        Pixels within so many contact radii are used.
    thickness_mm, label_bias : float, optional
        What is known is not fitted; its interval has no width.
    seed : int
        Of pixels and draws.
    """
    thicknesses = [thickness_mm] if thickness_mm is not None else [t * ball_radius_mm for t in THICKNESSES]
    biases = [label_bias] if label_bias is not None else list(BIASES)
    draw = np.random.default_rng(seed)
    views = [
        _View.of(ball, change, reach, smoothing_px, draw) for ball, change in zip(balls, changes, strict=True)
    ]

    def misfit_at(thickness: float, bias: float) -> Array:
        surface = BallSurface(ball_radius_mm, thickness, poisson)
        samples = [view.samples(surface, bias, mm_per_px, smoothing_px) for view in views]
        fits = _COLOUR.fit_without_each(samples)
        return np.array(
            [
                ((fit(s.signal, s.position) - s.slope) ** 2).mean()
                for fit, s in zip(fits, samples, strict=True)
            ]
        )

    # once far apart, then about the best, where the misfit is a parabola
    for finer in (False, True):
        misfit = np.array([[misfit_at(t, b) for b in biases] for t in thicknesses])
        fine, evidence = _between(misfit, thicknesses, biases)
        if not finer:
            row, column = np.unravel_index(evidence.mean(axis=-1).argmin(), evidence.shape[:2])
            if len(thicknesses) > 1:
                middle = min(fine[0][row], thicknesses[-1] / NEARER[-1])
                thicknesses = [middle * factor for factor in NEARER]
            if len(biases) > 1:
                biases = [fine[1][column] + step for step in STEPS]
    shares = [np.full(len(balls), 1 / len(balls))]
    shares += list(draw.multinomial(len(balls), shares[0], size=_DRAWS) / len(balls))
    least = [np.unravel_index((evidence @ share).argmin(), evidence.shape[:2]) for share in shares]
    found = np.array([(fine[0][row], fine[1][column]) for row, column in least])
    best, drawn = found[0], found[1:]
    estimates = []
    for value, several, tried in zip(best, drawn.T, (thicknesses, biases), strict=True):
        low, high = np.percentile(several, _LIKELY)
        if len(tried) > 1 and tried is thicknesses and high >= 0.999 * tried[-1]:
            high = np.inf
        estimates.append(Estimate(float(value), float(low), float(high)))
    return GelFit(estimates[0], estimates[1], misfit)


def _between(
    misfit: Array, thicknesses: Sequence[float], biases: Sequence[float]
) -> tuple[tuple[Array, Array], Array]:
    """Thicknesses and biases between those tried, and the logarithm of each ball's misfit at them.

    The misfit itself is interpolated, which is nearly a parabola about its least, and never far below it.
    """
    values = misfit
    fine = []
    for axis, known in enumerate((np.log(thicknesses), np.asarray(biases, dtype=float))):
        fine.append(np.linspace(known[0], known[-1], _FINE) if known.size > 1 else known)
        if known.size > 1:
            values = make_interp_spline(known, values, k=2, axis=axis)(fine[axis])
    floor = 0.5 * misfit.min(axis=(0, 1))
    return (np.exp(fine[0]), fine[1]), np.log(np.maximum(values, floor))


class _View(NamedTuple):
    """Part of a picture around a ball, and the pixels of it that are compared."""

    radius_px: float
    x_px: Array
    y_px: Array
    chosen: NDArray[np.intp]
    colour: Array
    position: Array

    @classmethod
    def of(
        cls, ball: BallPress, change: Array, reach: float, smoothing_px: float, draw: np.random.Generator
    ) -> "_View":
        """Pixels drawn evenly from the circle of `reach` radii."""
        rows, columns = np.indices(change.shape[:2])
        x, y = np.asarray(columns - ball.centre_px[0]), np.asarray(ball.centre_px[1] - rows)
        far = reach * ball.contact_radius_px + 4 * smoothing_px
        box = np.s_[
            max(0, int(ball.centre_px[1] - far)) : int(ball.centre_px[1] + far) + 2,
            max(0, int(ball.centre_px[0] - far)) : int(ball.centre_px[0] + far) + 2,
        ]
        x, y, colour = x[box], y[box], change[box]
        near = np.flatnonzero(np.hypot(x, y) < reach * ball.contact_radius_px)
        chosen = draw.choice(near, min(_PIXELS, near.size), replace=False)
        half = (np.array(change.shape[1::-1]) - 1) / 2
        across, down = np.asarray(columns / half[0] - 1), np.asarray(1 - rows / half[1])
        place = np.stack([across[box], down[box]], axis=-1).reshape(-1, 2)
        flat = colour.reshape(-1, colour.shape[-1])
        return cls(ball.contact_radius_px, x, y, chosen, flat[chosen], place[chosen])

    def samples(self, surface: BallSurface, bias: float, mm_per_px: float, smoothing_px: float) -> Samples:
        """Slope vectors, smoothed as colours are, as what is known, and colours as what is looked for."""
        p, q = ball_slopes(
            surface, self.x_px * mm_per_px, self.y_px * mm_per_px, self.radius_px * mm_per_px / (1 + bias)
        )
        if smoothing_px:
            p, q = gaussian_filter(p, smoothing_px), gaussian_filter(q, smoothing_px)
        slope = -normals(p, q)[..., :2].reshape(-1, 2)[self.chosen]
        return Samples(slope / _SLOPE, self.position, self.colour, np.ones(self.chosen.size))


def ball_slopes(
    surface: BallSurface, x_mm: Array, y_mm: Array, contact_radius_mm: float
) -> tuple[Array, Array]:
    """Slopes p and q of a ball's surface at places from its axis (mm)."""
    r = np.hypot(x_mm, y_mm)
    ratio = surface.slope(r, contact_radius_mm) / np.maximum(r, 1e-9)
    return np.asarray(ratio * x_mm), np.asarray(ratio * y_mm)
