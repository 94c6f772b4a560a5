"""Held-out shots judge how well a state explains what it was not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter, log_score
from designlab.inference.diagnosis.result import Level

CLOSED = 0.3  # squared residual beyond what is usual, below which a gap is closed
LEAST_USUAL = 0.1  # of the floor: no model leaves less
LEFT_OF_NOTHING = 0.75  # of the floor: 13 sets without grain that hide nothing left 0.51 to 0.67
USUAL = 1.05  # times what noise and grain leave: sets that hide nothing leave 1.02


@dataclass(frozen=True, eq=False)
class Judged:
    """Misfit of held-out shots, poses registered.

    Attributes
    ----------
    state : State
        With the poses of these shots.
    grainy : bool
        Whether frames have grain, as those of built sensors have. Without it no smooth error of light is
        fitted, and what the errors granted to the simulation take up counts as left.
    per_shot : array, shape (shots,)
        Mean squared residual of each, in units of camera noise and white error of the simulation.
    floor : array, shape (shots,)
        What noise of the camera, grain, and the errors granted to the simulation leave of it.
    objective : array, shape (shots,)
        Penalised misfit of each, smooth errors counted as covariance.
    least : array, shape (shots,)
        What noise of the camera and grain leave of that.
    values : array, shape (shots,)
        Number of independent values of each.
    """

    state: State
    grainy: bool
    per_shot: Array
    floor: Array
    objective: Array
    least: Array
    values: Array

    @property
    def gap(self) -> float:
        """Mean misfit of a shot beyond noise of the camera and grain."""
        return max(float((self.objective - self.least).mean()), 1.0)

    @property
    def excess(self) -> float:
        """Squared residual of a value beyond what sets that hide nothing leave, see `grainy`."""
        if not self.grainy:
            return max(float((self.per_shot - LEFT_OF_NOTHING * self.floor).mean()), 0.0)
        return max(float((self.objective - USUAL * self.least).sum() / self.values.sum()), 0.0)

    @property
    def mean(self) -> float:
        """Mean squared residual of all shots."""
        return float(self.per_shot.mean())

    @property
    def scores(self) -> Array:
        """Log score of each shot."""
        return log_score(self.objective, self.values)

    @property
    def lost(self) -> Array:
        """Log score that each shot lacks of one which leaves no more than noise."""
        return log_score(self.least, self.values) - self.scores


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A model where a fit has left it, with the pictures that were combined for it."""

    fitter: Fitter
    fit: Fit

    @property
    def state(self) -> State:
        """Where the fit ended."""
        return self.fit.state


@dataclass(frozen=True, eq=False)
class Stand(FittedModel):
    """A model fitted to some shots, and held-out shots judged by it."""

    train: Sequence[int]
    judged: Judged

    @property
    def score(self) -> float:
        """Log score of the shots fitted to."""
        _, values = self.fitter.chance(self.train)
        return float(log_score(self.fit.objective, values))


@dataclass(frozen=True)
class Gain:
    """Fall of the misfit between two states as a share of the first gap, its error, share of shots improved.

    Smooth errors are counted as covariance here: a fall that they could bring about counts little.
    """

    value: float
    se: float
    improved: float


def judge(fitter: Fitter, fit: Fit, shots: Sequence[int]) -> Judged:
    """Register each shot by itself, with what it has alone, and compare.

    What the shots fitted to show of the error that all share is known then: counted for each shot anew, it
    would be evidence as often as there are shots.
    """
    rows = np.empty((5, len(shots)))
    own, state = fitter.given(fit.system.shared), fit.state
    for place, number in enumerate(shots):
        found = own.fit(state, (), [number], gains=False, held=tuple(state.values))
        state = found.state
        least, values = fitter.chance([number])
        squares, granted = squared(fitter, state, number)
        rows[:, place] = squares, granted, found.objective, least, values
    return Judged(state, fitter.grain > 0, *rows)


def all_leave_much(*judged: Judged) -> bool:
    """Whether every one of several states leaves more than is left where nothing is hidden."""
    return all(each.excess > 0 for each in judged)


def squared(fitter: Fitter, state: State, number: int) -> tuple[float, float]:
    """Mean squared residual of a shot, and what noise and granted errors would leave."""
    shot, noise = fitter.bank.shots[number], fitter.noises[number]
    left = (shot.signal - fitter.forward.predict(state, number)) / noise.sigma
    granted = (noise.granted / noise.sigma) ** 2
    return float((left[shot.valid] ** 2).mean()), float(granted[shot.valid].mean())


def level(before: Judged, after: Judged, *, corrected: Judged | None = None) -> Level:
    """Mean squared residuals of two states on the same shots.

    Usual is what the corrected model, which is the second unless it is given, leaves but for its excess.
    """
    best, floor = corrected or after, float(before.floor.mean())
    return Level(before.mean, after.mean, floor, max(best.mean - best.excess, LEAST_USUAL * floor))


def gain(base: Judged, other: Judged, gap: float) -> Gain:
    """Compare two states by the spread between held-out shots; one alone shows none."""
    falls = (base.objective - other.objective) / gap
    return Gain(float(falls.mean()), standard_error(falls), float((falls > 0).mean()))


def standard_error(values: Array) -> float:
    """Error of the mean of several values by their spread; none of a single one."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
