"""The confidence of a name is the share of right names among generated sets that looked alike.

A name is judged by signs that its report shows; the more speak for it, the larger the share of right names
among those alike. Weights and shares are learnt by `validation.blind.learn` and kept with the rest that is.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.likelihood.empirical_errors import share_of_partial, shares_right

SIGNS = {"left": -1, "set": -1, "margin": 1, "gain": 1, "later": -1}
"""What is looked at, and whether more of it speaks for a name or against it.

left: logarithm of the squared residual over what sets leave that hide nothing; set: logarithm of the number
of effects that do as well; margin: logarithm of the evidence over that of the best other effect of the round;
gain: logarithm of the share of the gap; later: whether another effect was found before.
"""
DROPPED = "dropped"  # begins the outcome of effects that later ones made needless
MOST_LEFT, MOST_MARGIN, LEAST_GAIN = 4.0, 3.0, 1e-3


def confidence(report: Mapping[str, Any], place: int) -> float:
    """Share of right names among those that looked like one of a report's.

    Where a report says that it explains a part only, names are right as seldom as those of such reports.

    Parameters
    ----------
    report : mapping
        As `GapReport.to_json` gives it.
    place : int
        Which of its effects.
    """
    found = report["effects"][place]
    weights, scores, right = shares_right()
    level = report["gap"]["select"]
    seen = signs(
        found["name"],
        found["coherence_set"],
        report["candidates"],
        left=level["after"] / level["usual"],
        later=place > 0,
    )
    total = float(seen @ np.array([weights[name] for name in SIGNS]))
    share = float(np.interp(total, scores, right))
    return round(min(share, share_of_partial()) if report["verdict"] == "partial" else share, 3)


def signs(
    name: str, alike: Sequence[str], candidates: Sequence[Mapping[str, Any]], *, left: float, later: bool
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
    left : float
        Squared residual of the select presses over what is usual where nothing is missing.
    later : bool
        Whether another of the effects named was found before.
    """
    taken = [c for c in candidates if c["name"] == name and c["outcome"] == "passed"][-1]
    rivals = [
        c["evidence"]
        for c in candidates
        if c["round"] == taken["round"] and c["name"] not in alike and _tried(c)
    ]
    margin = np.log((max(taken["evidence"], 0.0) + 1) / (max([0.0, *rivals]) + 1))
    return np.array(
        [
            np.clip(np.log(left), 0.0, MOST_LEFT),
            np.log(len(alike)),
            np.clip(margin, -MOST_MARGIN, MOST_MARGIN),
            np.log(max(taken["gain"], LEAST_GAIN)),
            float(later),
        ]
    )


def _tried(candidate: Mapping[str, Any]) -> bool:
    """Whether a candidate was fitted to be added, not an effect that was dropped again."""
    return candidate["gain"] is not None and not candidate["outcome"].startswith(DROPPED)
