"""Variable projection takes Gauss-Newton steps of nonlinear unknowns; the linear ones follow in closed form.

Golub and Pereyra 1973 (doi:10.1137/0710036), with the Jacobian that Kaufman 1975 (doi:10.1007/BF01932995)
showed to be enough: linear and other unknowns are put into one set of normal equations.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from designlab.core.types import Array
from designlab.inference.calibration.problem import DRAWS, CalibrationState, Problem
from designlab.measurement.transfer import RELATIVE_RANK, predicted

POSE_STEP = np.array([0.05, 0.05, 0.02, 0.5])  # mm, mm, mm, deg: finite differences
LONGEST = 5.0  # finite-difference steps that one Gauss-Newton step may take
DAMPING = 1e-3
LEAST_LIGHT, LEAST_CURVATURE = 1e-10, 1e-9  # keep equations solvable where two groups, or fields, look alike
# Of the mean square that is expected; 0.3 ends a search by a step of about half an error.
LEAST_GAIN, ROUGH_GAIN, FINE_GAIN = 0.3, 9.0, 0.01
STEEP = 0.5  # fall of the objective above which derivatives are good for another step
MOST_STEPS = 14
MOST_TRIES = 4
STUCK = 0.1  # of the objective, that derivatives promised where none of the tries was any better
MOST_LEVERAGE = 0.99  # of a block on its own prediction
UPPER = 0.975  # end of a 95 % interval
BLIND_SHARE = 1e-6  # of an unknown in such directions, above which pictures do not tell it


class Layout:
    """Which unknown stands where: shared fields, free poses of each shot, then transfer and floor."""

    def __init__(self, problem: Problem, numbers: Sequence[int], *, held_out: bool) -> None:
        self.shared = 0 if held_out else len(problem.fields)
        self.pose: dict[int, list[tuple[int, int]]] = {}
        size = self.shared
        for number in numbers:
            free = np.flatnonzero(problem.shots[number].pose_sigma > 0)
            self.pose[number] = [(size + k, int(part)) for k, part in enumerate(free)]
            size += len(free)
        self.moving = size
        self.groups = len(problem.imaging.names)
        self.linear = 0 if held_out else 3 * (self.groups + 1)
        self.size = size + self.linear

    def light(self, channel: int, column: int) -> int:
        """Place of a transfer (column below the number of groups) or of a floor."""
        return self.moving + channel * (self.groups + 1) + column


class FiniteDifference(NamedTuple):
    """Finite difference of one unknown: its place, its number among its kind, and what depends on it."""

    place: int
    part: int
    size: float
    alone: int | None


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations, with the residual and derivatives of each shot that they came from.

    `prior` is the part of the matrix that is known beside the pictures: fields, poses and forces.
    """

    matrix: Array
    right: Array
    prior: Array
    parts: Mapping[int, tuple[Array, list[int], Array]]


def fit(
    problem: Problem,
    state: CalibrationState,
    numbers: Sequence[int],
    *,
    held_out: bool = False,
    steps: int = MOST_STEPS,
    least_gain: float = LEAST_GAIN,
) -> tuple[CalibrationState, dict[int, Array]]:
    """Fit shared fields, poses, transfer and floor to some shots; of those held out, the poses alone.

    Parameters
    ----------
    problem, state, numbers
        Where to start from, and the shots.
    held_out : bool
        Whether their poses alone are free.
    steps : int
        Most steps.
    least_gain : float
        Fall of the objective below which the search ends.

    Returns
    -------
    state, bases
        The state found and the unit-power pictures of these shots there.
    """
    layout = Layout(problem, numbers, held_out=held_out)
    bases = problem.bases(state, numbers)
    state = replace(state if held_out else problem.lit_best(state, bases), stuck=False)
    best, damping = problem.objective(state, bases), DAMPING
    values = sum(int(problem.shots[number].valid.sum()) for number in numbers)
    slopes: dict[int, dict[int, Array]] = {}
    for _ in range(steps if layout.moving else 0):
        fresh = not slopes
        slopes = slopes or differences(problem, layout, state, bases)
        normal = linearise(problem, layout, state, bases, slopes)
        before, tries = best, 0
        least = least_gain * (1.0 if problem.weighed else best / values)
        while (tries := tries + 1) <= MOST_TRIES:
            step, hoped = _step(layout, normal, state, damping)
            if hoped < least:
                break
            trial = moved(problem, layout, state, step)
            tried = problem.bases(trial, numbers)
            trial = trial if held_out else problem.lit_best(trial, tried)
            value = problem.objective(trial, tried)
            if value < best:
                state, bases, best = replace(trial, stuck=False), tried, value
                damping /= 4
                break
            if not fresh:
                break
            damping *= 8
        else:
            state = replace(state, stuck=hoped > STUCK * best)
        if fresh and before - best < least:
            break
        if before - best < STEEP * before:
            slopes = {}
    return state, bases


def differences(
    problem: Problem, layout: Layout, state: CalibrationState, bases: Mapping[int, Array]
) -> dict[int, dict[int, Array]]:
    """Finite differences with common random numbers: of each shot, by place, pictures per unit."""
    found: dict[int, dict[int, Array]] = {}
    for number, basis in bases.items():
        found[number] = {}
        for steps in _steps(problem, layout, state, number):
            shifted = _shifted(layout, state, number, steps)
            for step in steps:
                if step.alone is None:
                    here = problem.basis(state, number, how="rough")
                    change = problem.basis(shifted, number, how="rough") - here
                else:
                    # One component alone depends on it; others were stepped with it.
                    change = np.zeros_like(basis)
                    change[step.alone] = (problem.basis(shifted, number) - basis)[step.alone]
                found[number][step.place] = change / step.size
    return found


def linearise(
    problem: Problem,
    layout: Layout,
    state: CalibrationState,
    bases: Mapping[int, Array],
    slopes: Mapping[int, Mapping[int, Array]],
) -> Normal:
    """Residuals, derivatives and the normal equations."""
    matrix, right = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
    prior = np.zeros((layout.size, layout.size))
    for place, field in enumerate(problem.fields[: layout.shared]):
        prior[place, place] = 1.0 / field.sigma**2
        right[place] -= (state.shared[place] - field.expected) * prior[place, place]
    parts = {}
    for number, basis in bases.items():
        shot, sigma, lit = problem.shots[number], problem.sigmas[number], problem.lits[number]
        places, dark = [*slopes[number]], np.zeros(3)
        changes = (predicted(state.transfer, dark, lit, slope) for slope in slopes[number].values())
        columns = [(change / sigma)[shot.valid] for change in changes]
        # As the derivatives beside them, without corrections: both span what they span in the model alone.
        usual = basis - problem.corrections.get(number, 0.0)
        for channel in range(3 if layout.linear else 0):
            for column in range(layout.groups + 1):
                light = np.zeros_like(sigma)
                light[..., channel] = 1.0 if column == layout.groups else lit[column] * usual[column]
                places.append(layout.light(channel, column))
                columns.append((light / sigma)[shot.valid])
        residual = problem.residual(state, number, basis)
        derivative = np.stack(columns, axis=1) if columns else np.zeros((len(residual), 0))
        matrix[np.ix_(places, places)] += derivative.T @ derivative
        right[places] += derivative.T @ residual
        for place, part in layout.pose[number]:
            prior[place, place] += 1.0 / shot.pose_sigma[part] ** 2
            right[place] -= state.pose(number)[part] / shot.pose_sigma[part] ** 2
        if math.isfinite(shot.force_sigma_n):
            slope = _force_slope(problem, layout, state, number)
            prior += np.outer(slope, slope)
            right += slope * problem.force_residual(state, number)
        parts[number] = (residual, places, derivative)
    return Normal(matrix + prior, right, prior, parts)


def _force_slope(problem: Problem, layout: Layout, state: CalibrationState, number: int) -> Array:
    """Derivatives of a press's force by all unknowns, over its standard deviation."""
    slope, here = np.zeros(layout.size), problem.force_n(state, number)
    for (step,) in (steps for steps in _steps(problem, layout, state, number) if len(steps) == 1):
        change = problem.force_n(_shifted(layout, state, number, [step]), number) - here
        slope[step.place] = change / step.size / problem.shots[number].force_sigma_n
    return slope


def _steps(
    problem: Problem, layout: Layout, state: CalibrationState, number: int
) -> list[list[FiniteDifference]]:
    """Finite differences of a shot; those in one list are taken together, each in a component of its own."""
    found: list[list[FiniteDifference]] = []
    apart: dict[str, list[FiniteDifference]] = {}
    share = problem.imaging.step_share
    for place in range(layout.shared):
        field = problem.fields[place]
        if not problem.sees(field, problem.shots[number]):
            continue
        up = state.shared[place] + field.step <= field.high
        alone = problem.imaging.alone(field.path)
        step = FiniteDifference(place, place, share * (field.step if up else -field.step), alone)
        if alone is None:
            found.append([step])
        else:
            apart.setdefault(field.path.replace(f".{alone}", ".*", 1), []).append(step)
    found += apart.values()
    return found + [
        [FiniteDifference(place, part, share * float(POSE_STEP[part]), None)]
        for place, part in layout.pose[number]
    ]


def _shifted(
    layout: Layout, state: CalibrationState, number: int, steps: Sequence[FiniteDifference]
) -> CalibrationState:
    shared, pose = state.shared.copy(), state.pose(number).copy()
    for step in steps:
        (shared if step.place < layout.shared else pose)[step.part] += step.size
    return replace(state, shared=shared, poses={**state.poses, number: pose})


def _active(layout: Layout, normal: Normal, state: CalibrationState) -> NDArray[np.intp]:
    """Unknowns that may move: those of the light that stand at zero may not."""
    light = np.column_stack([state.transfer, state.floor]).ravel() if layout.linear else np.zeros(0)
    free = np.concatenate([np.ones(layout.moving, dtype=bool), light > 0])
    return np.flatnonzero(free & (np.diag(normal.matrix) > 0))


def _step(layout: Layout, normal: Normal, state: CalibrationState, damping: float) -> tuple[Array, float]:
    """Damped step of what is not linear, while the light follows in closed form; the fall that it promises.

    The light is eliminated first: what it makes up for would otherwise count as curvature and slow the step
    down, that of a reflectance above all.
    """
    active = _active(layout, normal, state)
    scale = np.sqrt(np.diag(normal.matrix)[active])
    matrix = normal.matrix[np.ix_(active, active)] / np.outer(scale, scale)
    right = normal.right[active] / scale
    moving = int((active < layout.moving).sum())
    light = matrix[moving:, moving:] + LEAST_LIGHT * np.eye(len(active) - moving)
    gain = np.linalg.solve(light, matrix[moving:, :moving]).T
    left = matrix[:moving, :moving] - gain @ matrix[moving:, :moving]
    # What nothing shows stays where it is.
    own = np.maximum(np.diag(left), LEAST_CURVATURE)
    slope = right[:moving] - gain @ right[moving:]
    found = np.linalg.solve(left + np.diag(damping * own + LEAST_CURVATURE), slope)
    step = np.zeros(layout.size)
    step[active[:moving]] = found / scale[:moving]
    return step, float(2 * slope @ found - found @ left @ found)


def moved(problem: Problem, layout: Layout, state: CalibrationState, step: Array) -> CalibrationState:
    """Take a step, cut to what finite differences are good for and to the bounds."""
    shared = state.shared.copy()
    for place in range(layout.shared):
        field = problem.fields[place]
        change = np.clip(step[place], -LONGEST * field.step, LONGEST * field.step)
        shared[place] = np.clip(shared[place] + change, field.low, field.high)
    poses = dict(state.poses)
    for number, free in layout.pose.items():
        pose = state.pose(number).copy()
        for place, part in free:
            pose[part] += np.clip(step[place], -LONGEST * POSE_STEP[part], LONGEST * POSE_STEP[part])
        poses[number] = pose
    return replace(state, shared=shared, poses=poses)


def covariance(
    problem: Problem,
    layout: Layout,
    state: CalibrationState,
    bases: Mapping[int, Array],
    beside: Array | None = None,
) -> tuple[Array, Array]:
    """Covariance of all unknowns and of numbers made of them, and what the simulator's own errors add to it.

    `beside` has the gradient of each such number, (numbers, unknowns); they follow the unknowns.

    The first is a sandwich over blocks of pixels as large as errors reach: those in one block may be of any
    size and go together. Residuals of a block are less than its errors, the more it decides by itself, and
    are raised accordingly (Bell and McCaffrey 2002, CR2). Few blocks tell such an error badly: it is raised
    as Student's t is over the normal distribution at 95 %, with as many degrees of freedom as blocks decide
    a number (Carter, Schnepel and Steigerwald 2017, doi:10.1162/REST_a_00639). The second is what a
    corrected problem leaves in doubt. Both are NaN for what stands at zero, is not seen, or can be made up
    for by others exactly.
    """
    normal = linearise(problem, layout, state, bases, differences(problem, layout, state, bases))
    active = _active(layout, normal, state)
    scale = np.sqrt(np.diag(normal.matrix)[active])
    values, vectors = np.linalg.eigh(normal.matrix[np.ix_(active, active)] / np.outer(scale, scale))
    told = values > RELATIVE_RANK * values.max(initial=0.0)
    inverse = np.zeros((layout.size, layout.size))
    inverse[np.ix_(active, active)] = (
        vectors[:, told] / values[told] @ vectors[:, told].T / np.outer(scale, scale)
    )
    blind = (vectors[:, ~told] ** 2).sum(axis=1) > BLIND_SHARE
    numbers = np.eye(layout.size) if beside is None else np.vstack([np.eye(layout.size), beside])
    reach = numbers @ inverse
    middle, doubts = np.zeros_like(inverse), np.zeros((DRAWS + 1, layout.size))
    decided = [np.zeros((0, len(numbers)))]
    for number, (residual, places, derivative) in normal.parts.items():
        kept = [k for k, place in enumerate(places) if place in set(active.tolist())]
        own, columns = np.array(places)[kept], derivative[:, kept]
        blocks = _blocks(problem, number)
        score = _scores(blocks, residual, columns, inverse[np.ix_(own, own)])
        middle[np.ix_(own, own)] += score.T @ score
        moves = columns @ reach[:, own].T
        decided.append(np.array([(moves[block] ** 2).sum(axis=0) for block in blocks]))
        for doubt, error in zip(doubts, problem.doubts.get(number, ()), strict=False):
            doubt[own] += columns.T @ (problem.residual(state, number, bases[number] + error) - residual)
    untold = np.ones(layout.size, dtype=bool)
    untold[active[~blind]] = False
    known = np.where((numbers[:, untold] != 0).any(axis=1), np.nan, 1.0)
    by_few = _students_t(np.concatenate(decided))
    spread = reach @ normal.prior @ reach.T + reach @ middle @ reach.T * np.outer(by_few, by_few)
    errors = doubts @ reach.T
    return spread * np.outer(known, known), errors.T @ errors * np.outer(known, known)


def _students_t(decided: Array) -> Array:
    """Student's t over the normal distribution at 95 %, from what each block decides, (blocks, numbers)."""
    whole, squares = decided.sum(axis=0), (decided**2).sum(axis=0)
    freedom = np.divide(whole**2, squares, out=np.full(len(whole), np.inf), where=squares > 0)
    return np.asarray(stdtrit(freedom, UPPER) / ndtri(UPPER))


def _blocks(problem: Problem, number: int) -> list[NDArray[np.intp]]:
    """Numbers of the values of each block of a shot, among those that are valid."""
    shot = problem.shots[number]
    row, column = np.indices(shot.signal.shape[:2]) // problem.blocks_px[number]
    label = np.broadcast_to((row * (column.max() + 1) + column)[..., None], shot.signal.shape)[shot.valid]
    order = np.argsort(label, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _scores(blocks: Sequence[NDArray[np.intp]], residual: Array, derivative: Array, inverse: Array) -> Array:
    """Gradient of each block, (blocks, unknowns), with its residuals r as (1 - H)^(-1/2) r.

    H = J C J' is the block's own part of the hat matrix, J its derivatives, C the inverse normal matrix.
    """
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    found = []
    for block in blocks:
        # J' f(J C J') r follows from the small matrix R' J' J R with C = R R'.
        turned = derivative[block] @ root
        hat, basis = np.linalg.eigh(turned.T @ turned)
        raised = 1.0 / np.sqrt(1.0 - np.clip(hat, 0.0, MOST_LEVERAGE)) - 1.0
        inner = basis.T @ (turned.T @ residual[block])
        extra = basis @ (raised / np.maximum(hat, 1e-12) * inner)
        found.append(derivative[block].T @ (residual[block] + turned @ extra))
    return np.array(found)
