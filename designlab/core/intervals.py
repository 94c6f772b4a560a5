"""Intervals of 95 % for the size of what is drawn anew each time."""

import numpy as np

from designlab.core.types import Array

Ends = tuple[float, float]

NORMAL = 1.96  # standard deviations of a 95 % interval
TAIL = 0.025


def of_deviation(draws: Array, error: float = 0.0) -> Ends:
    """Ends for the standard deviation that draws come from, their mean unknown (chi-square).

    Parameters
    ----------
    draws : array
        Estimates of the draws.
    error : float
        Mean variance of these estimates, which may have hidden as much of the draws.

    Examples
    --------
    >>> low, high = of_deviation(np.array([-1.0, 1.0] * 50))
    >>> round(low, 2), round(high, 2)
    (0.88, 1.17)
    """
    from scipy.stats import chi2

    freedom = draws.size - 1
    squares = float((draws**2).sum())
    return (
        float(np.sqrt(squares / chi2.ppf(1 - TAIL, freedom))),
        float(np.sqrt((squares + draws.size * error) / chi2.ppf(TAIL, freedom))),
    )


def of_amplitudes(draws: Array, error: float = 0.0) -> Ends:
    """Ends for the amplitude of waves that differ in phase alone, from sine and cosine of each, (n, 2).

    The spread between waves tells more than the errors stated. `error` is the mean of their sum of squares,
    by which estimates that their prior has drawn to zero fall short.
    """
    from scipy.stats import t

    powers = (draws**2).sum(axis=1)
    amplitude = float(np.sqrt(powers.mean()))
    spread = float(powers.std(ddof=1)) / (2 * amplitude)
    away = float(t.ppf(1 - TAIL, len(draws) - 1)) * np.sqrt((spread**2 + error / 2) / len(draws))
    return max(amplitude - away, 0.0), float(np.sqrt(powers.mean() + error)) + away
