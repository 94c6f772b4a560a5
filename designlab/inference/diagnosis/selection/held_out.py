"""Held-out shots judge how well a state explains what it was not fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.empirical_errors import left_of_nothing
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.normal_equations import ALIKE
from designlab.inference.diagnosis.result import Level
from designlab.measurement.shots import POSE

LEAST_SHARE = 0.03  # of the initial gap: smaller gains are significant all the same, but say nothing
LEAST_IMPROVED = 0.8  # of the held-out presses
LEAST_GAP = 10.0  # misfit of a shot beyond the noise of the camera of which shares can be taken
POSES_OFF = 3.0  # mean square of departures from stated poses, in their errors, that chance hardly makes
POSES_SETTLED = 0.5  # share of it that may be left where an effect puts poses right


@dataclass(frozen=True, eq=False)
class Judged:
    """Misfit of held-out shots, poses registered.

    Attributes
    ----------
    state : State
        With the poses of these shots.
    per_shot : array, shape (shots,)
        Mean squared residual of each, in units of camera noise and white error of the simulation.
    noise : array, shape (shots,)
        What noise of the camera leaves of it.
    floor : array, shape (shots,)
        What noise of the camera and the errors granted to the simulation leave of it.
    objective : array, shape (shots,)
        Penalised misfit of each, smooth errors counted as covariance.
    least : array, shape (shots,)
        What noise of the camera leaves of that.
    poses : array, shape (4,)
        Mean squares of departures of the presses from their stated poses, in stated errors.
    """

    state: State
    per_shot: Array
    noise: Array
    floor: Array
    objective: Array
    least: Array
    poses: Array

    @property
    def gap(self) -> float:
        """Mean misfit of a shot beyond the noise of the camera."""
        return max(float((self.objective - self.least).mean()), 1.0)

    @property
    def mean(self) -> float:
        """Mean squared residual of all shots."""
        return float(self.per_shot.mean())

    @property
    def beyond_noise(self) -> float:
        """Mean squared residual beyond the noise of the camera, no less than a small share of the whole."""
        return max(self.mean - float(self.noise.mean()), LEAST_SHARE * self.mean)


@dataclass(frozen=True)
class Gain:
    """Fall of the misfit between two states as a share of the first gap, its error, share of shots improved.

    Smooth errors are counted as covariance here: a fall that they could bring about counts little. `squares`
    is the share of the plain squared residual beyond camera noise that is gone: an effect may not move error
    from where it counts to where it is granted. `settles_poses` tells whether poses that stood off what was
    stated by more than its errors do so no longer, and the residual is no larger for it by more than a small
    share of the whole: what poses take up leaves hardly any, of which no share can be asked. `own` is the
    mean of what each shot that has a gap gains as a share of its own, `own_se` its error: where few shots
    show most of an effect, the spread of the other shares is no error.
    """

    value: float
    se: float
    improved: float
    squares: float
    own: float
    own_se: float
    settles_poses: bool = False


def judge(fitter: Fitter, state: State, shots: Sequence[int]) -> Judged:
    """Register each shot by itself, with what it has alone, and compare."""
    rows = np.empty((5, len(shots)))
    for place, number in enumerate(shots):
        found = fitter.fit(state, (), [number], gains=False, held=tuple(state.values))
        state = found.state
        squares, granted = squared(fitter, state, number)
        shot, own = fitter.bank.shots[number], fitter.noises[number]
        camera = ((own.camera / own.sigma) ** 2)[shot.valid]
        rows[:, place] = squares, camera.mean(), granted, found.objective, camera.sum() / ALIKE
    per_shot, noise, floor, objective, least = rows
    return Judged(state, per_shot, noise, floor, objective, least, _departures(fitter, state, shots))


def all_leave_much(*judged: Judged) -> bool:
    """Whether every one of several states leaves more than is left where nothing is hidden."""
    return all(each.mean > left_of_nothing() * each.floor.mean() for each in judged)


def _departures(fitter: Fitter, state: State, shots: Sequence[int]) -> Array:
    """Mean squares of departures from stated poses by x, y, depth and yaw, in stated errors."""
    sigma = np.array([fitter.bank.shots[n].pose_sigma for n in shots]).reshape(-1, len(POSE))
    away = np.array([state.pose(n) for n in shots]).reshape(-1, len(POSE))
    known = sigma > 0
    squares = np.where(known, (away / np.where(known, sigma, 1.0)) ** 2, 0.0)
    return np.asarray(squares.sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def squared(fitter: Fitter, state: State, number: int) -> tuple[float, float]:
    """Mean squared residual of a shot, and what noise and granted errors would leave."""
    shot, noise = fitter.bank.shots[number], fitter.noises[number]
    left = (shot.signal - fitter.forward.predict(state, number)) / noise.sigma
    granted = (noise.granted / noise.sigma) ** 2
    return float((left[shot.valid] ** 2).mean()), float(granted[shot.valid].mean())


def level(before: Judged, after: Judged) -> Level:
    """Mean squared residuals of two states on the same shots."""
    floor = float(before.floor.mean())
    return Level(before.mean, after.mean, floor, left_of_nothing() * floor)


def gain(base: Judged, other: Judged, gap: float) -> Gain:
    """Compare two states by the spread between held-out shots; one alone shows none."""
    falls = (base.objective - other.objective) / gap
    gaps = base.objective - base.least
    own = ((base.objective - other.objective) / np.maximum(gaps, 1.0))[gaps > LEAST_GAP]
    squares = (base.mean - other.mean) / base.beyond_noise
    worst = int(np.argmax(base.poses))
    off, left = float(base.poses[worst]), float(other.poses.max())
    rises = other.mean - base.mean > LEAST_SHARE * base.mean
    settles = off > POSES_OFF and left < POSES_SETTLED * off and not rises
    return Gain(
        float(falls.mean()),
        standard_error(falls),
        float((falls > 0).mean()),
        squares,
        float(own.mean()) if own.size else 0.0,
        standard_error(own),
        settles,
    )


def standard_error(values: Array) -> float:
    """Error of the mean of several values by their spread; none of a single one."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
