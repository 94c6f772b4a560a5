"""Thickness of the gel and bias of the circles read off, from ball presses alone."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter
from scipy.stats import t as student

from designlab.core.types import Array
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.ball_view import BallView
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.height import normals
from designlab.reconstruction.methods import Kernel, LinearMap, Predictor, Samples

# The ball's radius over the thickness: a half space is no more than 0 of it, and little differs from 0.2.
_THINNESS = (0.22, 0.4, 0.67, 1.0, 1.5, 2.2)
_NEARER = ((0.6, 0.8, 1.0, 1.2, 1.4), (0.8, 0.9, 1.0, 1.1, 1.2))  # times the best one, tried next
_WIDE = (-0.12, -0.06, 0.0, 0.06, 0.12, 0.18, 0.24)  # biases tried at first
_NARROW = (-0.03, 0.0, 0.03)  # tried about what was found
_LEAST_BALLS = 3
_PIXELS = 400  # a ball
_FINE = 801  # values between those tried
_LIKELY = 0.975  # of Student's distribution: 95 % between both ends
_SLOPE = 0.3  # unit of slope
_NOTHING = 1e-12  # squared colour, of a map that tells none
_COLOUR = Kernel(ridge=1e-3, colour_scale=1.0, position_scale=1.5, features=240)


class FittedValue(NamedTuple):
    """A value with its interval of 95 %; an end that the balls do not bound is 0 or infinite."""

    value: float
    low: float
    high: float


class GelFit(NamedTuple):
    """What ball presses tell of the gel and of their circles.

    Attributes
    ----------
    thickness_mm : FittedValue
        Thickness of the gel.
    label_bias : FittedValue
        By how much more than the contacts the circles measure that were read off, as a share of them.
    contact_radii_px : array, shape (balls,)
        Contact radius of each ball.
    """

    thickness_mm: FittedValue
    label_bias: FittedValue
    contact_radii_px: Array


def fit_gel(
    balls: Sequence[BallPress],
    changes: Sequence[Array],
    views: Sequence[BallView],
    *,
    smoothing_px: float,
    reach: float,
    thickness_mm: float | None = None,
    label_bias: float | None = None,
    seed: int = 0,
) -> GelFit:
    """Find thickness and bias for which the same slope at the same place has the same colour.

    For a thickness and a contact radius a ball's surface is known, inside its contact and around it
    (`BallSurface`). Colour as a function of slope and place is learned from all balls but one and predicts
    the colours of that one. The contact radius of each ball is found so, at each thickness; the thickness is
    the one with the least errors, and the bias is what the circles have more than these radii, in the mean.
    Balls count by the logarithm of their squared errors, the likelihood of normal errors of unknown size.
    Where the thickness is known, the strength of each ball's colours is free.

    Intervals are by the jackknife: estimates without each ball in turn, and Student's distribution. That of
    the thickness is symmetric in its inverse, in which the surface varies evenly up to a half space.

    Parameters
    ----------
    balls : sequence of BallPress
        At least three, with refined centres.
    changes : sequence of arrays, shape (rows, columns, channels)
        Smoothed changes of colour in units of their spread.
    views : sequence of BallView
        What the pixels see of each ball, on a gel of any thickness.
    smoothing_px
        As in `Setup`.
    reach : float
        Pixels within so many contact radii are used.
    thickness_mm, label_bias : float, optional
        What is known is not fitted; its interval has no width.
    seed : int
        Of the pixels.

    Raises
    ------
    ValueError
        If there are fewer than three balls.
    """
    if len(balls) < _LEAST_BALLS:
        raise ValueError(
            f"balls: at least {_LEAST_BALLS} are needed to fit thickness_mm and label_bias of the gel, "
            f"got {len(balls)}"
        )
    draw = np.random.default_rng(seed)
    shown = [
        _Shown.of(ball, change, view, reach, smoothing_px, draw)
        for ball, change, view in zip(balls, changes, views, strict=True)
    ]
    scene = _Scene(shown, smoothing_px, label_bias, thickness_known=thickness_mm is not None)
    if thickness_mm is not None:
        thinness = np.array([scene.usual_radius_mm / thickness_mm])
        radii, misfit = scene.profile(thinness, scene.first_radii(thickness_mm), rounds=2)
    else:
        thinness = np.array(_THINNESS)
        radii, misfit = scene.profile(thinness, scene.first_radii(1.5 * scene.usual_radius_mm))
        for rounds, factors in enumerate(_NEARER, start=1):
            fine, evidence = _between(thinness, misfit)
            best = fine[evidence.mean(axis=1).argmin()]
            start = radii[np.abs(thinness - best).argmin()]
            thinness = best * np.array(factors)
            radii, misfit = scene.profile(thinness, start, rounds)
    return _estimates(scene, thinness, radii, misfit)


def _estimates(scene: "_Scene", thinness: Array, radii: Array, misfit: Array) -> GelFit:
    """Least misfit and its jackknife, from radii and misfit of each ball at each thinness tried."""
    log_radii = np.log(radii)
    radii_of = make_interp_spline(thinness, log_radii, k=min(2, thinness.size - 1))

    def least(misfit: Array, kept: NDArray[np.intp]) -> tuple[float, float]:
        fine, evidence = _between(thinness, misfit)
        best = float(fine[evidence.mean(axis=1).argmin()])
        if scene.label_bias is not None:
            return best, float(np.log1p(scene.label_bias))
        return best, float((np.log(scene.labels_mm) - radii_of(best))[kept].mean())

    every = np.arange(len(scene.shown))
    found = np.array(least(misfit, every))
    parts = zip(scene.usual_radius_mm / thinness, radii, strict=True)
    fewer = np.array([scene.misfits_without_each(*part) for part in parts])
    without = np.array([least(fewer[:, each], np.delete(every, each)) for each in every])
    error = np.sqrt((every.size - 1) * without.var(axis=0))
    reach = float(student.ppf(_LIKELY, every.size - 1)) * error
    low, high = found - reach, found + reach
    if thinness.size > 1:  # what lies at an end of what was tried is not bounded there
        low[0] = 0.0 if found[0] <= thinness[0] else max(low[0], 0.0)
        high[0] = np.inf if found[0] >= thinness[-1] else high[0]
    return GelFit(
        FittedValue(
            float(scene.usual_radius_mm / found[0]),
            float(scene.usual_radius_mm / high[0]),
            float(scene.usual_radius_mm / low[0]) if low[0] > 0 else np.inf,
        ),
        FittedValue(*(float(np.expm1(value)) for value in (found[1], low[1], high[1]))),
        np.exp(radii_of(found[0])) / scene.mm_per_px,
    )


def _between(tried: Array, misfit: Array) -> tuple[Array, Array]:
    """Values between those tried, and the logarithm of each ball's misfit at them.

    The misfit itself is interpolated, which is nearly a parabola about its least, and never far below it.
    """
    if tried.size == 1:
        return tried, np.log(misfit)
    fine = np.linspace(tried[0], tried[-1], _FINE)
    values = make_interp_spline(tried, misfit, k=2)(fine)
    return fine, np.log(np.maximum(values, 0.5 * misfit.min(axis=0)))


class _Shown(NamedTuple):
    """Part of a picture around a ball, and the pixels of it that are compared."""

    radius_px: float
    view: BallView
    chosen: NDArray[np.intp]
    colour: Array
    position: Array

    @classmethod
    def of(
        cls,
        ball: BallPress,
        change: Array,
        view: BallView,
        reach: float,
        smoothing_px: float,
        draw: np.random.Generator,
    ) -> "_Shown":
        """Pixels drawn evenly from the circle of `reach` radii."""
        r_px = view.r_px
        rows, columns = np.indices(change.shape[:2])
        far = reach * ball.contact_radius_px + 4 * smoothing_px
        around, used = r_px <= far, r_px < reach * ball.contact_radius_px
        if ball.covered is not None:
            used &= ~ball.covered
        down, across = (np.flatnonzero(around.any(axis=axis)) for axis in (1, 0))
        box = np.s_[down[0] : down[-1] + 1, across[0] : across[-1] + 1]
        colour = change[box]
        near = np.flatnonzero(used[box])
        chosen = draw.choice(near, min(_PIXELS, near.size), replace=False)
        half = (np.array(change.shape[1::-1]) - 1) / 2
        across, down = np.asarray(columns / half[0] - 1), np.asarray(1 - rows / half[1])
        place = np.stack([across[box], down[box]], axis=-1).reshape(-1, 2)
        flat = colour.reshape(-1, colour.shape[-1])
        return cls(ball.contact_radius_px, view.part(box), chosen, flat[chosen], place[chosen])

    def samples(self, surface: BallSurface, contact_mm: float, smoothing_px: float) -> Samples:
        """Slope vectors, smoothed as colours are, as what is known, and colours as what is looked for."""
        slope = -normals(*self.view._replace(surface=surface, contact_mm=contact_mm).gel_slopes())[..., :2]
        if smoothing_px:  # Lambert's law is linear in normals, so these are smoothed
            slope = gaussian_filter(slope, (smoothing_px, smoothing_px, 0))
        slope = slope.reshape(-1, 2)[self.chosen]
        return Samples(slope / _SLOPE, self.position, self.colour, np.ones(self.chosen.size))


class _Scene(NamedTuple):
    """All balls, and how well the others predict the colours of each."""

    shown: Sequence[_Shown]
    smoothing_px: float
    label_bias: float | None
    thickness_known: bool

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel at the gel."""
        return self.shown[0].view.mm_per_px

    @property
    def usual_radius_mm(self) -> float:
        """Radius of the balls, in the middle where they differ."""
        return float(np.median([each.view.surface.ball_radius_mm for each in self.shown]))

    @property
    def labels_mm(self) -> Array:
        """Radii of the circles read off."""
        return self.mm_per_px * np.array([each.radius_px for each in self.shown])

    def first_radii(self, thickness_mm: float) -> Array:
        """Contact radii (mm) that all circles have with the same bias."""
        if self.label_bias is not None:
            return self.labels_mm / (1 + self.label_bias)
        return self._scaled(thickness_mm, self.labels_mm, _WIDE)

    def profile(self, thinness: Array, radii_mm: Array, rounds: int = 1) -> tuple[Array, Array]:
        """Contact radii (mm) that fit best at each thinness, and misfits, shape (thinness, balls) both."""
        found, misfits = [], []
        for thickness in self.usual_radius_mm / thinness:
            for _ in range(rounds):
                if self.label_bias is None:
                    radii_mm = self._scaled(thickness, radii_mm, _NARROW)
                radii_mm = self._each_scaled(thickness, radii_mm)
                if self.label_bias is not None:
                    share = np.log(self.labels_mm / radii_mm).mean() - np.log1p(self.label_bias)
                    radii_mm = radii_mm * np.exp(share)
            found.append(radii_mm)
            misfits.append(self._misfit(thickness, radii_mm))
        return np.array(found), np.array(misfits)

    def _scaled(self, thickness_mm: float, radii_mm: Array, biases: Sequence[float]) -> Array:
        """Contact radii less the bias, common to all, of the least misfit."""
        misfit = np.array([self._misfit(thickness_mm, radii_mm / (1 + bias)) for bias in biases])
        fine, evidence = _between(np.array(biases), misfit)
        return np.asarray(radii_mm / (1 + fine[evidence.mean(axis=1).argmin()]))

    def _each_scaled(self, thickness_mm: float, radii_mm: Array) -> Array:
        """Contact radii, each as suits what the others say with theirs."""
        surfaces, _, fits = self._fits(thickness_mm, radii_mm)
        misfit = np.array(
            [
                [
                    self._error(fit, each.samples(surface, radius / (1 + bias), self.smoothing_px))
                    for each, surface, radius, fit in zip(self.shown, surfaces, radii_mm, fits, strict=True)
                ]
                for bias in _NARROW
            ]
        )
        fine, evidence = _between(np.array(_NARROW), misfit)
        return np.asarray(radii_mm / (1 + fine[evidence.argmin(axis=0)]))

    def misfits_without_each(self, thickness_mm: float, radii_mm: Array) -> Array:
        """Misfits as if each ball in turn did not exist, shape (balls, balls - 1)."""
        _, samples, _ = self._fits(thickness_mm, radii_mm)
        terms = [_COLOUR.normal(own) for own in samples]
        rows = []
        for each in range(len(samples)):
            others = samples[:each] + samples[each + 1 :]
            fits = _COLOUR.solve_without_each(terms[:each] + terms[each + 1 :])
            rows.append([self._error(fit, own) for fit, own in zip(fits, others, strict=True)])
        return np.array(rows)

    def _misfit(self, thickness_mm: float, radii_mm: Array) -> Array:
        """Mean squared error of the colours of each ball, as predicted by the others."""
        _, samples, fits = self._fits(thickness_mm, radii_mm)
        return np.array([self._error(fit, own) for fit, own in zip(fits, samples, strict=True)])

    def _fits(
        self, thickness_mm: float, radii_mm: Array
    ) -> tuple[list[BallSurface], list[Samples], list[LinearMap]]:
        """Surfaces and samples of the balls, and maps from slope to colour without each ball in turn."""
        surfaces = [replace(each.view.surface, thickness_mm=thickness_mm) for each in self.shown]
        samples = [
            each.samples(surface, radius, self.smoothing_px)
            for each, surface, radius in zip(self.shown, surfaces, radii_mm, strict=True)
        ]
        return surfaces, samples, _COLOUR.fit_without_each(samples)

    def _error(self, fit: Predictor, samples: Samples) -> float:
        """Mean squared error of colours; whatever their strength, where the thickness is known.

        Deep contacts lie nearer to the lights and darken themselves. One factor a ball takes what slope and
        place do not tell, so that its rim decides how large it is. It would take from the thickness, too.
        """
        told, colour = fit(samples.signal, samples.position), samples.slope  # what the map looks for
        if self.thickness_known:
            told = told * max((told * colour).sum(), 0.0) / max((told**2).sum(), _NOTHING)
        return float(((told - colour) ** 2).mean())
