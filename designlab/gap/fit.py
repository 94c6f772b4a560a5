"""Gauss-Newton fit of effect parameters, gains and poses to the shots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from designlab.effects.model import effect
from designlab.gap.linear import Free, Linear, Solver, values_of
from designlab.gap.problem import Problem, State

Array = NDArray[np.float64]

ITERATIONS = 5
SETTLED = 5e-4  # predicted fall of the mean squared residual below which a fit has converged
AT_BOUND = 0.01  # share of a parameter's range that counts as its bound


@dataclass(frozen=True, eq=False)
class Fit:
    """Result of a fit; `covariance` of the free parameters is corrected for correlation within blocks."""

    state: State
    free: tuple[Free, ...]
    covariance: Array
    objective: float
    linear: Mapping[int, Linear]

    def values(self, name: str) -> dict[str, float]:
        """Fitted values of an effect."""
        return values_of(self.state, name)

    def deviation(self, name: str) -> dict[str, float]:
        """Standard deviations of the fitted values of an effect."""
        deviations = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {
            f.parameter.name: float(d) for f, d in zip(self.free, deviations, strict=True) if f.effect == name
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
class Screened:
    """Derivatives at the start of a fit, and the fall of the mean squared residual that they predict."""

    linear: Mapping[int, Linear]
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
    solver = Solver(problem, tuple(free), tuple(shots), gains, half)
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
    """Predict the fall of the mean squared residual when parameters are freed; gains and poses follow."""
    started = _started(state, free)
    solver = Solver(problem, tuple(free), tuple(shots), gains=True, half=False)
    linear = solver.linearise(started)
    return Screened(linear, solver.step(started, linear)[1] / solver.count)


def numerical_shift(problem: Problem, found: Fit, *, shots: Sequence[int]) -> dict[tuple[str, str], float]:
    """By how much parameters would move if a finer simulation took the place of the fitted one."""
    if not found.free:
        return {}
    solver = Solver(problem, found.free, tuple(shots), gains=True, half=False)
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
    design = state.model.design
    return tuple(Free(name, parameter) for name in names for parameter in effect(name).parameters(design))


def _started(state: State, free: Sequence[Free]) -> State:
    """Add effects at their null."""
    present = {applied.name for applied in state.model.effects}
    absent: dict[str, dict[str, float]] = {}
    for f in free:
        if f.effect not in present:
            absent.setdefault(f.effect, {})[f.parameter.name] = f.parameter.null
    return state.with_values(absent)
