"""What a pool of trials shows: names right and wrong, sets, gap removed, intervals."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from designlab.trials.detection import limits
from designlab.trials.runner import Outcome

CLASSES: tuple[frozenset[str], ...] = (frozenset({"lens_distortion", "camera_pose"}),)
"""Effects declared indistinguishable in advance: naming one of a class counts as naming any.

A camera brought nearer magnifies: on both presets it brings about 99.5 % of what a wrong lens does.
"""


def score(outcomes: Iterable[Outcome]) -> dict[str, Any]:
    """Score trials.

    Returns
    -------
    dict
        `nothing`, `single` and `outside`: numbers of sets and of those named, rates with their 95 % interval;
        `confusion`: for each thing hidden, how often which name came first, or which verdict where none
        did; `limits`: see `detection.Limit`, of effects planted at several strengths; `rows`: one for each
        set.
    """
    outcomes = list(outcomes)
    nothing = [o for o in outcomes if not o.trial["effects"] and not o.trial["outside"]]
    single = [o for o in outcomes if len(o.trial["effects"]) == 1]
    outside = [o for o in outcomes if o.trial["outside"]]
    right = [_first_right(o) for o in single]
    removed = [share for o in single if (share := gap_removed(o)) is not None]
    sizes = [len(names) for o in single for names in o.sets[:1]]
    held = [inside for o in single for inside in _inside(o)]
    return {
        "nothing": {"sets": len(nothing), "named": sum(bool(o.named) for o in nothing)}
        | {"rate": rate(bool(o.named) for o in nothing)},
        "single": {
            "sets": len(single),
            "right_first": rate(right),
            "truth_in_set": rate(_in_set(o) for o in single),
            "set_size_mean": float(np.mean(sizes)) if sizes else None,
            "gap_removed_median": float(np.median(removed)) if removed else None,
            "intervals_hold": rate(held),
        },
        "outside": {"sets": len(outside), "named": sum(_names(o) for o in outside)}
        | {"rate": rate(_names(o) for o in outside)},
        "confusion": _confusion(outcomes),
        "limits": {kind: asdict(limit) for kind, limit in limits(_by_strength(single)).items()},
        "rows": [
            {
                "set": o.trial["name"],
                "design": o.trial["design"],
                "hidden": [*o.trial["effects"], *o.trial["outside"]],
                "verdict": o.verdict,
                "named": o.named,
                "sets": o.sets,
                "gap_removed": gap_removed(o),
                "seconds": o.processor_seconds,
            }
            for o in outcomes
        ],
    }


def _by_strength(single: Iterable[Outcome]) -> dict[str, list[tuple[float, bool]]]:
    """Strength of each set and whether it was named right, of kinds planted at several strengths."""
    found: dict[str, list[tuple[float, bool]]] = {}
    for o in single:
        ((kind, strength),) = o.trial["effects"].items()
        found.setdefault(kind, []).append((strength, _first_right(o)))
    return {kind: sets for kind, sets in found.items() if len({strength for strength, _ in sets}) > 1}


def rate(events: Iterable[bool]) -> dict[str, float] | None:
    """Share of sets of which something holds, with its 95 % interval (Clopper and Pearson 1934)."""
    from scipy.stats import binomtest

    counted = list(events)
    if not counted:
        return None
    interval = binomtest(sum(counted), len(counted)).proportion_ci(0.95, method="exact")
    return {
        "share": sum(counted) / len(counted),
        "low": float(interval.low),
        "high": float(interval.high),
        "sets": len(counted),
    }


def _confusion(outcomes: Iterable[Outcome]) -> dict[str, dict[str, int]]:
    """How often each first name, or verdict without one, came of what was hidden."""
    found: dict[str, dict[str, int]] = {}
    for o in outcomes:
        hidden = "+".join([*o.trial["effects"], *o.trial["outside"]]) or "nothing"
        said = o.named[0] if o.named else o.verdict.split(":")[0]
        row = found.setdefault(hidden, {})
        row[said] = row.get(said, 0) + 1
    return found


def same(one: str, other: str) -> bool:
    """Whether two names count as one."""
    return one == other or any(one in names and other in names for names in CLASSES)


def _first_right(o: Outcome) -> bool:
    truth = next(iter(o.trial["effects"]))
    return bool(o.named) and same(o.named[0], truth)


def _in_set(o: Outcome) -> bool:
    truth = next(iter(o.trial["effects"]))
    return any(same(name, truth) for names in o.sets for name in names)


def _names(o: Outcome) -> bool:
    """Whether a set outside the catalogue was given a name without reserve."""
    return o.verdict in ("named", "ambiguous")


def gap_removed(o: Outcome) -> float | None:
    """Share of the excess over the floor that is gone on the final presses."""
    level = o.gap.get("final")
    if not level or level["before"] <= level["floor"]:
        return None
    return float((level["before"] - level["after"]) / (level["before"] - level["floor"]))


def _inside(o: Outcome) -> Sequence[bool]:
    """Whether each stated interval of the right effect holds the truth."""
    truth = next(iter(o.trial["effects"]))
    found = o.parameters.get(truth, {})
    values = o.truth["effects"][truth]
    return [
        v["low"] <= values[p] <= v["high"] for p, v in found.items() if p in values and v["low"] is not None
    ]
