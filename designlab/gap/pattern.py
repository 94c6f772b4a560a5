"""A fine pattern that all shots carry: how strong it is, and what speaks for it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.gap.fit import Fitter
from designlab.gap.forward import State

Array = NDArray[np.float64]

STRENGTHS = np.geomspace(3e-4, 0.1, 26)  # relative


class Pattern(NamedTuple):
    """Relative pattern of unit strength (rows, columns), its strength, logarithm of its Bayes factor."""

    values: Array
    rms: float
    evidence: float


def found_pattern(fitter: Fitter, state: State, shots: Sequence[int]) -> Pattern:
    """Estimate a white relative pattern common to shots.

    Each pixel has its own factor, with a Gaussian prior about 1; its posterior and its part of the evidence
    are those of one linear unknown. The strength of the prior is the one with the most evidence.
    """
    first = fitter.bank.shots[shots[0]].signal.shape[:2]
    information, right = np.zeros(first), np.zeros(first)
    black = fitter.forward.design.camera.black_level
    for number in shots:
        shot, noise = fitter.bank.shots[number], fitter.noises[number]
        if shot.signal.shape[:2] != first or not shot.lit.any():
            continue
        predicted = fitter.forward.predict(state, number)
        light = np.where(shot.valid, (predicted - black) / noise.sigma, 0.0)
        left = np.where(shot.valid, (shot.signal - predicted) / noise.sigma, 0.0)
        information += (light**2).sum(axis=-1)
        right += (light * left).sum(axis=-1)
    evidence = [_evidence(information, right, rms) for rms in STRENGTHS]
    best = int(np.argmax(evidence))
    rms = float(STRENGTHS[best])
    values = right / (information + 1.0 / rms**2)
    # Scanning strengths takes no more than this from the evidence.
    return Pattern(values / rms, rms, float(evidence[best] - np.log(len(STRENGTHS))))


def _evidence(information: Array, right: Array, rms: float) -> float:
    matrix = 1.0 + rms**2 * information
    return float((0.5 * rms**2 * right**2 / matrix - 0.5 * np.log(matrix)).sum())
