"""Monte Carlo noise of simulated pictures is known from repeated pictures where light is counted in photons.

In air it is below the error that every simulation is granted. Behind a core it is not, but photons that are
lost in one picture are lost in nearly all: a fit that knows so can still tell a per cent from nothing.
"""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.noise import DARK_LIGHT, MonteCarloNoise
from designlab.simulation.render.denoising import bands, by_band, coefficients

SMOOTHING_PX = 3.0  # few repeats tell a variance only over a neighbourhood


def monte_carlo_noise(forward: Forward, state: State) -> list[MonteCarloNoise | None]:
    """Monte Carlo noise of every shot of a bank; None where pictures were not repeated.

    Shots with all LED groups on tell its power and what all have in common: the covariance of the presses
    with the untouched gel.
    """
    found: list[MonteCarloNoise | None] = [None] * len(forward.bank.shots)
    repeated = {n: away for n in range(len(found)) if (away := _deviations(forward, state, n)) is not None}
    for shape in {away.shape for away in repeated.values()}:
        ours = {n: away for n, away in repeated.items() if away.shape == shape}
        relative = {
            n: away / np.hypot(_light(forward, state, n), DARK_LIGHT)
            for n, away in ours.items()
            if forward.bank.shots[n].lit.all()
        }
        if not relative:
            continue
        power, shared = _power(relative.values()), _shared(forward, relative)
        for n, away in ours.items():
            variance = gaussian_filter((away**2).sum(axis=0), (SMOOTHING_PX, SMOOTHING_PX, 0))
            found[n] = MonteCarloNoise(np.sqrt(variance), shared, power)
    return found


def _deviations(forward: Forward, state: State, number: int) -> Array | None:
    """Deviations of repeats, scaled so that their squares add up to the variance of the mean.

    Shape (repeats, rows, columns, 3).
    """
    picture = forward.bank.of(number)
    if picture.spread is None:
        return None
    spread = picture.spread[:, :, *picture.place]
    repeats = len(spread)
    channels = np.tensordot(forward.weights(state, number), spread, axes=([1], [1]))
    return np.asarray(np.moveaxis(channels, 0, -1) / np.sqrt(repeats * (repeats - 1)))


def _light(forward: Forward, state: State, number: int) -> Array:
    picture = forward.bank.of(number)
    channels = np.tensordot(forward.weights(state, number), picture.light[:, *picture.place], axes=1)
    return np.asarray(np.moveaxis(channels, 0, -1))


def _power(relative: Iterable[Array]) -> Array:
    """Power over the coefficients of a cosine transform, one in the mean, equal in all directions."""
    squares = np.mean(
        [(coefficients(np.moveaxis(each, -1, 0)) ** 2).sum(axis=(0, 1)) for each in relative], axis=0
    )
    power = by_band(squares)[bands((squares.shape[0], squares.shape[1]))]
    return np.asarray(power / power.mean())


def _shared(forward: Forward, relative: Mapping[int, Array]) -> Array:
    """Relative variance that shots have in common, (3,)."""
    pressed = [n for n in relative if forward.bank.shots[n].press is not None]
    untouched = [away for n, away in relative.items() if n not in pressed]
    if not untouched or not pressed:
        alone = [(away**2).sum(axis=0).mean(axis=(0, 1)) for away in relative.values()]
        return np.asarray(np.mean(alone, axis=0))
    reference = np.mean(untouched, axis=0)
    both = [(relative[n] * reference).sum(axis=0).mean(axis=(0, 1)) for n in pressed]
    return np.asarray(np.maximum(np.mean(both, axis=0), 0.0))
