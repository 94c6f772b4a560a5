"""A fine pattern that all shots carry: how strong it is, and what speaks for it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import idctn

from designlab.gap.evidence import ALIKE
from designlab.gap.fit import Fitter
from designlab.gap.forward import State
from designlab.gap.noise import SHOT_BUDGET, SMOOTH_BUDGET, spectrum, transformed

Array = NDArray[np.float64]

STRENGTHS = np.geomspace(3e-4, 0.1, 26)  # relative


class Pattern(NamedTuple):
    """Relative pattern of unit strength (rows, columns, 3), its strength, logarithm of its Bayes factor."""

    values: Array
    rms: float
    evidence: float


def found_pattern(fitter: Fitter, state: State, shots: Sequence[int]) -> Pattern:
    """Estimate a white relative pattern common to shots.

    In the coefficients of a cosine transform, what all shots have in common is noise, the smooth error that
    is granted, and the pattern, which alone is as strong in fine coefficients as in coarse ones. The strength
    is the one with the most evidence.
    """
    shape = fitter.bank.shots[shots[0]].signal.shape
    power = spectrum((shape[0], shape[1]))[..., None]
    weight, right = np.zeros(shape), np.zeros(shape)
    for number in shots:
        shot, noise = fitter.bank.shots[number], fitter.noises[number]
        if shot.signal.shape != shape or not shot.lit.any():
            continue
        left = np.where(shot.valid, (shot.signal - fitter.forward.predict(state, number)) / noise.sigma, 0.0)
        diagonal = 1.0 + (SHOT_BUDGET * noise.level) ** 2 * power
        weight += noise.level**2 / diagonal
        right += noise.level * transformed(left) / diagonal
    mean = right / weight
    smooth = 1.0 / weight + SMOOTH_BUDGET**2 * power
    evidence = [
        float((0.5 * mean**2 * (1 / smooth - 1 / (smooth + rms**2)) - 0.5 * np.log1p(rms**2 / smooth)).sum())
        for rms in STRENGTHS
    ]
    best = int(np.argmax(evidence))
    rms = float(STRENGTHS[best])
    values = idctn(mean * rms**2 / (smooth + rms**2), axes=(0, 1), norm="ortho")
    # Scanning strengths takes no more than this from the evidence.
    said = evidence[best] / ALIKE - np.log(len(STRENGTHS))
    return Pattern(np.asarray(values / rms), rms, float(said))
