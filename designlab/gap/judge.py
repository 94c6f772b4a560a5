"""How well a state explains presses it was not fitted to, and whether better than another does."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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
    """Squared residuals of held-out shots, in units of the noise, summed over blocks.

    Attributes
    ----------
    state : State
        With the poses registered on the other half of the blocks.
    sums : tuple of arrays
        For each shot, the sum over each block divided by the number of values of the shot.
    """

    state: State
    sums: tuple[Array, ...]

    @property
    def per_shot(self) -> Array:
        """Mean squared residual of each shot."""
        return np.array([part.sum() for part in self.sums])

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
    sums = []
    for number in shots:
        counts = counted(problem, number)
        square = problem.residual(state, number, variant=variant) ** 2
        label = np.broadcast_to(blocks(counts.shape)[..., None], counts.shape)[counts]
        sums.append(np.bincount(label, square[counts]) / counts.sum())
    return Judged(state, tuple(sums))


def gain(base: Judged, other: Judged) -> Gain:
    """Compare two states shot by shot; the error is that of blocks, or of presses where there are many.

    Neighbouring pixels are not independent, so blocks of pixels are what is counted.
    """
    falls = [b - o for b, o in zip(base.sums, other.sums, strict=True)]
    per_shot = np.array([fall.sum() for fall in falls])
    if len(falls) >= MANY_PRESSES:
        se = float(per_shot.std(ddof=1) / np.sqrt(len(per_shot)))
    else:
        variance = [len(fall) * fall.var(ddof=1) for fall in falls]
        se = float(np.sqrt(sum(variance)) / len(falls))
    return Gain(float(per_shot.mean()), se, float((per_shot > 0).mean()))


def threshold(found: Gain, gap: float) -> float:
    """Smallest gain that counts: twice its standard error, and a share of the gap."""
    return max(2 * found.se, LEAST_SHARE * gap)


def winning_frequency(
    base: Judged, rivals: Mapping[str, Judged], name: str, *, gap: float, seed: int
) -> float:
    """Share of bootstrap draws of held-out shots and blocks in which a candidate passes and is the best.

    It is limited by the rule of succession for the number of shots: few presses cannot make anything certain.
    No frequency of being right has been measured for it, so it ranks and is not yet a calibrated probability.
    """
    random = np.random.default_rng([seed, 11])
    names = list(rivals)
    falls = [[b - o for b, o in zip(base.sums, rivals[n].sums, strict=True)] for n in names]
    shots, own, wins = len(base.sums), names.index(name), 0
    for _ in range(BOOTSTRAPS):
        gains = np.zeros(len(names))
        for shot in random.integers(shots, size=shots):
            size = len(base.sums[shot])
            drawn = random.integers(size, size=size)
            gains += [part[shot][drawn].sum() for part in falls]
        gains /= shots
        wins += bool(gains[own] >= gains.max() and gains[own] >= LEAST_SHARE * gap)
    improved = int((base.per_shot > rivals[name].per_shot).sum())
    return min((wins + 1) / (BOOTSTRAPS + 2), (improved + 1) / (shots + 2))


def without_poses(state: State) -> State:
    """Put every press back to its nominal pose."""
    return replace(state, poses={})
