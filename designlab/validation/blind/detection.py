"""The detection limit of an effect is the strength at which half of the sets are named right."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import brentq, minimize
from scipy.special import log_expit
from scipy.stats import chi2

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.simulation.effects import effect

LOW, HIGH = 1 / 32, 32.0  # prior standard deviations between which limits are looked for
SLOPE = 3.0  # usual slope of a curve against the logarithm of strength, known to a factor of `SLOPE_SPREAD`
SLOPE_SPREAD = 2.0
DESIGN_SPREAD = 1.7  # usual factor between the limit on a design and the middle of all


@dataclass(frozen=True)
class Limit:
    """Strength of which half of the sets are named right (prior standard deviations), its 95 % interval.

    An end is None where the sets do not bound it: all or none of them were named. The strength lies within
    those that were tried. `designs` holds the limit on each design alone.
    """

    strength: float
    low: float | None
    high: float | None
    designs: dict[str, float] = field(default_factory=dict)


def limits(named: Mapping[str, Iterable[tuple[float, bool, str]]]) -> dict[str, Limit]:
    """Fit logistic curves over the logarithm of strength, one slope for all kinds.

    Parameters
    ----------
    named : mapping
        For each kind of effect the strength of each set, whether the right name came first, and its design.

    Returns
    -------
    dict
        Limit of each kind in the middle of the designs: where half are named by the most likely curves, and
        where likelihood falls by as much as in one case of twenty by chance, slope and designs held. Limits
        on single designs are drawn to the middle as far as their sets leave them open.
    """
    tried = {kind: list(rows) for kind, rows in named.items()}
    kinds = list(tried)
    places = [(kind, design) for kind in kinds for design in dict.fromkeys(row[2] for row in tried[kind])]
    sets = {
        (kind, design): np.array([row[:2] for row in tried[kind] if row[2] == design], dtype=float)
        for kind, design in places
    }
    pooled = {kind: np.concatenate([sets[place] for place in places if place[0] == kind]) for kind in kinds}
    of = np.array([kinds.index(kind) for kind, _ in places], dtype=int)

    def lost(values: Array) -> float:
        middle, away, slope = np.split(values, [len(kinds), len(kinds) + len(places)])
        prior = ((slope[0] - np.log(SLOPE)) / np.log(SLOPE_SPREAD)) ** 2
        prior += ((away / np.log(DESIGN_SPREAD)) ** 2).sum()
        at = middle[of] + away
        steepness = float(np.exp(slope[0]))
        likelihood = sum(_likelihood(sets[p], at[k], steepness) for k, p in enumerate(places))
        return 0.5 * float(prior) - likelihood

    start = np.array([*(_middle(pooled[kind]) for kind in kinds), *np.zeros(len(places)), np.log(SLOPE)])
    bounds = [(np.log(LOW), np.log(HIGH))] * len(kinds)
    bounds += [(-np.log(HIGH), np.log(HIGH))] * len(places) + [(np.log(0.3), np.log(30.0))]
    best = minimize(lost, start, bounds=bounds, method="L-BFGS-B").x
    middle, away, (slope,) = np.split(best, [len(kinds), len(kinds) + len(places)])
    found = {}
    for k, kind in enumerate(kinds):
        own = {p[1]: (sets[p], float(shift)) for p, shift in zip(places, away, strict=True) if p[0] == kind}
        found[kind] = _limit(own, float(middle[k]), float(np.exp(slope)))
    return found


def in_units(kind: str, strength: float, design: Design) -> str:
    """A strength in the units of an effect's parameters: what each, changed alone, is away from null.

    Examples
    --------
    >>> from designlab.sensor.design import preset
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


def _limit(designs: Mapping[str, tuple[Array, float]], best: float, slope: float) -> Limit:
    """Limit of a kind, from the sets of each design and how far that is from the middle of all."""

    def likelihood(middle: float) -> float:
        return sum(_likelihood(sets, middle + away, slope) for sets, away in designs.values())

    top, fall = likelihood(best), float(chi2.ppf(0.95, 1) / 2)

    def below(middle: float) -> float:
        return likelihood(middle) - top + fall

    low, high = (
        _settled(float(np.exp(brentq(below, end, best)))) if below(end) < 0 else None
        for end in (np.log(LOW), np.log(HIGH))
    )
    tried = np.concatenate([sets[:, 0] for sets, _ in designs.values()])

    def within(value: float) -> float:
        return _settled(float(np.clip(np.exp(value), tried.min(), tried.max())))

    return Limit(within(best), low, high, {name: within(best + away) for name, (_, away) in designs.items()})


def _settled(value: float) -> float:
    """Round to what does not depend on where the search for the best fit stopped."""
    return float(f"{value:.3g}")
