"""Grain is fine noise that repeats of a frame share, so that they do not show it."""

from collections.abc import Sequence

import numpy as np

from designlab.core.types import Array

LAG_PX = 6  # from which grain is independent that went through a blur of up to 1.5 pixels
FEWEST = 3  # states of the sensor that tell grain from a pattern that all frames carry
TAKEN = 0.9  # of the variance of n states, times n: goes with their median (found with normal values)
NORMAL = 0.6745  # median of the absolute value of a normal deviate


def grain_variances(left: Sequence[Array], variance: Sequence[Array]) -> list[float]:
    """Estimate the variance of the grain of each of several states of a sensor.

    It is that of mixed differences at a lag of 6 pixels, which know nothing of smooth errors, nor of what
    depends on row or column alone. What most states have in common is a fixed pattern and no grain. Edges are
    few, and medians do without them. Estimates may be negative where there is no grain.

    Parameters
    ----------
    left : sequence of array, shape (rows, columns, 3)
        What a model leaves of each state, relative to its light; NaN where that tells nothing.
    variance : sequence of array, shape (rows, columns, 3)
        Of the camera's noise in it.

    Returns
    -------
    list of float
        Empty where there are less than three states.

    Examples
    --------
    >>> random = np.random.default_rng(0)
    >>> noisy = [0.02 * random.normal(size=(90, 120, 3)) for _ in range(5)]
    >>> round(float(np.sqrt(np.median(grain_variances(noisy, [np.zeros((90, 120, 3))] * 5)))), 3)
    0.02
    """
    if len(left) < FEWEST:
        return []
    stack = np.array(left)
    told = np.isfinite(stack)
    counted = told.sum(axis=0)
    common = np.full(stack.shape[1:], np.nan)
    seen = counted >= FEWEST
    common[seen] = np.nanmedian(stack[:, seen], axis=0)
    found = []
    for own, used, noise in zip(stack, told, variance, strict=True):
        apart = _mixed_difference(own - common)
        used = used & seen
        if not np.isfinite(apart).any():
            continue
        kept = 1 - TAKEN / float(np.median(counted[used]))
        spread = float(np.nanmedian(np.abs(apart))) / NORMAL
        found.append((spread**2 - float(np.median(noise[used]))) / kept)
    return found


def _mixed_difference(values: Array) -> Array:
    """Half the difference along rows of differences along columns: independent values keep their variance."""
    rows = values[LAG_PX:] - values[:-LAG_PX]
    return np.asarray((rows[:, LAG_PX:] - rows[:, :-LAG_PX]) / 2)
