"""What no model can explain: noise of the camera, noise of the renderer, and the renderer's own error."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, gaussian_laplace

from designlab.gap.basis import Renders
from designlab.gap.problem import Problem, State, blocks, mixed, weights
from designlab.measurement.shots import Shot

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Budget of the simulation's own error, systematic: a share of the signal, and a share of its curvature per
# squared pixel, which is what sampling within a pixel and the membrane's mesh get wrong at sharp edges. Two
# programs that share no code agree to 0.1 % (rms) on balls and differ by 2 % of the curvature at a triangle.
SIGNAL_BUDGET = 0.0015
EDGE_BUDGET = 0.02
SMOOTHING_PX = 2.0  # the renderer's variance is taken from one pair of pictures, so neighbours are averaged
EDGE_WIDTH_PX = 0.7
NULLS = 60
ENVELOPE = 0.95


@dataclass(frozen=True, eq=False)
class Floor:
    """Mean squared residual of a perfect model in units of the noise: mean and upper end of its range."""

    mean: float
    envelope: float


def problem(renders: Renders, shots: tuple[Shot, ...], state: State) -> tuple[Problem, State]:
    """Set up the comparison: first gains, and the standard deviation of every value.

    The renderer's variance is half the squared difference of two pictures with other random numbers, averaged
    over the neighbours of each pixel without itself: no value is judged by a variance it took part in.

    Raises
    ------
    ValueError
        If the light of a group does not fit the measurement at all.
    """
    camera_only = Problem(renders, shots, tuple(np.sqrt(shot.variance) for shot in shots), (), ())
    state = replace(state, gains=_first_gains(camera_only, state))
    pairs = [
        [camera_only.basis(state, number, variant=variant) for variant in ("value", "repeat")]
        for number in range(len(shots))
    ]
    spread = tuple(first - second for first, second in pairs)
    budget = tuple(_budget(camera_only.predict(state, number)) for number in range(len(shots)))
    sigma = [
        np.sqrt(shot.variance + _neighbours(mixed(weights(state, shot), part) ** 2 / 2) + own**2)
        for shot, part, own in zip(shots, spread, budget, strict=True)
    ]
    return Problem(renders, shots, tuple(sigma), spread, budget), state


def _budget(signal: Array) -> Array:
    """Systematic error granted to the simulation, (rows, columns, 3)."""
    curvature = np.stack([gaussian_laplace(signal[..., c], EDGE_WIDTH_PX) for c in range(3)], axis=-1)
    return np.asarray(np.hypot(SIGNAL_BUDGET * signal, EDGE_BUDGET * curvature))


def _neighbours(values: Array) -> Array:
    """Gaussian average of the neighbours of each pixel, without the pixel itself, (rows, columns, 3)."""
    width = (SMOOTHING_PX, SMOOTHING_PX, 0)
    point = np.zeros((*values.shape[:2], 1))
    point[values.shape[0] // 2, values.shape[1] // 2] = 1.0
    own = float(gaussian_filter(point, width).max())
    return np.asarray((gaussian_filter(values, width) - own * values) / (1 - own)).clip(0.0)


def _first_gains(problem: Problem, state: State) -> Array:
    """Gains by linear least squares over the untouched gel and the training presses at nominal poses."""
    groups = len(state.model.design.leds.groups)
    matrix, right = np.zeros((groups, groups)), np.zeros(groups)
    unit = replace(state, gains=np.ones(groups))
    for number, shot in enumerate(problem.shots):
        if shot.use not in ("background", "train"):
            continue
        mixing, basis = weights(unit, shot), problem.basis(unit, number)
        columns = np.moveaxis(mixing[:, :, None, None] * basis[None], (0, 1), (2, 3))[shot.valid]
        # By brightness, not by the camera's noise: a wrong model must not let dark values decide.
        signal = shot.signal[shot.valid]
        matrix += columns.T @ columns
        right += columns.T @ signal
    gains = np.linalg.solve(matrix, right)
    for name, gain in zip(state.model.design.group_names, gains, strict=True):
        if not gain > 0:
            raise ValueError(
                f"model: the light of LED group {name!r} fits the measurement only with the negative gain "
                f"{gain:.3g}; are the groups, their places or the colour channels mixed up?"
            )
    return np.asarray(gains)


def floor(
    problem: Problem, state: State, shots: Sequence[int], judged: Sequence[Mask], *, seed: int
) -> Floor:
    """Range of the mean squared residual under parametric nulls: camera noise, renderer noise, error budget.

    Parameters
    ----------
    judged : sequence of bool arrays
        Values of each shot that count, (rows, columns, 3).
    """
    random = np.random.default_rng([seed, 7])
    means = np.empty((NULLS, len(shots)))
    for place, number in enumerate(shots):
        shot, sigma, counts = problem.shots[number], problem.sigma[number], judged[place]
        camera = np.sqrt(shot.variance) / sigma
        own = problem.budget[number] / sigma
        renderer = mixed(weights(state, shot), problem.spread[number]) / np.sqrt(2.0) / sigma
        label = blocks(counts.shape)
        for null in range(NULLS):
            # Errors of the simulation keep their shape within a block; their signs in each are drawn.
            signs = random.choice((-1.0, 1.0), (2, label.max() + 1))[:, label][..., None]
            drawn = camera * random.standard_normal(counts.shape) + signs[0] * renderer + signs[1] * own
            means[null, place] = (drawn[counts] ** 2).mean()
    totals = means.mean(axis=1)
    return Floor(float(totals.mean()), float(np.quantile(totals, ENVELOPE)))
