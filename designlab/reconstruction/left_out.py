"""Errors on balls left out of a calibration, and what is chosen by them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from designlab.core.metrics import normal_error_deg
from designlab.reconstruction.ball_samples import ball_samples, known_gel
from designlab.reconstruction.ball_view import ball_view
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.height import normals
from designlab.reconstruction.lab import ReconstructedShape, calibrations_without_each
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import Kernel, Method, Polynomial, Predictor, Samples, slope_gradients
from designlab.reconstruction.setup import Setup

RIDGES = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5)
_POSITION_SCALES = (1.4, 2.0, 2.8)  # how fast colours change with place differs from sensor to sensor


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


def left_out_errors(
    balls: Sequence[BallPress], background: ArrayLike, setup: Setup, *, method: Method | None = None
) -> LeftOut:
    """Errors on balls of a calibration on the others, means over the balls. Parameters as `lab.calibrate`."""
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
    """Errors on each ball of a calibration on the others. Parameters as `lab.calibrate`."""
    errors = []
    balls, setup, _ = known_gel(balls, background, setup, membrane)
    shapes = reconstructed_without_each(balls, background, setup, method or Kernel(), membrane)
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
        if membrane is not None:
            inside, contact = inside & membrane.seen, contact & membrane.seen
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
        See `lab.calibrate`.
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
    Parameters as `lab.calibrate`, and the ridges to try.
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


def reconstructed_without_each(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    method: Method,
    membrane: Membrane | None = None,
) -> list[ReconstructedShape]:
    """Each ball as reconstructed by a calibration on the others."""
    without = calibrations_without_each(balls, background, setup, method=method, membrane=membrane)
    seen, unseen = (None, None) if membrane is None else (membrane.seen, ~membrane.seen)
    return [
        own.reconstruct(ball.image, mask=seen, unseen=unseen, filled=ball.covered)
        for ball, own in zip(balls, without, strict=True)
    ]
