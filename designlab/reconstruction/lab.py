"""Calibration as a lab does it: ball presses in, a map from pictures to height and normals out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from designlab.core.metrics import normal_error_deg
from designlab.core.types import Array, Mask
from designlab.reconstruction.ball_samples import (
    ball_samples,
    known_gel,
    positions,
    relative_change,
    shape_samples,
)
from designlab.reconstruction.ball_view import ball_view, placed_by_circle
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.gel_fit import GelFit
from designlab.reconstruction.height import blended, gradients_of, integrate, normals
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import (
    ErrorMap,
    JointMap,
    Kernel,
    LinearMap,
    Method,
    Polynomial,
    Predictor,
    Samples,
    expected_error,
    expected_error_without_each,
    slope_gradients,
)
from designlab.reconstruction.pictures import check_mask
from designlab.reconstruction.setup import Setup

RIDGES = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
_POSITION_SCALES = (1.4, 2.0, 2.8)  # how fast colours change with place differs from sensor to sensor
_UNSEEN = 1e-2  # weight of gel beyond the camera's sight
_TOLERANCE = 1e-4  # of a weighted integration: far below a micrometre


@dataclass(frozen=True, eq=False)
class ReconstructedShape:
    """Reconstructed indentation.

    Attributes
    ----------
    height_mm : array, shape (rows, columns)
        Height above the undeformed membrane.
    read : pair of array, shape (rows, columns)
        Slopes dz/dx and dz/dy that the finest map reads off the colours.
    pitch_mm : float
        Distance of pixels.
    mask : bool array, shape (rows, columns), optional
        Pixels whose colours tell slopes; all when absent.
    """

    height_mm: Array
    read: tuple[Array, Array]
    pitch_mm: float
    mask: Mask | None = None

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """Slopes between those read and those of the height, see `blended`."""
        return blended(*self.read, self.height_mm, pitch_mm=self.pitch_mm, mask=self.mask)

    def normals(self) -> Array:
        """Unit normals of the slopes, shape (rows, columns, 3)."""
        return normals(*self.slopes)

    def raised(self, by_mm: Array) -> "ReconstructedShape":
        """The same shape with a height added that no colour tells, as that of its border is."""
        return replace(self, height_mm=self.height_mm + by_mm)


class FittedMap(NamedTuple):
    """A fitted map.

    Attributes
    ----------
    predictor : callable
        From colour and place to slope vectors, see `methods`.
    expected_error : callable, optional
        Expected squared error of the slopes, see `methods.expected_error`.
    """

    predictor: Predictor
    expected_error: Predictor | None = None


@dataclass(frozen=True, eq=False)
class LabCalibration:
    """A calibration made from ball presses.

    Within the circle that one sees the gel has left the ball, as an elastic layer does. A map taught the
    ball's slopes up to the circle knows the object, and makes contacts too high; one taught the layer's
    surface, inside and around the contact, gets heights right and rounds the rim. So the first gives the fine
    detail of the height, the second all that is wider.

    Attributes
    ----------
    background : array, shape (rows, columns, channels)
        The untouched gel.
    setup : Setup
        Scale, ball, smoothing.
    spread : array, shape (channels,)
        Root mean square colour change over the contacts: the unit of colour.
    inner : FittedMap
        Map taught the surface of the gel.
    rim : FittedMap, optional
        Map taught the ball to almost all of the circles.
    detail_px : float
        Standard deviation of the Gaussian that parts fine from wide.
    gel : GelFit, optional
        Fit of thickness and bias of the circles; None where both were stated.
    """

    background: Array
    setup: Setup
    spread: Array
    inner: FittedMap
    rim: FittedMap | None = None
    detail_px: float = 0.0
    gel: GelFit | None = None

    def gradients(self, image: ArrayLike, *, mask: Mask | None = None) -> tuple[Array, Array]:
        """Slopes p = dz/dx, q = dz/dy of the indentation by the inner map, pixel by pixel.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            A press.
        mask : bool array, shape (rows, columns), optional
            Pixels that show the bare membrane; printed markers left out. They are filled from around.
        """
        return self._gradients(self.inner, self._signal(image, mask))

    def _gradients(self, fit: FittedMap, signal: Array) -> tuple[Array, Array]:
        return self._sloped(fit.predictor(signal, positions(self.background.shape)))

    def _sloped(self, slope: Array) -> tuple[Array, Array]:
        p, q = slope_gradients(slope).T.reshape(2, *self.background.shape[:2])
        return p, q

    @cached_property
    def alike(self) -> tuple[list[LinearMap], list[LinearMap]] | None:
        """All maps of slopes, and all of expected errors, where those are of one method each; else None."""
        fits = [fit for fit in (self.inner, self.rim) if fit is not None]
        slopes = [fit.predictor for fit in fits if isinstance(fit.predictor, LinearMap)]
        errors = [fit.expected_error.course for fit in fits if isinstance(fit.expected_error, ErrorMap)]
        kinds = {each.method for each in slopes}, {each.method for each in errors}
        if len(slopes) < len(fits) or len(errors) not in (0, len(fits)) or max(map(len, kinds)) > 1:
            return None
        if not errors and any(fit.expected_error is not None for fit in fits):
            return None
        return slopes, errors

    @cached_property
    def _joint(self) -> tuple[JointMap, JointMap | None] | None:
        if self.alike is None:
            return None
        place, channels = positions(self.background.shape), self.background.shape[-1]
        slopes, errors = self.alike
        return JointMap(slopes, place, channels), JointMap(errors, place, channels) if errors else None

    def _read(self, signal: Array) -> list[tuple[Array, Array, Array | None]]:
        """Slopes p and q, and weights in the integration, by the inner map and by that of the rim."""
        if self._joint is None:
            fits = [fit for fit in (self.inner, self.rim) if fit is not None]
            return [(*self._gradients(fit, signal), self._weights(fit, signal)) for fit in fits]
        slopes, errors = self._joint
        found = [self._sloped(slope) for slope in slopes(signal)]
        if errors is None:
            return [(*each, None) for each in found]
        # the level of an error has no part in weights
        shape = self.background.shape[:2]
        courses = [course[:, 0].reshape(shape) for course in errors(signal)]
        return [(*each, np.exp(course.min() - course)) for each, course in zip(found, courses, strict=True)]

    def _weights(self, fit: FittedMap, signal: Array) -> Array | None:
        """Weights of the pixels in the integration; None where all are alike."""
        if fit.expected_error is None:
            return None
        error = fit.expected_error(signal, positions(self.background.shape))
        weights: Array = error.min() / error.reshape(self.background.shape[:2])
        return weights

    def reconstruct(
        self,
        image: ArrayLike,
        *,
        mask: Mask | None = None,
        unseen: Mask | None = None,
        robust: bool = False,
    ) -> ReconstructedShape:
        """Height and slopes of a press.

        Parameters
        ----------
        image, mask
            See `gradients`; masked pixels have no weight in the integration.
        unseen : bool array, shape (rows, columns), optional
            Masked pixels beyond what the camera sees. They are taken to be flat, with little weight: without
            any nothing would hold the height to the border.
        robust : bool
            See `integrate`.
        """
        signal = self._signal(image, mask)
        pitch_mm = self.setup.mm_per_px
        counted = None if mask is None else mask.astype(float)
        if counted is not None and unseen is not None:
            counted[unseen] = _UNSEEN

        def height(p: Array, q: Array, weights: Array | None) -> Array:
            if counted is not None:
                weights = counted if weights is None else weights * counted
            return integrate(
                p,
                q,
                pitch_mm=pitch_mm,
                boundary=self.setup.boundary,
                weights=weights,
                robust=robust,
                tolerance=_TOLERANCE,
            )

        inner, *rim = self._read(signal)
        height_mm = height(*inner)
        if rim:
            more = height(*rim[0]) - height_mm
            height_mm += more - gaussian_filter(more, self.detail_px, mode="nearest")
        p, q, _ = rim[0] if rim else inner
        return ReconstructedShape(height_mm, (p, q), pitch_mm, mask)

    def change(self, image: ArrayLike, mask: Mask | None = None) -> Array:
        """Change of colour from the untouched gel, in spreads, (rows, columns, channels)."""
        return self._signal(image, mask).reshape(self.background.shape)

    def _signal(self, image: ArrayLike, mask: Mask | None) -> Array:
        image = np.asarray(image, dtype=float)
        if image.shape != self.background.shape:
            raise ValueError(
                f"image: must have the shape of the background {self.background.shape}, got {image.shape}"
            )
        check_mask(mask, image.shape[:2])
        change = relative_change(image, self.background, self.setup, mask) / self.spread
        return change.reshape(-1, self.background.shape[-1])


class LeftOut(NamedTuple):
    """Errors on balls that were left out of the calibration in turn, means over the balls.

    Attributes
    ----------
    contact_deg, circle_deg : float
        Mean angle between normals and those of the gel within the contact, which are the ball's unless a
        coating rounds them; and the ball's within the circle read off.
    height_mm : float
        Root mean square error of the gel's height within the contact; the mean of each ball is free, since
        its depth is not known.
    """

    contact_deg: float
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
    membrane: Membrane | None = None,
) -> LabCalibration:
    """Calibrate on ball presses.

    Parameters
    ----------
    balls : sequence of BallPress
        At least two, at different places.
    background : array, shape (rows, columns, channels)
        The untouched gel.
    setup : Setup
        Scale, ball and what is known of the gel; the rest is fitted, see `ball_samples.known_gel`.
    method : Method, optional
        See `methods`; `Kernel()` when absent.
    membrane : Membrane, optional
        The undeformed membrane on whose grid the pictures are laid out, for a dome; a plane when absent.

    Raises
    ------
    ValueError
        If there are fewer than two balls, or shapes differ.
    """
    balls, setup, gel = known_gel(balls, background, setup, membrane)
    background, spread, parts = ball_samples(balls, background, setup, membrane)
    method = method or Kernel()
    fits = []
    for presses in parts:
        error = None
        if setup.weighted:
            error = expected_error(presses, _predicted(method.fit_without_each(presses), presses))
        fits.append(FittedMap(method.fit(presses), error))
    return _assembled(balls, background, setup, spread, fits, gel)


def calibrate_on_shapes(
    images: Sequence[Array],
    background: Array,
    slopes: Sequence[tuple[Array, Array]],
    regions: Sequence[Mask],
    setup: Setup,
    *,
    method: Method | None = None,
) -> LabCalibration:
    """Calibrate on presses whose slopes are known at every pixel, as those of simulated ones are.

    Slopes on and around the contact are known alike, so one map takes them all.

    Parameters
    ----------
    images : sequence of array, shape (rows, columns, channels)
        At least two presses.
    background : array, shape (rows, columns, channels)
        The untouched gel.
    slopes : sequence of pair of arrays, shape (rows, columns)
        Slopes dz/dx and dz/dy of each indentation.
    regions : sequence of bool array, shape (rows, columns)
        On and around each contact.
    setup : Setup
        Scale, gel and smoothing; `detail` must be 0.
    method : Method, optional
        See `methods`; `Kernel()` when absent.

    Raises
    ------
    ValueError
        If a channel does not change colour.
    """
    method = method or Kernel()
    spread, presses = shape_samples(images, background, slopes, regions, setup)
    error = None
    if setup.weighted:
        error = expected_error(presses, _predicted(method.fit_without_each(presses), presses))
    return LabCalibration(background, setup, spread, FittedMap(method.fit(presses), error))


def _assembled(
    balls: Sequence[BallPress],
    background: Array,
    setup: Setup,
    spread: Array,
    fits: Sequence[FittedMap],
    gel: GelFit | None = None,
) -> LabCalibration:
    detail_px = setup.detail * float(np.mean([ball.contact_radius_px for ball in balls]))
    return LabCalibration(
        background, setup, spread, fits[0], fits[1] if len(fits) > 1 else None, detail_px, gel
    )


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
    membrane: Membrane | None = None,
) -> list[BallPress]:
    """Move each ball's centre to where its own reconstructed normals meet.

    A centre read off a picture is good to a pixel, which is a degree on a small ball. Each ball is
    reconstructed by a calibration on the others; its normals point to the centre, which then replaces the
    one read off, and so on. Balls left out cannot tell that all balls shrink towards a point or shift alike,
    since colours change with place. On a membrane whose circles show where the balls are, centres therefore
    do not move so; see `place_by_circles`. Of few balls that leaves little: of four, a fifth of the moves.

    Parameters
    ----------
    balls, background, setup, membrane
        See `calibrate`.
    method : Method, optional
        See `methods`; `Polynomial()` when absent, which is quick.
    rounds : int
        Times that all balls are moved.
    """
    method = method or Polynomial()
    moving, known, _ = known_gel(balls, background, setup, membrane)
    plain = known._replace(detail=0.0, weighted=False)
    base_p, base_q = (0.0, 0.0) if membrane is None else (membrane.p, membrane.q)
    for _ in range(rounds):
        moved = []
        for ball, shape in zip(moving, _left_out(moving, background, plain, method, membrane), strict=True):
            # slopes of the height alone, which lean less on where the labels of the others have their balls
            p, q = gradients_of(shape.height_mm, pitch_mm=setup.mm_per_px)
            normal, reach_px = normals(p + base_p, q + base_q), setup.radius_px(ball)
            view = ball_view(ball, known, membrane)
            near = view.r_px < known.contact_radius_px(ball)
            if membrane is not None:
                near &= membrane.seen
            if not near.any():
                moved.append(ball)
                continue
            column = ball.centre_px[0] + np.median((view.x_px - normal[..., 0] * reach_px)[near])
            row = ball.centre_px[1] - np.median((view.y_px - normal[..., 1] * reach_px)[near])
            moved.append(ball.moved((float(column), float(row))))
        moving = moved if membrane is None else without_common_moves(moving, moved)
    return [ball.moved(place.centre_px) for ball, place in zip(balls, moving, strict=True)]


def without_common_moves(before: Sequence[BallPress], after: Sequence[BallPress]) -> list[BallPress]:
    """Balls after a move, less what of it depends linearly on their places."""
    start = np.array([ball.centre_px for ball in before])
    moves = np.array([ball.centre_px for ball in after]) - start
    linear = np.column_stack([np.ones(len(start)), start])
    own = moves - linear @ np.linalg.lstsq(linear, moves)[0]
    return [ball.moved((float(x), float(y))) for ball, (x, y) in zip(before, start + own, strict=True)]


def place_by_circles(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, membrane: Membrane
) -> list[BallPress]:
    """Place the axes of balls on a curved or nearby membrane by the circles that pictures show of them.

    What is not known of the gel is fitted with the axes as they are.

    Parameters
    ----------
    balls : sequence of BallPress
        Their centres are the axes of balls that touch the undeformed membrane in the middle of the circles.
    background, setup, membrane
        See `calibrate`.
    """
    gel = known_gel(balls, background, setup, membrane).setup
    placed = []
    for ball in balls:
        circle_px = membrane.touched_from(ball.centre_px, setup.radius_px(ball))
        placed.append(placed_by_circle(ball, circle_px, gel, membrane))
    return placed


def left_out_errors(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, *, method: Method | None = None
) -> LeftOut:
    """Errors on balls of a calibration on the others, means over the balls. Parameters as `calibrate`."""
    errors = left_out_of_each(balls, background, setup, method=method)
    return LeftOut(*(float(mean) for mean in np.mean(errors, axis=0)))


def left_out_of_each(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    *,
    method: Method | None = None,
    membrane: Membrane | None = None,
) -> list[LeftOut]:
    """Errors on each ball of a calibration on the others. Parameters as `calibrate`."""
    errors = []
    balls, setup, _ = known_gel(balls, background, setup, membrane)
    shapes = _left_out(balls, background, setup, method or Kernel(), membrane)
    base_p, base_q, base_mm = (
        (0.0, 0.0, 0.0) if membrane is None else (membrane.p, membrane.q, membrane.height_mm)
    )
    for ball, shape in zip(balls, shapes, strict=True):
        view = ball_view(ball, setup, membrane)
        own_p, own_q = shape.slopes
        found, pressed = normals(own_p + base_p, own_q + base_q), view.pressed_slopes((base_p, base_q))
        gel_deg = normal_error_deg(found, normals(pressed[0] + base_p, pressed[1] + base_q))
        ball_deg = normal_error_deg(found, normals(*view.ball_slopes))
        inside = view.r_px < ball.contact_radius_px
        contact = view.r_px < setup.contact_radius_px(ball)
        axis_mm = setup.mm_per_px * np.hypot(view.x_px, view.y_px)
        cap = np.sqrt(np.maximum(setup.radius_mm(ball) ** 2 - axis_mm**2, 0.0)) - base_mm
        height = (shape.height_mm - cap - view.coating_mm)[contact]
        means = gel_deg[contact].mean(), ball_deg[inside].mean(), height.std()
        errors.append(LeftOut(*map(float, means)))
    return errors


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
    balls, setup, _ = known_gel(balls, background, setup)
    table = [(method, left_out_errors(balls, background, setup, method=method)) for method in methods]
    return min(table, key=lambda row: row[1].combined)[0], table


def suited(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    *,
    membrane: Membrane | None = None,
    ridges: Sequence[float] = RIDGES,
) -> tuple[Setup, Kernel]:
    """What changes of colour are best a share of, and the kernel's ridge and scale of place.

    All err least on balls left out: by the mean angle to the surface of the gel at the pixels that teach it,
    on a gel that is known.
    Parameters as `calibrate`, and the ridges to try.
    """
    tried: list[tuple[float, Setup, Kernel]] = []
    choices: tuple[Setup, ...] = (setup, setup._replace(relative_to="place"))
    for relative in choices:
        presses = ball_samples(balls, background, relative._replace(detail=0.0), membrane)[2][0]
        for scale in _POSITION_SCALES:
            kernels = [Kernel(ridge=ridge, position_scale=scale) for ridge in ridges]
            parts = [kernels[0].normal(press) for press in presses]
            for kernel in kernels:
                predictors = kernel.solve_without_each(parts)
                tried.append((_mean_error_deg(presses, predictors), relative, kernel))
    return min(tried, key=lambda each: each[0])[1:]


def _mean_error_deg(presses: Sequence[Samples], predictors: Sequence[Predictor]) -> float:
    """Mean angle between the normals that presses have and those that fits without them predict."""
    found = []
    for press, predictor in zip(presses, predictors, strict=True):
        slopes = predictor(press.signal, press.position), press.slope
        told, truth = (normals(*slope_gradients(slope).T) for slope in slopes)
        found.append(np.average(normal_error_deg(told, truth), weights=press.weight))
    return float(np.mean(found))


def _left_out(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    method: Method,
    membrane: Membrane | None,
) -> list[ReconstructedShape]:
    """Each ball as reconstructed by a calibration on the others."""
    without = calibrations_without_each(balls, background, setup, method=method, membrane=membrane)
    return [own.reconstruct(ball.image) for ball, own in zip(balls, without, strict=True)]


def calibrations_without_each(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    *,
    method: Method | None = None,
    membrane: Membrane | None = None,
) -> list[LabCalibration]:
    """Calibrations that each know nothing of one ball, on a gel that is known. Parameters as `calibrate`."""
    method = method or Kernel()
    background, spread, parts = ball_samples(balls, background, setup, membrane)
    fits = []
    for presses in parts:
        predictors = method.fit_without_each(presses)
        errors: Sequence[Predictor | None] = [None] * len(balls)
        if setup.weighted:
            errors = expected_error_without_each(presses, _predicted(predictors, presses))
        fits.append([FittedMap(*pair) for pair in zip(predictors, errors, strict=True)])
    return [_assembled(balls, background, setup, spread, own) for own in zip(*fits, strict=True)]
