"""How large an effect must be to be named: curves of the share of sets named right over strength."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize
from scipy.special import log_expit
from scipy.stats import chi2

from designlab.design import Design
from designlab.effects import effect

Array = NDArray[np.float64]

LOW, HIGH = 1 / 32, 32.0  # prior standard deviations between which limits are looked for
SLOPE = 3.0  # usual slope of a curve against the logarithm of strength, known to a factor of `SLOPE_SPREAD`
SLOPE_SPREAD = 2.0


@dataclass(frozen=True)
class Limit:
    """Strength of which half of the sets are named right (prior standard deviations), its 95 % interval.

    An end is None where the sets do not bound it: all or none of them were named. The strength lies within
    those that were tried.
    """

    strength: float
    low: float | None
    high: float | None


def limits(named: Mapping[str, Iterable[tuple[float, bool]]]) -> dict[str, Limit]:
    """Fit logistic curves over the logarithm of strength, one slope for all kinds.

    Parameters
    ----------
    named : mapping
        For each kind of effect the strength of each set and whether the right name came first.

    Returns
    -------
    dict
        Limit of each kind: greatest likelihood, and where it falls by as much as in one case of twenty by
        chance, the slope held.
    """
    kinds = list(named)
    sets = {kind: np.array(list(named[kind]), dtype=float).reshape(-1, 2) for kind in kinds}
    start = np.array([*(_middle(sets[kind]) for kind in kinds), np.log(SLOPE)])
    bounds = [(np.log(LOW), np.log(HIGH))] * len(kinds) + [(np.log(0.3), np.log(30.0))]

    def lost(values: Array) -> float:
        slope = float(np.exp(values[-1]))
        prior = 0.5 * float((values[-1] - np.log(SLOPE)) / np.log(SLOPE_SPREAD)) ** 2
        return prior - sum(_likelihood(sets[kind], values[k], slope) for k, kind in enumerate(kinds))

    best = minimize(lost, start, bounds=bounds, method="L-BFGS-B").x
    slope = float(np.exp(best[-1]))
    return {kind: _limit(sets[kind], float(best[k]), slope) for k, kind in enumerate(kinds)}


def in_units(kind: str, strength: float, design: Design) -> str:
    """A strength in the units of an effect's parameters: what each, changed alone, is away from null.

    Examples
    --------
    >>> from designlab.design import preset
    >>> in_units("led_position", 0.5, preset("gelsight-2020-flat"))
    '0.25 mm (radial_mm, height_mm, tangential_mm)'
    """
    found: dict[tuple[float, str], list[str]] = {}
    for p in effect(kind).parameters(design):
        if not p.shape:
            found.setdefault((p.sd, p.unit), []).append(p.name)
    return "; ".join(
        f"{strength * sd:.2g}{'' if unit == '1' else ' ' + unit} ({', '.join(names)})"
        for (sd, unit), names in found.items()
    )


def _middle(sets: Array) -> float:
    """Logarithm of a strength between those found and those missed."""
    found, missed = sets[sets[:, 1] > 0, 0], sets[sets[:, 1] == 0, 0]
    if not len(found):
        return float(np.log(2 * missed.max()))
    if not len(missed):
        return float(np.log(found.min() / 2))
    return float((np.log(found).mean() + np.log(missed).mean()) / 2)


def _likelihood(sets: Array, middle: float, slope: float) -> float:
    """Logarithm of the likelihood of one kind's sets."""
    at = slope * (np.log(sets[:, 0]) - middle)
    return float(np.where(sets[:, 1] > 0, log_expit(at), log_expit(-at)).sum())


def _limit(sets: Array, best: float, slope: float) -> Limit:
    top = _likelihood(sets, best, slope)
    fall = chi2.ppf(0.95, 1) / 2

    def below(middle: float) -> float:
        return _likelihood(sets, middle, slope) - top + float(fall)

    ends: list[float | None] = []
    for end in (np.log(LOW), np.log(HIGH)):
        ends.append(float(np.exp(brentq(below, end, best))) if below(end) < 0 else None)
    strength = float(np.clip(np.exp(best), sets[:, 0].min(), sets[:, 0].max()))
    return Limit(_settled(strength), *(None if end is None else _settled(end) for end in ends))


def _settled(value: float) -> float:
    """Round to what does not depend on where the search for the best fit stopped."""
    return float(f"{value:.3g}")
