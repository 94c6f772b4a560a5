"""What pixels report in the mean: noise comes before a curve, and before counts are cut at zero."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from designlab.camera import Camera

Array = NDArray[np.float64]

DEVIATES = np.linspace(-5.0, 5.0, 101)  # of the noise of one pixel
LEVELS = 400  # of a sampled curve


def mean_answers(answered: Callable[[Array], Array], camera: Camera, brightest: float) -> tuple[Array, Array]:
    """Mean answers of a camera whose pixels have their noise before they answer by a curve.

    Parameters
    ----------
    answered : callable
        Answers to signals, shape (..., 3).
    camera : Camera
        What the noise is of.
    brightest : float
        Highest level.

    Returns
    -------
    levels, answers : array, shapes (n,) and (n, 3)
        Signals without noise from zero to the highest level, and the mean answers of the three channels.
    """
    # Even steps of the root: a curve may be steep at zero.
    levels = brightest * np.linspace(0.0, 1.0, LEVELS) ** 2
    weights = np.exp(-(DEVIATES**2) / 2)
    signals = levels[:, None] + camera.noise_sigma(levels)[:, None] * DEVIATES
    # The converter cuts at zero what its black level does not lift.
    answers = np.maximum(answered(np.repeat(signals[..., None], 3, axis=-1)), 0.0)
    return levels, np.tensordot(weights / weights.sum(), answers, axes=(0, 1))


def uncut(signal: Array, sigma: Array) -> Array:
    """Derivative of `clipped`: the share of the counts about a signal that are not cut."""
    from scipy.special import ndtr

    share = np.ones(signal.shape)
    for channel in np.flatnonzero(sigma):
        share[..., channel] = ndtr(signal[..., channel] / sigma[channel])
    return share


def clipped(signal: Array, sigma: Array) -> Array:
    """Mean of counts about a signal when those below zero are cut to zero; channels of zero `sigma` stay.

    For Gaussian counts it is s Phi(s / sigma) + sigma phi(s / sigma), which tends to s well above the noise.
    """
    from scipy.special import ndtr

    if not sigma.any():
        return signal
    found = signal.copy()
    for channel in np.flatnonzero(sigma):
        ratio = signal[..., channel] / sigma[channel]
        density = np.exp(-(ratio**2) / 2) / np.sqrt(2 * np.pi)
        found[..., channel] = sigma[channel] * (ratio * ndtr(ratio) + density)
    return found
