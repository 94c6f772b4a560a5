"""Repeated pictures of the untouched gel tell how much light moves from frame to frame."""

from collections.abc import Sequence

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.noise import SHOT_BUDGET, spectrum, transformed

FEWEST = 3  # repeats that tell their spread
LEAST = 1e-4  # relative: presses differ in more than repeats do
ERRORS = np.geomspace(LEAST, 10 * SHOT_BUDGET, 200)
WHITE = 1e-3  # power of smooth errors, over their mean, below which a coefficient holds white noise alone


def shot_error(fitter: Fitter, state: State, shots: Sequence[int]) -> float:
    """Smooth error that each frame has alone, relative to its light.

    Most likely value under normal errors, between `LEAST` and ten times what is granted without repeats; that
    itself where there are less than `FEWEST`.

    Parameters
    ----------
    fitter : Fitter
        Shots and their noise.
    state : State
        What was found. Repeats are compared with each other, not with it, but for what it says that each has
        alone: bands found are no error.
    shots : sequence of int
        Shots among which repeats are looked for.
    """
    repeats = _repeats(fitter, shots)
    if len(repeats) < FEWEST:
        return SHOT_BUDGET
    rows = []
    for number in repeats:
        shot, noise = fitter.bank.shots[number], fitter.noises[number]
        scale = np.where(shot.valid, 1.0 / noise.sigma, 0.0)
        rows.append((shot.signal * scale, fitter.forward.predict(state, number) * scale))
    signal, light = (np.array(part) for part in zip(*rows, strict=True))
    typical = light.mean(axis=0)
    signal, light = signal - (light - typical), np.broadcast_to(typical, light.shape)
    # Brightness of a whole frame is a drift, an effect of its own.
    scale = (signal * light).sum(axis=(1, 2), keepdims=True) / (light**2).sum(axis=(1, 2), keepdims=True)
    alike = signal / scale
    apart = np.array([transformed(one) for one in alike - alike.mean(axis=0)], dtype=float)
    squares = (apart**2).sum(axis=0)
    freedom = len(repeats) - 1
    power = spectrum(squares.shape[:2])
    level = np.mean([fitter.noises[n].level for n in repeats], axis=0)
    white = squares[power < WHITE].mean(axis=0) / freedom
    told = power > WHITE
    told[0, 0] = False
    return most_likely(squares[told], white, level**2 * power[told][:, None], freedom)


def most_likely(squares: Array, white: Array, smooth: Array, freedom: int) -> float:
    """Error whose square times `smooth`, with `white`, is most likely the variance of normal values.

    Parameters
    ----------
    squares : array, shape (n, channels)
        Sums of their squares.
    white : array, shape (channels,)
        Variance that they have anyway.
    smooth : array, shape (n, channels)
        Variance for an error of one.
    freedom : int
        Independent values in each sum.
    """

    def logarithm(error: float) -> float:
        variance = white + error**2 * smooth
        return -0.5 * float((freedom * np.log(variance) + squares / variance).sum())

    return float(max(ERRORS, key=logarithm))


def _repeats(fitter: Fitter, shots: Sequence[int]) -> list[int]:
    """Pictures of the untouched gel under the light that most of them have."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for number in shots:
        shot = fitter.bank.shots[number]
        if shot.press is None and shot.lit.any():
            key = (*shot.lit.tolist(), shot.gel_rotation_deg, shot.view)
            alike.setdefault(key, []).append(number)
    return max(alike.values(), key=len, default=[])
