"""Where balls are: by their circles and the geometry of the sensor, and by their own normals."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from designlab.reconstruction.ball_samples import known_gel
from designlab.reconstruction.ball_view import ball_view
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.height import gradients_of, normals
from designlab.reconstruction.left_out import reconstructed_without_each
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import Method, Polynomial
from designlab.reconstruction.setup import Setup

_PLACINGS = 3  # of an axis by its circle


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
        See `lab.calibrate`.
    """
    gel = known_gel(balls, background, setup, membrane).setup
    placed = []
    for ball in balls:
        circle_px = membrane.touched_from(ball.centre_px, setup.radius_px(ball))
        placed.append(placed_by_circle(ball, circle_px, gel, membrane))
    return placed


def placed_by_circle(
    ball: BallPress, circle_px: tuple[float, float], setup: Setup, membrane: Membrane
) -> BallPress:
    """Move a ball's axis to where the rim of its contact is seen about the middle of a circle.

    A camera sees the rim, which is lifted, further out than the gel below it.

    Parameters
    ----------
    ball : BallPress
        With a first axis; its contact radius is that of the circle.
    circle_px : pair of float
        Column and row of the middle of the circle on the membrane's grid.
    setup : Setup
        Of a known gel.
    membrane : Membrane
        The undeformed membrane.
    """
    rows, columns = (np.asarray(axis) for axis in np.indices(membrane.seen.shape))
    # of circles that the border cuts, the parts within it are compared
    circle = membrane.seen & (np.hypot(columns - circle_px[0], rows - circle_px[1]) < ball.contact_radius_px)
    for _ in range(_PLACINGS):
        shown = membrane.seen & (ball_view(ball, setup, membrane).r_px < ball.contact_radius_px)
        if not (circle.any() and shown.any()):
            return ball  # beside the gel, which `lab.calibrate` refuses by name
        right = float(columns[circle].mean() - columns[shown].mean())
        down = float(rows[circle].mean() - rows[shown].mean())
        ball = ball.moved((ball.centre_px[0] + right, ball.centre_px[1] + down))
    return ball


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
    one read off, and so on.

    Balls left out cannot tell that all balls shrink towards a point, or shift alike, since colours change
    with place. Where the geometry is known, `place_by_circles` errs less.

    Parameters
    ----------
    balls, background, setup
        See `lab.calibrate`.
    method : Method, optional
        See `methods`; `Polynomial()` when absent, which is quick.
    rounds : int
        Times that all balls are moved.
    """
    method = method or Polynomial()
    moving, known, _ = known_gel(balls, background, setup)
    plain = known._replace(detail=0.0, weighted=False)
    for _ in range(rounds):
        moved = []
        shapes = reconstructed_without_each(moving, background, plain, method)
        for ball, shape in zip(moving, shapes, strict=True):
            # slopes of the height alone, which lean less on where the labels of the others have their balls
            p, q = gradients_of(shape.height_mm, pitch_mm=setup.mm_per_px)
            normal, reach_px = normals(p, q), setup.radius_px(ball)
            view = ball_view(ball, known)
            near = view.r_px < known.contact_radius_px(ball)
            if ball.covered is not None:
                near &= ~ball.covered
            if not near.any():
                moved.append(ball)
                continue
            column = ball.centre_px[0] + np.median((view.x_px - normal[..., 0] * reach_px)[near])
            row = ball.centre_px[1] - np.median((view.y_px - normal[..., 1] * reach_px)[near])
            moved.append(ball.moved((float(column), float(row))))
        moving = moved
    return [ball.moved(place.centre_px) for ball, place in zip(balls, moving, strict=True)]
