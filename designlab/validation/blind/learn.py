"""Learning from a pool gives what the unlisted does to values, and how often names are right."""

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression, minimize
from scipy.special import log_expit

from designlab.core.types import Array
from designlab.inference.diagnosis.likelihood.empirical_errors import known, over_dirt
from designlab.inference.diagnosis.likelihood.normal_equations import log_evidence
from designlab.inference.diagnosis.selection.forward_selection import PROMISING
from designlab.inference.diagnosis.verdict.confidence import SIGNS, SPANS, signs, sum_of
from designlab.sensor.design import preset
from designlab.simulation.effects import effect
from designlab.validation.blind.runner import Outcome
from designlab.validation.blind.score import (
    BINS,
    Row,
    all_named,
    equal_mass,
    record,
    same,
    sure,
)

GRID = np.geomspace(1e-3, 3.0, 400)  # prior standard deviations
USUAL = 0.05  # likewise: scale of the half-Cauchy prior
FEWEST = 3  # sets that tell an effect's error
WEIGHT_SD = 4.0  # of the logarithm of odds, what a sign may usually count from one end to the other


def unlisted_sd(outcomes: Iterable[Outcome]) -> dict[str, float]:
    """Standard deviation of what no catalogue lists in fitted values, in prior standard deviations.

    One for each effect, and for each parameter that only shapes one; see `spread`. A set counts if all that
    it hides was named, otherwise a value may stand for what was not, and if its sensor is clean; see
    `dirt_sd` of others.
    """
    found: dict[str, dict[int, list[tuple[float, float]]]] = {}  # by parameter and set
    clean = (o for o in outcomes if not o.trial["dirt"])
    for number, o in enumerate(o for o in clean if all_named(record(o))):
        for name, truth in o.truth["effects"].items():
            values = o.parameters.get(name, {})
            for p in effect(name).parameters(preset(o.trial["design"])):
                v = values.get(p.name)
                if v is None or v["fit_sd"] is None or p.name not in truth:
                    continue
                error = (v["value"] - truth[p.name]) / p.sd
                sets = found.setdefault(f"{name}.{p.name}" if p.shape else name, {})
                sets.setdefault(number, []).append((error, v["fit_sd"] / p.sd))
    return {
        key: round(spread([error for errors in sets.values() for error in errors]), 4)
        for key, sets in sorted(found.items())
        if len(sets) >= FEWEST
    }


def learnt(outcomes: Iterable[Outcome]) -> dict[str, Any]:
    """What a whole pool of all families teaches, as `empirical_errors` reads it.

    Effects of which it has too few sets keep what was known of them; what dirt gives to them
    ``benchmarks/dirt_sizes.py`` measures. Confidence is that of this pool alone: records of others are added
    anew, see `with_records`.
    """
    outcomes = list(outcomes)
    return {
        "unlisted_sd": dict(sorted({**known()["unlisted_sd"], **unlisted_sd(outcomes)}.items())),
        "dirt_sd": known()["dirt_sd"],
        "like_dirt": known()["like_dirt"],
        "confidence": shares_right(outcomes),
    }


def dirt_sd(sets: Iterable[Mapping[str, tuple[Array, Array]]]) -> dict[str, float]:
    """Size that a lab's dirt gives to effects that are not there, in prior standard deviations.

    In sets that hide nothing, values of an effect are normal about null with variance s^2 and the error of a
    linear fit. This is the root of the posterior mean of s^2 under a half-Cauchy prior, as in `spread`; or,
    where that is more, the least s of which no set is surely beyond: few sets tell little of long tails.

    Parameters
    ----------
    sets : iterable of mapping
        Of each set, information about every effect, (n, n), and its right side, (n,), as `screening.alone`
        gives them. Parameters that only shape an effect are fitted along.
    """
    found: dict[str, list[tuple[Array, Array]]] = {}
    for each in sets:
        for name, (information, right) in each.items():
            found.setdefault(name, []).append((information, right))
    return {
        name: round(max(_likely(own), _beyond_none(own)), 4)
        for name, own in sorted(found.items())
        if len(own) >= FEWEST
    }


def like_dirt(sets: Iterable[Mapping[str, tuple[Array, Array]]]) -> list[str]:
    """Effects that a diagnosis would try in a set that hides nothing, so promising does dirt make them.

    Parameters
    ----------
    sets : iterable of mapping
        See `dirt_sd`.
    """
    return sorted({name for each in sets for name, told in each.items() if log_evidence(*told) > PROMISING})


def _likely(sets: Sequence[tuple[Array, Array]]) -> float:
    """Root of the posterior mean of a variance, from information and right sides."""
    logarithm = np.zeros(len(GRID))
    for information, right in sets:
        values, vectors = np.linalg.eigh(information)
        values, squares = np.maximum(values, 0.0), (vectors.T @ right) ** 2
        fitted = 1.0 / GRID[:, None] ** 2 + values
        logarithm += 0.5 * (squares / fitted - np.log1p(GRID[:, None] ** 2 * values)).sum(axis=1)
    return _root_of_mean_square(logarithm)


def _beyond_none(sets: Sequence[tuple[Array, Array]]) -> float:
    """Least of the standard deviations of which no set is surely beyond."""
    fitted = [
        (np.asarray(np.linalg.solve(told + np.eye(len(right)), right), dtype=float), told)
        for told, right in sets
    ]

    def holds(size: float) -> bool:
        return all(over_dirt(away, information, size) <= 1 for away, information in fitted)

    return float(GRID[min(bisect_left(GRID, True, key=holds), len(GRID) - 1)])


def shares_right(outcomes: Iterable[Outcome]) -> dict[str, Any]:
    """Weights of the signs of a name (logistic regression), and the share of right names along their sum.

    A sign counts in the direction that is known of it or not at all. The sums are cut into bins of equal
    mass; the shares of right names in them, half a right and half a wrong name added to each bin (Jeffreys'
    prior), are made to rise (isotonic regression).

    Parameters
    ----------
    outcomes : iterable of Outcome
        Of all families.

    Raises
    ------
    ValueError
        If too few names were given.
    """
    seen, right = named(outcomes)
    if len(right) < FEWEST * BINS:
        raise ValueError(f"pool: {len(right)} names teach nothing, {FEWEST * BINS} are needed")
    direction = np.array(list(SIGNS.values()), dtype=float)
    # The whole range, not that of these names: sensors that leave more than any of them must not be doomed.
    scale = np.array([SPANS[name] for name in SIGNS])
    scaled = (seen - seen.mean(axis=0)) / scale

    def lost(weights: Array) -> float:
        odds = weights[0] + scaled @ weights[1:]
        prior = 0.5 * float((weights[1:] ** 2).sum()) / WEIGHT_SD**2
        return prior - float(log_expit(np.where(right, odds, -odds)).sum())

    bounds = [(None, None), *((0.0, None) if sign > 0 else (None, 0.0) for sign in direction)]
    best = minimize(lost, np.zeros(len(bounds)), bounds=bounds, method="L-BFGS-B").x[1:] / scale
    total = seen @ best
    bins = equal_mass(total)
    share = [_share(right[part]) for part in bins]
    rising = isotonic_regression(share, weights=[len(part) for part in bins]).x
    return {
        "weights": {name: round(float(weight), 4) for name, weight in zip(SIGNS, best, strict=True)},
        "scores": [round(float(total[part].mean()), 4) for part in bins],
        "right": [round(float(each), 4) for each in rising],
        "masses": [len(part) for part in bins],
        "names": len(right),
    }


def with_records(rows: Iterable[Row]) -> dict[str, Any]:
    """What is known of confidence, with the names of recorded sets added.

    Records keep no signs, but the confidence that was stated tells their weighted sum, unless it was capped:
    they must be of whole kits. Weights stay. The names that were known, those of equal shares as one, and the
    names of the records in bins of equal mass give the new shares (isotonic regression).

    Parameters
    ----------
    rows : iterable of Row
        Records of sets that were opened, diagnosed with the confidence that is known now.

    Returns
    -------
    dict
        As `shares_right` gives it.

    Raises
    ------
    ValueError
        If the records hold no name.
    """
    before = known()["confidence"]
    stated = sure(rows)
    if not stated:
        raise ValueError("records: hold no name")
    total = np.array([sum_of(confidence, before["scores"], before["right"]) for confidence, _ in stated])
    right = np.array([each for _, each in stated])
    points = [
        *_levels(before),
        *((total[part].mean(), _share(right[part]), len(part)) for part in equal_mass(total)),
    ]
    masses: dict[float, float] = {}
    rights: dict[float, float] = {}
    for score, share, mass in points:
        place = round(float(score), 4)
        masses[place] = masses.get(place, 0.0) + mass
        rights[place] = rights.get(place, 0.0) + mass * share
    scores = sorted(masses)
    weights = [masses[score] for score in scores]
    rising = isotonic_regression([rights[score] / masses[score] for score in scores], weights=weights).x
    return {
        "weights": before["weights"],
        "scores": scores,
        "right": [round(float(each), 4) for each in rising],
        "masses": [round(mass, 4) for mass in weights],
        "names": before["names"] + len(stated),
    }


def _levels(confidence: Mapping[str, Any]) -> list[tuple[float, float, float]]:
    """Score, share of right names and number of names of each share that is known, at its middle."""
    scores, shares = np.array(confidence["scores"]), np.array(confidence["right"])
    masses = np.array(confidence["masses"])
    levels = [shares == share for share in sorted(set(confidence["right"]))]
    return [
        (float(scores[level].mean()), float(shares[level][0]), float(masses[level].sum())) for level in levels
    ]


def _share(right: NDArray[np.bool_]) -> float:
    """Share of right names, half a right and half a wrong one added."""
    return float((right.sum() + 0.5) / (len(right) + 1))


def named(outcomes: Iterable[Outcome]) -> tuple[Array, NDArray[np.bool_]]:
    """Signs of every name that was given (names, signs), and whether it was right."""
    rows, right = [], []
    for o in outcomes:
        for place, (name, alike) in enumerate(zip(o.named, o.sets, strict=True)):
            rows.append(signs(name, alike, o.candidates, gap=o.gap["select"], later=place > 0))
            right.append(any(same(name, truth) for truth in o.trial["effects"]))
    return np.array(rows).reshape(-1, len(SIGNS)), np.array(right, dtype=bool)


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
    return _root_of_mean_square(logarithm)


def _root_of_mean_square(logarithm: Array) -> float:
    """Root of the posterior mean of s^2 from the log likelihood of each s of `GRID`."""
    logarithm = logarithm + np.log(GRID) - np.log1p((GRID / USUAL) ** 2)  # steps are even in log s
    weight = np.exp(logarithm - logarithm.max())
    return float(np.sqrt((weight * GRID**2).sum() / weight.sum()))
