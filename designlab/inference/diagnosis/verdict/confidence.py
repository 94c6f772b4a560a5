"""The confidence of a name is the share of right names among generated sets that looked alike.

A name is judged by signs that its report shows; the more speak for it, the larger the share of right names
among those alike. Weights and shares are learnt by `validation.blind.learn` and kept with the rest that is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import expit, logit

from designlab.core.types import Array
from designlab.inference.diagnosis.likelihood.empirical_errors import shares_right

SIGNS = {"left": -1, "share": -1, "set": -1, "margin": 1, "gain": 1, "later": -1}
"""What is looked at, and whether more of it speaks for a name or against it.

left: logarithm of one and the squared residual beyond what is usual; share: logarithm of the part of the gap
that this is; set: logarithm of the number of effects that do as well; margin: logarithm of the evidence over
that of the best other effect of the round; gain: logarithm of the share of the gap; later: whether another
effect was found before.
"""
SURE_ENOUGH = 0.5  # confidence from which a name stands without reserve: it is as likely right as wrong
MOST_WITHOUT_GRAIN = 0.015  # share of the gap that right names leave where frames have no grain
RIGHT_BEYOND = 0.029  # share of right names that leave more: 1 of 34 (docs/records/test-0e1b938.jsonl)
DROPPED = "dropped"  # begins the outcome of effects that later ones made needless
MOST_LEFT, LEAST_SHARE, MOST_MARGIN, LEAST_GAIN = 4.0, 1e-3, 3.0, 1e-3
DIGITS = 3  # of a confidence
MOST_ALIKE = 5  # effects that do as well, of usual reports
SPANS = {
    "left": MOST_LEFT,
    "share": -float(np.log(LEAST_SHARE)),
    "set": float(np.log(MOST_ALIKE)),
    "margin": 2 * MOST_MARGIN,
    "gain": -float(np.log(LEAST_GAIN)),
    "later": 1.0,
}
"""From one end of each sign to the other."""


def confidence(report: Mapping[str, Any], place: int) -> float:
    """Share of right names among those that looked like one of a report's.

    Parameters
    ----------
    report : mapping
        As `GapReport.to_json` gives it.
    place : int
        Which of its effects.
    """
    found = report["effects"][place]
    if not report["unexplained"]["grain_rms"]:
        # Nothing that no catalogue lists is expected there.
        most = max(_share_left(report["gap"][name]) for name in ("select", "final"))
        if most > MOST_WITHOUT_GRAIN:
            return RIGHT_BEYOND
    weights, scores, right = shares_right()
    seen = signs(
        found["name"],
        found["coherence_set"],
        report["candidates"],
        gap=report["gap"]["select"],
        later=place > 0,
    )
    total = float(seen @ np.array([weights[name] for name in SIGNS]))
    return round(share_right(total, scores, right), DIGITS)


def share_right(total: float, scores: Sequence[float], right: Sequence[float]) -> float:
    """Share of right names at a sum of signs, by the shares at others.

    Below all of these it falls as the logistic regression that gave the weights says.
    """
    if total < scores[0]:
        return float(expit(logit(right[0]) + total - scores[0]))
    return float(np.interp(total, scores, right))


def sum_of(share: float, scores: Sequence[float], right: Sequence[float]) -> float:
    """Sum of signs that a share of right names was stated for; the inverse of `share_right`.

    Where several sums have the same share, as stated, it is the middle of the known ones.
    """
    level = [score for score, each in zip(scores, right, strict=True) if abs(each - share) <= 10**-DIGITS / 2]
    if level:
        return float(np.mean(level))
    if share < right[0]:
        return float(scores[0] + logit(share) - logit(right[0]))
    above = int(np.searchsorted(right, share))
    ends = slice(above - 1, above + 1)
    return float(np.interp(share, right[ends], scores[ends]))


def signs(
    name: str,
    alike: Sequence[str],
    candidates: Sequence[Mapping[str, Any]],
    *,
    gap: Mapping[str, float],
    later: bool,
) -> Array:
    """What a report shows for or against one of its names, in the order of `SIGNS`.

    Parameters
    ----------
    name : str
        An effect that was named.
    alike : sequence of str
        Effects that do as well, itself included.
    candidates : sequence of mapping
        All that were tried.
    gap : mapping of str to float
        Squared residuals of the select presses, the fields of `Level`.
    later : bool
        Whether another of the effects named was found before.
    """
    taken = [c for c in candidates if c["name"] == name and c["outcome"] == "passed"][-1]
    rivals = [
        c["evidence"]
        for c in candidates
        if c["round"] == taken["round"] and c["name"] not in alike and _tried(c)
    ]
    left = max(gap["after"] - gap["usual"], 0.0)
    margin = np.log((max(taken["evidence"], 0.0) + 1) / (max([0.0, *rivals]) + 1))
    return np.array(
        [
            min(np.log1p(left), MOST_LEFT),
            np.log(np.clip(_share_left(gap), LEAST_SHARE, 1.0)),
            np.log(len(alike)),
            np.clip(margin, -MOST_MARGIN, MOST_MARGIN),
            np.log(max(taken["gain"], LEAST_GAIN)),
            float(later),
        ]
    )


def _share_left(gap: Mapping[str, float]) -> float:
    """Part of the excess over what is usual that is left."""
    return max(gap["after"] - gap["usual"], 0.0) / max(gap["before"] - gap["usual"], 1e-9)


def _tried(candidate: Mapping[str, Any]) -> bool:
    """Whether a candidate was fitted to be added, not an effect that was dropped again."""
    return candidate["gain"] is not None and not candidate["outcome"].startswith(DROPPED)
