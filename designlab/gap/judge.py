"""How well a state explains presses it was not fitted to, and whether better than another does."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from designlab.gap.basis import Variant
from designlab.gap.fit import fit
from designlab.gap.problem import Problem, State, blocks, halves

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_SHARE = 0.03  # of the initial gap: smaller gains are significant all the same, but say nothing
LEAST_IMPROVED = 0.8  # of the held-out presses
MANY_PRESSES = 8  # from here on the spread between presses is a better error than that between blocks
BOOTSTRAPS = 400


@dataclass(frozen=True, eq=False)
class Judged:
    """Residuals of held-out shots, in units of the noise.

    Attributes
    ----------
    state : State
        With the poses registered on the other half of the blocks.
    residuals : tuple of arrays
        For each shot, the values that count.
    block : tuple of int arrays
        For each shot, the number of the block that each value lies in.
    """

    state: State
    residuals: tuple[Array, ...]
    block: tuple[NDArray[np.int64], ...]

    @property
    def per_shot(self) -> Array:
        """Mean squared residual of each shot."""
        return np.array([float((part**2).mean()) for part in self.residuals])

    @property
    def mean(self) -> float:
        """Mean squared residual of all shots."""
        return float(self.per_shot.mean())


@dataclass(frozen=True)
class Gain:
    """Fall of the mean squared residual between two states, its standard error, share of presses improved."""

    value: float
    se: float
    improved: float


def counted(problem: Problem, number: int) -> Mask:
    """Values of a held-out shot that are judged: valid ones in blocks where its pose was not registered."""
    shot = problem.shots[number]
    if shot.press is None:
        return shot.valid
    return np.asarray(shot.valid & ~halves(shot.signal.shape)[..., None])


def judge(
    problem: Problem, state: State, shots: Sequence[int], *, register: bool = True, variant: Variant = "value"
) -> Judged:
    """Register the poses of held-out shots on half of the blocks and compare on the other half.

    Parameters
    ----------
    register : bool
        Whether poses are registered at all; where not, those of `state` hold.
    variant : str
        Which picture of the model is compared.
    """
    if register:
        state = fit(problem, state, shots=shots, gains=False, half=True).state
    residuals, label = [], []
    for number in shots:
        counts = counted(problem, number)
        residuals.append(problem.residual(state, number, variant=variant)[counts])
        label.append(np.broadcast_to(blocks(counts.shape)[..., None], counts.shape)[counts])
    return Judged(state, tuple(residuals), tuple(label))


def gain(base: Judged, other: Judged) -> Gain:
    """Compare two states; the standard error is that of noise in blocks, or the spread of many presses."""
    falls, noise = _falls(base, other)
    if len(falls) >= MANY_PRESSES:
        se = float(falls.std(ddof=1) / np.sqrt(len(falls)))
    else:
        se = float(np.sqrt((noise**2).sum()) / len(noise))
    return Gain(float(falls.mean()), se, float((falls > 0).mean()))


def _falls(base: Judged, other: Judged) -> tuple[Array, Array]:
    """Fall of the mean squared residual of each shot, and the standard error that noise gives it.

    Where residual b falls to o, its square falls by (b - o)^2 + 2 (b - o) o. If the better state is right, o
    is noise and the second term is what varies; neighbouring pixels are not independent, so it is summed over
    blocks first.
    """
    better = other if other.mean < base.mean else base
    falls, errors = [], []
    for first, second, noise, label in zip(
        base.residuals, other.residuals, better.residuals, base.block, strict=True
    ):
        falls.append(float((first**2 - second**2).mean()))
        sums = np.bincount(label, 2 * (first - second) * noise)
        errors.append(float(np.sqrt((sums**2).sum()) / len(label)))
    return np.array(falls), np.array(errors)


def threshold(found: Gain, gap: float) -> float:
    """Smallest gain that counts: twice its standard error, and a share of the gap."""
    return max(2 * found.se, LEAST_SHARE * gap)


def winning_frequency(
    base: Judged, rivals: Mapping[str, Judged], name: str, *, gap: float, seed: int
) -> float:
    """Share of bootstrap draws in which a candidate passes and is the best.

    A draw takes held-out shots anew, with replacement, and adds noise to the gain on each. The share is
    limited by the rule of succession for the number of shots: few presses cannot make anything certain. No
    frequency of being right has been measured for it, so it ranks and is not yet a calibrated probability.
    """
    random = np.random.default_rng([seed, 11])
    names, shots = list(rivals), len(base.residuals)
    compared = [_falls(base, rivals[rival]) for rival in names]
    falls, errors = (np.stack(part) for part in zip(*compared, strict=True))
    own, wins = names.index(name), 0
    for _ in range(BOOTSTRAPS):
        drawn = random.integers(shots, size=shots)
        gains = (falls[:, drawn] + errors[:, drawn] * random.standard_normal((len(names), shots))).mean(
            axis=1
        )
        wins += bool(gains[own] >= gains.max() and gains[own] >= LEAST_SHARE * gap)
    improved = int((falls[own] > 0).sum())
    return min((wins + 1) / (BOOTSTRAPS + 2), (improved + 1) / (shots + 2))
