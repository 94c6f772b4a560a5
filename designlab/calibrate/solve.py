"""Variable projection: Gauss-Newton steps of what is not linear, the rest in closed form after each.

Golub and Pereyra 1973 (doi:10.1137/0710036), with the Jacobian that Kaufman 1975 (doi:10.1007/BF01932995)
showed to be enough: linear and other unknowns are put into one set of normal equations.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.calibrate.problem import Problem, State

Array = NDArray[np.float64]

POSE_STEP = np.array([0.05, 0.05, 0.02, 0.5])  # mm, mm, mm, deg: finite differences
LONGEST = 5.0  # finite-difference steps that one Gauss-Newton step may take
DAMPING = 1e-3
MOST_DAMPING = 1e3
BLOCK_PX = 8
MOST_LEVERAGE = 0.99  # of a block on its own prediction
RELATIVE_RANK = 1e-13  # eigenvalue over the largest, below which pictures do not change in a direction
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


class Step(NamedTuple):
    """Finite difference of one unknown: its place, its number among its kind, and what depends on it."""

    place: int
    part: int
    size: float
    alone: int | None


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations, with the residual and derivatives of each shot that they came from."""

    matrix: Array
    right: Array
    prior: Array
    parts: Mapping[int, tuple[Array, list[int], Array]]


def fit(
    problem: Problem,
    state: State,
    numbers: Sequence[int],
    *,
    held_out: bool = False,
    steps: int | None = None,
) -> tuple[State, dict[int, Array]]:
    """Fit shared fields, poses, transfer and floor to some shots; of those held out, the poses alone.

    Returns
    -------
    state, bases
        The state found and the unit-power pictures of these shots there.
    """
    layout = Layout(problem, numbers, held_out=held_out)
    bases = problem.bases(state, numbers)
    state = state if held_out else problem.lit_best(state, bases)
    best, damping = problem.objective(state, bases), DAMPING
    search = problem.imaging.search
    most = search.most_steps if steps is None else steps
    for _ in range(most if layout.moving else 0):
        normal = linearise(problem, layout, state, bases)
        before = best
        while damping <= MOST_DAMPING:
            trial = moved(problem, layout, state, _step(layout, normal, state, damping))
            tried = problem.bases(trial, numbers)
            trial = trial if held_out else problem.lit_best(trial, tried)
            value = problem.objective(trial, tried)
            if value < best:
                state, bases, best = trial, tried, value
                damping /= 4
                break
            damping *= 8
        if before - best < search.least_gain * before:
            break
    return state, bases


def linearise(problem: Problem, layout: Layout, state: State, bases: Mapping[int, Array]) -> Normal:
    """Residuals, finite differences with common random numbers, and the normal equations."""
    matrix, right = np.zeros((layout.size, layout.size)), np.zeros(layout.size)
    prior = np.zeros(layout.size)
    parts = {}
    for number, basis in bases.items():
        shot, sigma, lit = problem.shots[number], problem.sigmas[number], problem.lits[number]
        here = problem.predict(state, number, basis)
        places, columns = [], []
        for steps in _steps(problem, layout, state, number):
            there = problem.basis(_shifted(layout, state, number, steps), number)
            for step in steps:
                # Where one component alone depends on a number, others may have been stepped with it.
                moved = there if step.alone is None else _exchanged(basis, there, step.alone)
                change = problem.predict(state, number, moved) - here
                places.append(step.place)
                columns.append((change / (step.size * sigma))[shot.valid])
        for channel in range(3 if layout.linear else 0):
            for column in range(layout.groups + 1):
                light = np.zeros_like(here)
                light[..., channel] = 1.0 if column == layout.groups else lit[column] * basis[column]
                places.append(layout.light(channel, column))
                columns.append((light / sigma)[shot.valid])
        residual = problem.residual(state, number, basis)
        derivative = np.stack(columns, axis=1) if columns else np.zeros((len(residual), 0))
        matrix[np.ix_(places, places)] += derivative.T @ derivative
        right[places] += derivative.T @ residual
        for place, part in layout.pose[number]:
            prior[place] = 1.0 / shot.pose_sigma[part] ** 2
            right[place] -= state.pose(number)[part] * prior[place]
        parts[number] = (residual, places, derivative)
    return Normal(matrix + np.diag(prior), right, prior, parts)


def _steps(problem: Problem, layout: Layout, state: State, number: int) -> list[list[Step]]:
    """Finite differences of a shot; those in one list are taken together, each in a component of its own."""
    found: list[list[Step]] = []
    apart: dict[str, list[Step]] = {}
    share = problem.imaging.search.step_share
    for place in range(layout.shared):
        field = problem.fields[place]
        if not problem.imaging.sees(field.path, problem.shots[number]):
            continue
        up = state.shared[place] + field.step <= field.high
        alone = problem.imaging.alone(field.path)
        step = Step(place, place, share * (field.step if up else -field.step), alone)
        if alone is None:
            found.append([step])
        else:
            apart.setdefault(field.path.replace(f".{alone}", ".*", 1), []).append(step)
    found += apart.values()
    return found + [
        [Step(place, part, share * float(POSE_STEP[part]), None)] for place, part in layout.pose[number]
    ]


def _shifted(layout: Layout, state: State, number: int, steps: Sequence[Step]) -> State:
    shared, pose = state.shared.copy(), state.pose(number).copy()
    for step in steps:
        (shared if step.place < layout.shared else pose)[step.part] += step.size
    return replace(state, shared=shared, poses={**state.poses, number: pose})


def _exchanged(basis: Array, other: Array, component: int) -> Array:
    found = basis.copy()
    found[component] = other[component]
    return found


def _active(layout: Layout, normal: Normal, state: State) -> NDArray[np.intp]:
    """Unknowns that may move: those of the light that stand at zero may not."""
    light = np.column_stack([state.transfer, state.floor]).ravel() if layout.linear else np.zeros(0)
    free = np.concatenate([np.ones(layout.moving, dtype=bool), light > 0])
    return np.flatnonzero(free & (np.diag(normal.matrix) > 0))


def _step(layout: Layout, normal: Normal, state: State, damping: float) -> Array:
    """Damped step of what is not linear; light follows in closed form, so it is not damped."""
    active = _active(layout, normal, state)
    scale = np.sqrt(np.diag(normal.matrix)[active])
    matrix = normal.matrix[np.ix_(active, active)] / np.outer(scale, scale)
    # A touch on the light keeps the equations solvable where two groups look alike.
    extra = np.where(active < layout.moving, damping, 1e-10)
    step = np.zeros(layout.size)
    step[active] = np.linalg.solve(matrix + np.diag(extra), normal.right[active] / scale) / scale
    return step


def moved(problem: Problem, layout: Layout, state: State, step: Array) -> State:
    """Take a step, cut to what finite differences are good for and to the bounds."""
    shared = state.shared.copy()
    for place in range(layout.shared):
        field = problem.fields[place]
        longest = LONGEST * field.step
        shared[place] = np.clip(
            shared[place] + np.clip(step[place], -longest, longest), field.low, field.high
        )
    poses = dict(state.poses)
    for number, free in layout.pose.items():
        pose = state.pose(number).copy()
        for place, part in free:
            pose[part] += np.clip(step[place], -LONGEST * POSE_STEP[part], LONGEST * POSE_STEP[part])
        poses[number] = pose
    return replace(state, shared=shared, poses=poses)


def covariance(
    problem: Problem, layout: Layout, state: State, bases: Mapping[int, Array]
) -> tuple[Array, Array]:
    """Covariance of all unknowns, and by how much other random numbers of the simulator shift each.

    The first is a sandwich over blocks of `BLOCK_PX` squared pixels: errors in one block may be of any size
    and go together. Residuals of a block are less than its errors, the more it decides by itself, and are
    raised accordingly (Bell and McCaffrey 2002, CR2). The second is from one simulation with other random
    numbers. Both are NaN for what stands at zero, is not seen, or can be made up for by others exactly.
    """
    normal = linearise(problem, layout, state, bases)
    active = _active(layout, normal, state)
    scale = np.sqrt(np.diag(normal.matrix)[active])
    values, vectors = np.linalg.eigh(normal.matrix[np.ix_(active, active)] / np.outer(scale, scale))
    told = values > RELATIVE_RANK * values.max(initial=0.0)
    inverse = np.zeros((layout.size, layout.size))
    inverse[np.ix_(active, active)] = (
        vectors[:, told] / values[told] @ vectors[:, told].T / np.outer(scale, scale)
    )
    blind = (vectors[:, ~told] ** 2).sum(axis=1) > BLIND_SHARE
    middle, shift = np.diag(normal.prior), np.zeros(layout.size)
    for number, (residual, places, derivative) in normal.parts.items():
        kept = [k for k, place in enumerate(places) if place in set(active.tolist())]
        own, columns = np.array(places)[kept], derivative[:, kept]
        score = _scores(problem, number, residual, columns, inverse[np.ix_(own, own)])
        middle[np.ix_(own, own)] += score.T @ score
        other = problem.residual(state, number, problem.basis(state, number, other_seed=True))
        shift[own] += columns.T @ (other - residual)
    unknown = np.full(layout.size, np.nan)
    unknown[active[~blind]] = 1.0
    return inverse @ middle @ inverse * np.outer(unknown, unknown), inverse @ shift * unknown


def _scores(problem: Problem, number: int, residual: Array, derivative: Array, inverse: Array) -> Array:
    """Gradient of each block of a shot, (blocks, unknowns), with its residuals r as (1 - H)^(-1/2) r.

    H = J C J' is the block's own part of the hat matrix, J its derivatives, C the inverse normal matrix.
    """
    shot = problem.shots[number]
    row, column = np.indices(shot.signal.shape[:2]) // BLOCK_PX
    label = np.broadcast_to((row * (column.max() + 1) + column)[..., None], shot.signal.shape)[shot.valid]
    order = np.argsort(label, kind="stable")
    edges = np.flatnonzero(np.diff(label[order])) + 1
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    found = []
    for block in np.split(order, edges):
        # J' f(J C J') r follows from the small matrix R' J' J R with C = R R'.
        turned = derivative[block] @ root
        hat, basis = np.linalg.eigh(turned.T @ turned)
        raised = 1.0 / np.sqrt(1.0 - np.clip(hat, 0.0, MOST_LEVERAGE)) - 1.0
        inner = basis.T @ (turned.T @ residual[block])
        extra = basis @ (raised / np.maximum(hat, 1e-12) * inner)
        found.append(derivative[block].T @ (residual[block] + turned @ extra))
    return np.array(found)
