"""What a pool with known answers teaches: by how much the unlisted pulls fitted values."""

from collections.abc import Iterable, Sequence

import numpy as np

from designlab.design import preset
from designlab.effects import effect
from designlab.trials.runner import Outcome
from designlab.trials.score import all_named

GRID = np.geomspace(1e-3, 3.0, 400)  # prior standard deviations
USUAL = 0.05  # likewise: scale of the half-Cauchy prior
FEWEST = 3  # sets that tell an effect's error


def unlisted_sd(outcomes: Iterable[Outcome]) -> dict[str, float]:
    """Standard deviation of what no catalogue lists in fitted values, in prior standard deviations.

    One for each effect, and for each parameter that only shapes one; see `spread`. A set counts if all that
    it hides was named: otherwise a value may stand for what was not.
    """
    found: dict[str, list[list[tuple[float, float]]]] = {}
    for o in filter(all_named, outcomes):
        for name, truth in o.truth["effects"].items():
            values = o.parameters.get(name, {})
            own: dict[str, list[tuple[float, float]]] = {}
            for p in effect(name).parameters(preset(o.trial["design"])):
                v = values.get(p.name)
                if v is None or v["fit_sd"] is None or p.name not in truth:
                    continue
                error = (v["value"] - truth[p.name]) / p.sd
                own.setdefault(f"{name}.{p.name}" if p.shape else name, []).append(
                    (error, v["fit_sd"] / p.sd)
                )
            for key, errors in own.items():
                found.setdefault(key, []).append(errors)
    return {
        key: round(spread([error for errors in sets for error in errors]), 4)
        for key, sets in sorted(found.items())
        if len(sets) >= FEWEST
    }


def spread(errors: Sequence[tuple[float, float]]) -> float:
    """Standard deviation s of errors that are normal with variance s^2 + stated^2.

    Root of the posterior mean of s^2 under a half-Cauchy prior (Gelman 2006), by summation over a grid: the
    likelihood may have several maxima, and few errors leave it wide, which the mean takes into account.

    Parameters
    ----------
    errors : sequence of (float, float)
        Error and its stated standard deviation.
    """
    error, stated = np.array(errors).T
    variance = GRID[:, None] ** 2 + stated**2
    logarithm = -0.5 * (error**2 / variance + np.log(variance)).sum(axis=1)
    logarithm += np.log(GRID) - np.log1p((GRID / USUAL) ** 2)  # steps of the grid are even in log s
    weight = np.exp(logarithm - logarithm.max())
    return float(np.sqrt((weight * GRID**2).sum() / weight.sum()))
