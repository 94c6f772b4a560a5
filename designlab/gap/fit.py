"""Gauss-Newton fit of effect parameters, gains and poses to the shots.

Gains enter linearly. Effects are differenced with common random numbers, and their derivatives are corrected from
step to step (Broyden 1965, doi:10.1090/S0025-5718-1965-0198670-6), so that no derivative is rendered twice.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.effects.base import Parameter
from designlab.gap.basis import Variant
from designlab.gap.problem import Problem, State, blocks, halves, weights

Array = NDArray[np.float64]

# Finite differences span a whole prior standard deviation, and only moves of half of one correct derivatives: where an
# effect moves geometry, the renderer's noise is not common to both pictures, and short steps would magnify it.
STEP_SD = 1.0
LEAST_MOVE_SD = 0.5
LONGEST_STEP_SD = 2.0
POSE_BOUND_SD = 4.0
STILL_SD = 0.02  # a pose that would move less stays, so that its picture need not be rendered again
ITERATIONS = 5
SETTLED = 1e-3  # predicted fall of the mean squared residual below which a fit has converged
AT_BOUND = 0.01  # share of a parameter's range that counts as its bound


class Free(NamedTuple):
    """A parameter of an effect that is fitted."""

    effect: str
    parameter: Parameter


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit; `covariance` of the free parameters is corrected for correlation within blocks."""

    state: State
    free: tuple[Free, ...]
    covariance: Array
    objective: float
    linear: Mapping[int, "_Linear"]

    def values(self, effect: str) -> dict[str, float]:
        """Fitted values of an effect."""
        return _values(self.state, effect)

    def deviation(self, effect: str) -> dict[str, float]:
        """Standard deviations of the fitted values of an effect."""
        deviations = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {
            f.parameter.name: float(d)
            for f, d in zip(self.free, deviations, strict=True)
            if f.effect == effect
        }

    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters that ended at a bound of their physical range."""
        found = []
        for free in self.free:
            p, value = free.parameter, self.values(free.effect)[free.parameter.name]
            if min(value - p.low, p.high - value) < AT_BOUND * (p.high - p.low):
                found.append(p.name)
        return tuple(found)


@dataclass(frozen=True, eq=False)
class _Linear:
    """Whitened residual and derivatives of one shot: by free parameters, gains and the pose's free parts."""

    residual: Array
    by_parameter: Array
    by_gain: Array
    by_pose: Array


@dataclass(frozen=True, eq=False)
class Screened:
    """Derivatives at the start of a fit, and the fall of the mean squared residual that they predict."""

    linear: Mapping[int, _Linear]
    predicted: float


def fit(
    problem: Problem,
    state: State,
    *,
    free: Sequence[Free] = (),
    shots: Sequence[int],
    gains: bool = True,
    half: bool = False,
    iterations: int = ITERATIONS,
    start: Screened | None = None,
) -> Fit:
    """Fit free parameters, gains and poses jointly, with Gaussian priors on parameters and poses.

    Parameters
    ----------
    problem : Problem
        Shots and renderer.
    state : State
        Where to start; effects of `free` that it lacks start at their null.
    free : sequence of Free
        Effect parameters to fit.
    shots : sequence of int
        Numbers of the shots to fit to.
    gains : bool
        Whether the gains are fitted.
    half : bool
        Whether only every other block of pixels is used; the rest stays for judging.
    start : Screened, optional
        What `screen` found for the same fit, which is then not computed again.
    """
    state = _started(state, free)
    solver = _Solver(problem, tuple(free), tuple(shots), gains, half)
    linear = solver.linearise(state) if start is None else start.linear
    objective = solver.objective(state, linear)
    for _ in range(iterations):
        step, predicted = solver.step(state, linear)
        if predicted < SETTLED * solver.count:
            break
        for _ in range(4):
            moved = solver.moved(state, step)
            trial = solver.updated(state, moved, linear)
            reached = solver.objective(moved, trial)
            if reached < objective:
                break
            step = step * 0.4
        else:
            break
        fallen = objective - reached
        state, linear, objective = moved, trial, reached
        if fallen < SETTLED * solver.count:
            break
    return Fit(state, tuple(free), solver.covariance(state, linear), objective, linear)


def screen(problem: Problem, state: State, *, free: Sequence[Free], shots: Sequence[int]) -> Screened:
    """Predict by how much the mean squared residual falls when parameters are freed, gains and poses following."""
    started = _started(state, free)
    solver = _Solver(problem, tuple(free), tuple(shots), gains=True, half=False)
    linear = solver.linearise(started)
    return Screened(linear, solver.step(started, linear)[1] / solver.count)


def numerical_shift(problem: Problem, found: Fit, *, shots: Sequence[int]) -> dict[tuple[str, str], float]:
    """By how much parameters would move if a finer simulation took the place of the one they were fitted with."""
    solver = _Solver(problem, found.free, tuple(shots), gains=True, half=False)
    finer = {
        number: replace(part, residual=solver.residual(found.state, number, variant="fine"))
        for number, part in found.linear.items()
    }
    step = (
        solver.step(found.state, finer)[0].parameters - solver.step(found.state, found.linear)[0].parameters
    )
    return {
        (f.effect, f.parameter.name): float(move * f.parameter.sd)
        for f, move in zip(found.free, step, strict=True)
    }


def free_parameters(state: State, names: Sequence[str]) -> tuple[Free, ...]:
    """All parameters of some effects."""
    from designlab.effects.model import effect

    design = state.model.design
    return tuple(Free(name, parameter) for name in names for parameter in effect(name).parameters(design))


class _Solver:
    """Normal equations of one fit; poses are eliminated shot by shot."""

    def __init__(
        self, problem: Problem, free: tuple[Free, ...], shots: tuple[int, ...], gains: bool, half: bool
    ) -> None:
        self.problem, self.free, self.shots, self.gains = problem, free, shots, gains
        self.scale = np.array([f.parameter.sd for f in free])
        self.pose_sigma = {n: problem.shots[n].pose_sigma for n in shots}
        self.used = {n: problem.shots[n].valid & self._half(n, half) for n in shots}
        self.count = int(sum(used.sum() for used in self.used.values()))

    def _half(self, number: int, half: bool) -> NDArray[np.bool_]:
        shape = self.problem.shots[number].signal.shape
        return np.broadcast_to(halves(shape)[..., None] if half else np.True_, shape)

    def linearise(self, state: State) -> dict[int, _Linear]:
        """Residuals and finite differences at a state; derivatives are in units of prior standard deviations."""
        return {number: self._linearised(state, number) for number in self.shots}

    def _linearised(self, state: State, number: int) -> _Linear:
        problem = self.problem
        columns = []
        here = problem.predict(state, number)
        for free in self.free:
            p = free.parameter
            values = _values(state, free.effect)
            step = STEP_SD * p.sd * (1.0 if values[p.name] + STEP_SD * p.sd < p.high else -1.0)
            there = problem.predict(
                state.with_values({free.effect: values | {p.name: values[p.name] + step}}), number
            )
            columns.append((there - here) / (step / p.sd))
        by_parameter = np.stack(columns, axis=-1) if columns else np.zeros((*here.shape, 0))
        sigma = self.pose_sigma[number]
        by_pose = np.zeros((*here.shape, 0))
        if (sigma > 0).any():
            by_pose = problem.pose_columns(state, number)[..., sigma > 0] * sigma[sigma > 0]
        return _Linear(
            self.residual(state, number),
            self._whitened(number, by_parameter),
            self._gain_columns(state, number),
            self._whitened(number, by_pose),
        )

    def residual(self, state: State, number: int, *, variant: Variant = "value") -> Array:
        """Measured minus predicted values of a shot in units of the noise."""
        signal = self.problem.shots[number].signal
        return self._whitened(number, signal - self.problem.predict(state, number, variant=variant))

    def _gain_columns(self, state: State, number: int) -> Array:
        basis = self.problem.basis(state, number)
        mixing = weights(state, self.problem.shots[number])
        columns = np.moveaxis(mixing[:, :, None, None] * basis[None], (0, 1), (2, 3)) / state.gains
        return self._whitened(number, columns if self.gains else columns[..., :0])

    def _whitened(self, number: int, values: Array) -> Array:
        """Divide by the noise and keep the values that are used: (values, ...)."""
        used, sigma = self.used[number], self.problem.sigma[number]
        return np.asarray(values[used] / sigma[used].reshape(-1, *[1] * (values.ndim - 3)))

    def objective(self, state: State, linear: Mapping[int, _Linear]) -> float:
        """Sum of squared residuals in units of the noise, plus the priors."""
        total = float(sum((part.residual**2).sum() for part in linear.values()))
        total += float((self._departure(state) ** 2).sum())
        return total + float(sum((self._pose(state, n) ** 2).sum() for n in self.shots))

    def _departure(self, state: State) -> Array:
        """Distance of the free parameters from null in prior standard deviations."""
        return np.array(
            [
                (_values(state, f.effect)[f.parameter.name] - f.parameter.null) / f.parameter.sd
                for f in self.free
            ]
        )

    def _pose(self, state: State, number: int) -> Array:
        """Pose errors that are free, in prior standard deviations."""
        sigma = self.pose_sigma[number]
        return np.asarray(state.pose(number)[sigma > 0] / sigma[sigma > 0])

    def _reduced(
        self, state: State, linear: Mapping[int, _Linear]
    ) -> tuple[Array, Array, dict[int, tuple[Array, Array, Array]]]:
        """Normal matrix and right side of parameters and gains after eliminating poses, and what gives the poses back."""
        departure = self._departure(state)
        size = len(self.free) + (len(state.gains) if self.gains else 0)
        matrix, right = np.zeros((size, size)), np.zeros(size)
        few = len(self.free)
        matrix[range(few), range(few)] += 1.0
        right[:few] -= departure
        kept = {}
        for number, part in linear.items():
            common = np.concatenate([part.by_parameter, part.by_gain], axis=1)
            own = part.by_pose
            pose = self._pose(state, number)
            inner = own.T @ own + np.eye(len(pose))
            cross = common.T @ own
            inner_right = own.T @ part.residual - pose
            shift = np.linalg.solve(inner, np.column_stack([cross.T, inner_right]))
            matrix += common.T @ common - cross @ shift[:, :-1]
            right += common.T @ part.residual - cross @ shift[:, -1]
            kept[number] = (inner, cross, inner_right)
        return matrix, right, kept

    def step(self, state: State, linear: Mapping[int, _Linear]) -> tuple["_Step", float]:
        """Step of all unknowns, and the fall of the objective that the linear model predicts."""
        matrix, right, kept = self._reduced(state, linear)
        # A touch of damping keeps directions that nothing decides where they are.
        common: Array = np.linalg.solve(matrix + 1e-9 * np.diag(np.diag(matrix) + 1e-12), right)
        poses: dict[int, Array] = {}
        predicted = float(right @ common)
        for number, (inner, cross, inner_right) in kept.items():
            poses[number] = np.linalg.solve(inner, inner_right - cross.T @ common)
            predicted += float(inner_right @ np.linalg.solve(inner, inner_right))
        few = len(self.free)
        longest = float(np.abs(common[:few]).max(initial=0.0))
        step = _Step(common[:few], common[few:], poses)
        return step * min(1.0, LONGEST_STEP_SD / max(longest, 1e-12)), predicted

    def moved(self, state: State, step: "_Step") -> State:
        """Take a step; bounds cut it."""
        values: dict[str, dict[str, float]] = {}
        for free, change in zip(self.free, step.parameters, strict=True):
            p = free.parameter
            now = values.setdefault(free.effect, _values(state, free.effect))
            now[p.name] = float(np.clip(now[p.name] + change * p.sd, p.low, p.high))
        poses = dict(state.poses)
        for number, change in step.poses.items():
            sigma = self.pose_sigma[number]
            if np.abs(change).max(initial=0.0) < STILL_SD:
                continue
            pose = state.pose(number).copy()
            pose[sigma > 0] += change * sigma[sigma > 0]
            poses[number] = np.clip(pose, -POSE_BOUND_SD * sigma, POSE_BOUND_SD * sigma)
        gains = state.gains + step.gains if self.gains else state.gains
        return replace(state, gains=np.maximum(gains, 1e-3 * state.gains), poses=poses).with_values(values)

    def updated(self, old: State, new: State, linear: Mapping[int, _Linear]) -> dict[int, _Linear]:
        """Residuals at a new state, and derivatives corrected by what the move has shown (Broyden's rule)."""
        taken = self._departure(new) - self._departure(old)
        found = {}
        for number, part in linear.items():
            predicted = self.problem.predict(new, number)
            before = self.problem.predict(replace(old, gains=new.gains), number)
            move = np.concatenate([taken, self._pose(new, number) - self._pose(old, number)])
            derivative = np.concatenate([part.by_parameter, part.by_pose], axis=1)
            if np.linalg.norm(move) >= LEAST_MOVE_SD:
                missed = self._whitened(number, predicted - before) - derivative @ move
                derivative = derivative + np.outer(missed, move) / (move @ move)
            few = len(taken)
            found[number] = _Linear(
                self.residual(new, number),
                derivative[:, :few],
                self._gain_columns(new, number),
                derivative[:, few:],
            )
        return found

    def covariance(self, state: State, linear: Mapping[int, _Linear]) -> Array:
        """Covariance of the free parameters, from the scores of blocks of pixels: values within a block are not independent."""
        few = len(self.free)
        if not few:
            return np.zeros((0, 0))
        matrix, _, kept = self._reduced(state, linear)
        inverse = np.linalg.inv(matrix)
        scores = []
        for number, part in linear.items():
            inner, cross, _ = kept[number]
            common = np.concatenate([part.by_parameter, part.by_gain], axis=1)
            common = common - part.by_pose @ np.linalg.solve(inner, cross.T)
            shape = self.used[number].shape
            label = np.broadcast_to(blocks(shape)[..., None], shape)[self.used[number]]
            weighted = common * part.residual[:, None]
            scores.append(np.stack([np.bincount(label, column) for column in weighted.T], axis=1))
        score = np.concatenate(scores)
        middle = score.T @ score
        covariance = inverse @ (middle + np.diag(np.r_[np.ones(few), np.zeros(len(matrix) - few)])) @ inverse
        return np.asarray(covariance[:few, :few] * np.outer(self.scale, self.scale))


@dataclass(frozen=True, eq=False)
class _Step:
    """Step of free parameters and poses in prior standard deviations, and of gains."""

    parameters: Array
    gains: Array
    poses: Mapping[int, Array]

    def __mul__(self, factor: float) -> "_Step":
        return _Step(
            self.parameters * factor,
            self.gains * factor,
            {n: pose * factor for n, pose in self.poses.items()},
        )


def _values(state: State, effect: str) -> dict[str, float]:
    return dict(next(a.values for a in state.model.effects if a.name == effect))


def _started(state: State, free: Sequence[Free]) -> State:
    """Add effects at their null."""
    present = {applied.name for applied in state.model.effects}
    absent: dict[str, dict[str, float]] = {}
    for f in free:
        if f.effect not in present:
            absent.setdefault(f.effect, {})[f.parameter.name] = f.parameter.null
    return state.with_values(absent)
