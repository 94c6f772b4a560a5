"""The fixed pattern is a fine relative pattern that all shots carry; its strength has a Bayes factor."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.fft import idctn
from scipy.optimize import minimize_scalar

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.noise import LONG_LENGTH, Noise, spectrum, transformed
from designlab.inference.diagnosis.likelihood.normal_equations import ALIKE

STRENGTHS = np.geomspace(3e-4, 0.1, 26)  # relative
FINE = 600  # strengths of a range
FEW = 0.01  # of the coefficients
COARSEST = 0.4  # of the finest frequency: a wavy gel leaves coarser patterns too, no finer ones


class Pattern(NamedTuple):
    """Relative pattern of unit strength (rows, columns, 3), its strength, logarithm of its Bayes factor."""

    values: Array
    rms: float
    evidence: float


def found_pattern(fitter: Fitter, state: State, shots: Sequence[int]) -> Pattern:
    """Estimate a white relative pattern common to shots.

    In the coefficients of a cosine transform, what all shots have in common is noise, the smooth error that
    is granted, and the pattern, which alone is as strong in fine coefficients as in coarse ones. The strength
    is the one with the most evidence; what speaks for a pattern at all are its fine coefficients.
    """
    mean, smooth = _common(fitter, state, shots)
    evidence = [_evidence(mean, smooth, rms) for rms in STRENGTHS]
    best = int(np.argmax(evidence))
    ends = STRENGTHS[[max(best - 1, 0), min(best + 1, len(STRENGTHS) - 1)]]
    found = minimize_scalar(
        lambda power: -_evidence(mean, smooth, np.exp(power)), bounds=np.log(ends), method="bounded"
    )
    rms = float(np.exp(found.x))
    values = _estimated(fitter, state, shots, rms)
    fine = _frequencies(mean.shape[:2]) >= COARSEST
    # Scanning strengths takes no more than this from the evidence.
    sure = _evidence(mean[fine], smooth[fine], rms) / ALIKE - np.log(len(STRENGTHS))
    return Pattern(values / rms, rms, float(sure))


def strengths_as_good(
    fitter: Fitter, state: State, shots: Sequence[int], *, within: float
) -> tuple[float, float]:
    """Ends of the range of strengths whose logarithm of evidence is within a distance of the greatest."""
    mean, smooth = _common(fitter, state, shots)
    powers = np.linspace(np.log(STRENGTHS[0]), np.log(STRENGTHS[-1]), FINE)
    evidence = np.array([_evidence(mean, smooth, rms) for rms in np.exp(powers)])
    good = powers[evidence >= evidence.max() - within]
    step = powers[1] - powers[0]
    return float(np.exp(good[0] - step)), float(np.exp(good[-1] + step))


def in_few_waves(values: Array) -> float:
    """Share of a pattern's fine energy that few waves hold: 0.09 of white noise, most of a moire."""
    return _held_by_few(_fine(values))


def in_few_places(values: Array) -> float:
    """Share of a pattern's fine energy that few pixels hold: 0.09 of white noise, most of a reflection."""
    return _held_by_few(idctn(_fine(values), axes=(0, 1), norm="ortho"))


def _fine(values: Array) -> Array:
    """Coefficients of a pattern, its coarse ones set to zero."""
    fine = _frequencies(values.shape[:2]) >= COARSEST
    return np.where(fine.reshape(*fine.shape, *[1] * (values.ndim - 2)), transformed(values), 0.0)


def _held_by_few(values: Array) -> float:
    energy = np.sort(values[values != 0.0] ** 2)
    return float(energy[-max(1, round(FEW * energy.size)) :].sum() / energy.sum())


def _residuals(fitter: Fitter, state: State, shots: Sequence[int]) -> Iterator[tuple[Noise, Array, Array]]:
    """Noise of each lit shot of one size, what is left of it, and its light, both in units of the noise."""
    shape = fitter.bank.shots[shots[0]].signal.shape
    for number in shots:
        shot, noise = fitter.bank.shots[number], fitter.noises[number]
        if shot.signal.shape != shape or not shot.lit.any():
            continue
        predicted = fitter.forward.predict(state, number)
        left = np.where(shot.valid, (shot.signal - predicted) / noise.sigma, 0.0)
        yield noise, left, np.where(shot.valid, (predicted - fitter.forward.black) / noise.sigma, 0.0)


def _common(fitter: Fitter, state: State, shots: Sequence[int]) -> tuple[Array, Array]:
    """Coefficients of what shots have in common relative to their light, and variances without a pattern."""
    shape = fitter.bank.shots[shots[0]].signal.shape
    weight, right = np.zeros(shape), np.zeros(shape)
    granted: Array | float = 0.0
    for noise, left, _ in _residuals(fitter, state, shots):
        level = noise.all_level
        diagonal, granted = noise.alone, _common_error(noise, state)
        weight += level**2 / diagonal
        right += level * transformed(left) / diagonal
    return right / weight, 1.0 / weight + granted


def _common_error(noise: Noise, state: State) -> Array:
    """Variance of coefficients that all shots share without a pattern, relative to the light."""
    long = spectrum(noise.sigma.shape[:2], LONG_LENGTH)
    return noise.common() + state.smooth_rms**2 * long[..., None]


def _estimated(fitter: Fitter, state: State, shots: Sequence[int], rms: float) -> Array:
    """Pattern of a known strength, pixel by pixel: bright pixels of bright shots tell most of it.

    What errors granted to the simulation may have brought about is taken out of the residuals before.
    """
    shape = fitter.bank.shots[shots[0]].signal.shape
    weight, right = np.full(shape, rms**-2), np.zeros(shape)
    for noise, left, light in _residuals(fitter, state, shots):
        variance = noise.alone + _common_error(noise, state) * noise.all_level**2
        rough = idctn(transformed(left) / variance, axes=(0, 1), norm="ortho")
        weight += light**2
        right += light * rough
    return np.asarray(right / weight)


def _evidence(mean: Array, smooth: Array, rms: float) -> float:
    """Logarithm of the Bayes factor of a pattern of some strength against none."""
    gained = 0.5 * mean**2 * (1 / smooth - 1 / (smooth + rms**2)) - 0.5 * np.log1p(rms**2 / smooth)
    return float(gained.sum())


def _frequencies(shape: tuple[int, ...]) -> Array:
    """Spatial frequencies of a cosine transform (rows, columns), over that of one step a pixel."""
    rows, columns = (np.arange(count) / count for count in shape)
    return np.hypot(rows[:, None], columns)
