"""Linear model of one fit: derivatives of all shots, the normal equations, and the step that they give.

Effects are differenced with common random numbers; their derivatives are corrected from step to step (Broyden
1965, doi:10.1090/S0025-5718-1965-0198670-6), so that none is rendered twice.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.effects.base import Parameter
from designlab.gap.basis import Variant
from designlab.gap.problem import Problem, State, blocks, halves, weights

Array = NDArray[np.float64]

# Finite differences span a whole prior standard deviation, and only moves of half of one correct derivatives:
# where an effect moves geometry, the renderer's noise differs between pictures, and short steps magnify it.
STEP_SD = 1.0
LEAST_MOVE_SD = 0.5
LONGEST_STEP_SD = 2.0
POSE_BOUND_SD = 4.0
STILL_SD = 0.02  # a pose that would move less stays, so that its picture need not be rendered again


class Free(NamedTuple):
    """A parameter of an effect that is fitted."""

    effect: str
    parameter: Parameter


@dataclass(frozen=True, eq=False)
class Linear:
    """Whitened residual and derivatives of one shot: by free parameters, gains and the pose's free parts."""

    residual: Array
    by_parameter: Array
    by_gain: Array
    by_pose: Array


class Solver:
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

    def linearise(self, state: State) -> dict[int, Linear]:
        """Residuals and finite differences at a state, the latter per prior standard deviation."""
        return {number: self._linearised(state, number) for number in self.shots}

    def _linearised(self, state: State, number: int) -> Linear:
        problem = self.problem
        columns = []
        here = problem.predict(state, number)
        for free in self.free:
            p = free.parameter
            values = values_of(state, free.effect)
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
        return Linear(
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

    def objective(self, state: State, linear: Mapping[int, Linear]) -> float:
        """Sum of squared residuals in units of the noise, plus the priors."""
        total = float(sum((part.residual**2).sum() for part in linear.values()))
        total += float((self._departure(state) ** 2).sum())
        return total + float(sum((self._pose(state, n) ** 2).sum() for n in self.shots))

    def _departure(self, state: State) -> Array:
        """Distance of the free parameters from null in prior standard deviations."""
        return np.array(
            [
                (values_of(state, f.effect)[f.parameter.name] - f.parameter.null) / f.parameter.sd
                for f in self.free
            ]
        )

    def _pose(self, state: State, number: int) -> Array:
        """Pose errors that are free, in prior standard deviations."""
        sigma = self.pose_sigma[number]
        return np.asarray(state.pose(number)[sigma > 0] / sigma[sigma > 0])

    def _reduced(
        self, state: State, linear: Mapping[int, Linear]
    ) -> tuple[Array, Array, dict[int, tuple[Array, Array, Array]]]:
        """Normal equations of parameters and gains after eliminating poses, and what gives poses back."""
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

    def step(self, state: State, linear: Mapping[int, Linear]) -> tuple["Step", float]:
        """Step of all unknowns, and the fall of the objective that the linear model predicts."""
        matrix, right, kept = self._reduced(state, linear)
        # A touch of damping keeps directions that nothing decides where they are.
        damped = matrix + 1e-9 * np.diag(np.diag(matrix) + 1e-12)
        common = np.asarray(np.linalg.solve(damped, right), dtype=float)
        poses: dict[int, Array] = {}
        predicted = float(right @ common)
        for number, (inner, cross, inner_right) in kept.items():
            poses[number] = np.asarray(np.linalg.solve(inner, inner_right - cross.T @ common), dtype=float)
            predicted += float(inner_right @ np.linalg.solve(inner, inner_right))
        few = len(self.free)
        longest = float(np.abs(common[:few]).max(initial=0.0))
        step = Step(common[:few], common[few:], poses)
        return step * min(1.0, LONGEST_STEP_SD / max(longest, 1e-12)), predicted

    def moved(self, state: State, step: "Step") -> State:
        """Take a step; bounds cut it."""
        values: dict[str, dict[str, float]] = {}
        for free, change in zip(self.free, step.parameters, strict=True):
            p = free.parameter
            now = values.setdefault(free.effect, values_of(state, free.effect))
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

    def updated(self, old: State, new: State, linear: Mapping[int, Linear]) -> dict[int, Linear]:
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
            found[number] = Linear(
                self.residual(new, number),
                derivative[:, :few],
                self._gain_columns(new, number),
                derivative[:, few:],
            )
        return found

    def covariance(self, state: State, linear: Mapping[int, Linear]) -> Array:
        """Covariance of the free parameters, from the scores of blocks: pixels in one are not independent."""
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
class Step:
    """Step of free parameters and poses in prior standard deviations, and of gains."""

    parameters: Array
    gains: Array
    poses: Mapping[int, Array]

    def __mul__(self, factor: float) -> "Step":
        return Step(
            self.parameters * factor,
            self.gains * factor,
            {n: pose * factor for n, pose in self.poses.items()},
        )


def values_of(state: State, effect: str) -> dict[str, float]:
    """Values of the parameters of an effect."""
    return dict(next(a.values for a in state.model.effects if a.name == effect))
