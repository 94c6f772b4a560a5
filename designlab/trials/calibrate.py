"""What a pool with known answers teaches: by how much the unlisted pulls fitted values."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.stats import t

from designlab.design import preset
from designlab.effects import effect
from designlab.gap.intervals import NORMAL, TAIL
from designlab.trials.runner import Outcome

LARGEST = 3.0  # prior standard deviations
FEWEST = 3  # sets that tell an effect's error


def systematic(outcomes: Iterable[Outcome]) -> dict[str, float]:
    """Standard deviation of what no catalogue lists in fitted values, in prior standard deviations.

    For each effect, and each parameter that only shapes one, the value at which errors of all sets are as
    likely as they can be, beside the error that each fit states for itself; larger by Student's t for few
    sets. A set counts if its effect was named.
    """
    found: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for o in outcomes:
        for name, truth in o.truth["effects"].items():
            values = o.parameters.get(name, {})
            for p in effect(name).parameters(preset(o.trial["design"])):
                v = values.get(p.name)
                if v is None or v["fit_sd"] is None or p.name not in truth:
                    continue
                key = f"{name}.{p.name}" if p.shape else name
                error = (v["value"] - truth[p.name]) / p.sd
                found.setdefault(key, {}).setdefault(o.trial["name"], []).append((error, v["fit_sd"] / p.sd))
    return {
        key: round(spread([one for own in sets.values() for one in own]) * few(len(sets)), 4)
        for key, sets in sorted(found.items())
        if len(sets) >= FEWEST
    }


def few(sets: int) -> float:
    """By how much a standard deviation told by a few sets must be larger for the same coverage."""
    return float(t.ppf(1 - TAIL, sets - 1) / NORMAL)


def spread(errors: Sequence[tuple[float, float]]) -> float:
    """Standard deviation s of greatest likelihood: errors are normal with variance s^2 + stated^2.

    Parameters
    ----------
    errors : sequence of (float, float)
        Error and its stated standard deviation.

    Examples
    --------
    >>> round(spread([(0.5, 0.0), (-0.5, 0.0)]), 3)
    0.5
    >>> spread([(0.1, 1.0), (-0.2, 1.0)])
    0.0
    """
    error, stated = np.array(errors).T

    def slope(variance: float) -> float:
        whole = variance + np.maximum(stated, 1e-9) ** 2
        return float((error**2 / whole**2 - 1 / whole).sum())

    if slope(0.0) <= 0:
        return 0.0
    if slope(LARGEST**2) >= 0:
        return LARGEST
    return float(np.sqrt(brentq(slope, 0.0, LARGEST**2)))
