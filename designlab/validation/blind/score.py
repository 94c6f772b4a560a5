"""The score of a pool counts names right and wrong, the gap removed, and intervals that hold."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.inference.diagnosis.verdict.confidence import SURE_ENOUGH
from designlab.sensor.design import preset
from designlab.simulation.effects import effect
from designlab.validation.blind.detection import in_units, limits
from designlab.validation.blind.pool import AIR
from designlab.validation.blind.runner import Outcome

Row = dict[str, Any]
"""What is kept of a set, see `record`."""

CLASSES: tuple[frozenset[str], ...] = (frozenset({"lens_distortion", "camera_pose"}),)
"""Effects declared indistinguishable in advance: naming one of a class counts as naming any.

A camera brought nearer magnifies: on both presets it brings about 99.5 % of what a wrong lens does.
"""
WITHOUT_RESERVE = ("named", "ambiguous")
ABSTAINED = ("unexplained", "partial", "refused")  # verdicts that say that not all is known
BINS = 5  # of equal mass, for the error of the confidence
SURE = 0.9  # confidence from which a name is meant to be relied upon


def score(outcomes: Iterable[Outcome]) -> dict[str, Any]:
    """Score trials, see `scored`."""
    return scored([record(o) for o in outcomes])


def scored(rows: Iterable[Row]) -> dict[str, Any]:
    """Score trials by their records.

    Returns
    -------
    dict
        `nothing`, `single`, `pair`, `outside` and `left_out` (sets whose effect was taken out of the
        catalogue): numbers of sets, rates with their 95 % interval, medians; `confidence`: how it agrees
        with how often names are right; `sure_names`: how often names of a confidence of 0.9 or more are
        right; `risk_coverage`: see there; `confusion`: for each thing hidden, how often which name came
        first, or which verdict where none did; `limits`: see `detection.Limit`, of effects planted at several
        strengths; `codes`: digests of the code that ran them, one unless a pool went on after a change;
        `rows`: the records.
    """
    rows = list(rows)
    families = {name: [row for row in rows if row["family"] == name] for name in _FAMILIES}
    return {name: _FAMILIES[name](sets) for name, sets in families.items()} | {
        "confidence": reliability(sure(rows)),
        "sure_names": rate(right for confidence, right in sure(rows) if confidence >= SURE),
        "risk_coverage": risk_coverage(rows),
        "confusion": _confusion(rows),
        "limits": _limits(families["single"]),
        "codes": sorted({row["code"] for row in rows}),
        "rows": rows,
    }


def record(o: Outcome) -> Row:
    """Record of a set: all that rates and medians are counted from."""
    inside = _inside(o)
    return {
        "set": o.trial["name"],
        "design": o.trial["design"],
        "seed": o.trial["seed"],
        "kit": o.trial["kit"],
        "family": family(o.trial),
        "hidden": {**o.trial["effects"], **o.trial["outside"]},
        "without": list(o.trial["without"]),
        "verdict": o.verdict,
        "named": o.named,
        "sets": o.sets,
        "confidence": o.confidence,
        "gap_removed": (o.gap.get("final") or {}).get("removed"),  # share, on the final presses
        "control_removed": o.control,
        "value_errors": [round(error, 4) for error in value_errors(o)],
        "intervals": [sum(inside), len(inside)],
        "seconds": round(o.processor_seconds, 1),
        "code": o.code,
    }


def family(trial: Mapping[str, Any]) -> str:
    """Which part of a pool a set belongs to, by the fields of its trial."""
    if trial["outside"]:
        return "outside"
    if trial["without"]:
        return "left_out"
    return {0: "nothing", 1: "single"}.get(len(trial["effects"]), "pair")


def _nothing(sets: Sequence[Row]) -> dict[str, Any]:
    return {"sets": len(sets), "named": rate(bool(row["named"]) for row in sets)}


def _hidden(sets: Sequence[Row]) -> dict[str, Any]:
    """Of sets whose effects are in the catalogue."""
    removed = [row["gap_removed"] for row in sets if row["gap_removed"] is not None]
    controls = [row["control_removed"] for row in sets if row["control_removed"] is not None]
    errors = [error for row in sets for error in row["value_errors"]]
    sizes = [len(names) for row in sets for names in row["sets"][:1]]
    held = [number < row["intervals"][0] for row in sets for number in range(row["intervals"][1])]
    return {
        "sets": len(sets),
        "right_first": rate(_first_right(row) for row in sets),
        "all_named": rate(all_named(row) for row in sets),
        "truth_in_set": rate(_in_set(row) for row in sets),
        "sure": rate(bool(row["named"]) and row["confidence"][0] >= SURE for row in sets),
        "further_wrong": rate(_further_wrong(row) for row in sets),
        "set_size_mean": float(np.mean(sizes)) if sizes else None,
        "gap_removed_median": float(np.median(removed)) if removed else None,
        "control_removed_median": float(np.median(controls)) if controls else None,
        "value_error_median": float(np.median(errors)) if errors else None,
        "intervals_hold": rate(held),
    }


def _foreign(sets: Sequence[Row]) -> dict[str, Any]:
    """Of sets whose cause is not in the catalogue: any name without reserve is wrong."""
    return {
        "sets": len(sets),
        "named": rate(row["verdict"] == "named" for row in sets),
        "named_or_ambiguous": rate(row["verdict"] in WITHOUT_RESERVE for row in sets),
        "abstained": rate(row["verdict"].split(":")[0] in ABSTAINED for row in sets),
    }


_FAMILIES: dict[str, Callable[[Sequence[Row]], dict[str, Any]]] = {
    "nothing": _nothing,
    "single": _hidden,
    "pair": _hidden,
    "outside": _foreign,
    "left_out": _foreign,
}


def sure(rows: Iterable[Row]) -> list[tuple[float, bool]]:
    """Confidence of every name given, and whether it was right."""
    return [
        (confidence, any(same(name, truth) for truth in row["hidden"]))
        for row in rows
        for name, confidence in zip(row["named"], row["confidence"], strict=True)
    ]


def risk_coverage(rows: Iterable[Row]) -> dict[str, Any] | None:
    """Area under the curve of risk over coverage of first names (Geifman and El-Yaniv, NIPS 2017).

    The most confident names are taken first, equal ones in the worst order: the wrong ones before the right.
    The risk is the share of wrong names among those taken, the area its mean over how many are.

    Returns
    -------
    dict or None
        `area`; `names`, their number; `wrong`, the share of wrong ones, which is the risk of taking all.

    Examples
    --------
    >>> row = {"hidden": {"banding": 1.0}, "verdict": "named"}
    >>> right = row | {"named": ["banding"], "confidence": [0.9]}
    >>> wrong = row | {"named": ["led_tilt"], "confidence": [0.5]}
    >>> risk_coverage([wrong, right])["area"]
    0.25
    """
    firsts = [row | {"named": row["named"][:1], "confidence": row["confidence"][:1]} for row in rows]
    said = sorted(sure(firsts), key=lambda name: (-name[0], name[1]))
    if not said:
        return None
    risks = np.cumsum([not right for _, right in said]) / np.arange(1, len(said) + 1)
    return {"area": float(risks.mean()), "names": len(said), "wrong": float(risks[-1])}


def reliability(said: Sequence[tuple[float, bool]]) -> dict[str, Any] | None:
    """How confidence agrees with how often it is right, in bins of equal mass.

    Returns
    -------
    dict or None
        `bins`: mean confidence, share right with its 95 % interval, and number of each; `error`: mean
        distance of the two, by number (expected calibration error).

    Examples
    --------
    >>> reliability([(0.5, True), (0.5, False)] * 10)["error"]
    0.0
    """
    if len(said) < BINS:
        return None
    pairs = np.array(said, dtype=float)
    bins = []
    for part in equal_mass(pairs[:, 0]):
        right = rate((pairs[part, 1] > 0).tolist())
        assert right is not None  # no part is empty
        ends = {"low": right["low"], "high": right["high"]}
        stated = float(pairs[part, 0].mean())
        bins.append({"confidence": stated, "right": right["share"], "names": len(part)} | ends)
    error = sum(b["names"] * abs(b["confidence"] - b["right"]) for b in bins) / len(said)
    return {"error": float(error), "names": len(said), "bins": bins}


def equal_mass(values: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Places of values in up to `BINS` bins of equal mass, in rising order.

    Equal values stay together: their order says nothing.
    """
    order = np.argsort(values, kind="stable")
    ordered = values[order]
    starts = range(0, len(values), -(-len(values) // BINS))
    edges = sorted({int(np.searchsorted(ordered, ordered[k])) for k in starts})
    return np.split(order, [edge for edge in edges if edge > 0])


def _limits(single: Iterable[Row]) -> dict[str, dict[str, Any]]:
    """Detection limit of each kind that was planted at several strengths, and the sets that tell it."""
    sets: dict[str, list[tuple[float, bool, str]]] = {}
    for row in single:
        ((kind, strength),) = row["hidden"].items()
        sets.setdefault(kind, []).append((strength, _first_right(row), row["design"]))
    sets = {kind: sorted(tried) for kind, tried in sets.items() if len({s for s, *_ in tried}) > 1}
    return {
        kind: asdict(limit)
        | {"in_units": in_units(kind, limit.strength, preset(AIR[0])), "tried": sets[kind]}
        for kind, limit in limits(sets).items()
    }


def rate(events: Iterable[bool]) -> dict[str, float] | None:
    """Share of sets of which something holds, with its 95 % interval (Clopper and Pearson 1934)."""
    from scipy.stats import binomtest

    counted = list(events)
    if not counted:
        return None
    held, sets = sum(counted), len(counted)
    low, high = binomtest(held, sets).proportion_ci(0.95, method="exact")
    return {"share": held / sets, "low": float(low), "high": float(high), "sets": sets}


def _confusion(rows: Iterable[Row]) -> dict[str, dict[str, int]]:
    """How often each first name, or verdict without one, came of what was hidden."""
    found: dict[str, Counter[str]] = {}
    for row in rows:
        hidden = "+".join(row["hidden"]) or "nothing"
        if row["without"]:
            hidden += ", not in the catalogue"
        said = row["named"][0] if row["named"] else row["verdict"].split(":")[0]
        found.setdefault(hidden, Counter())[said] += 1
    return {hidden: dict(counts) for hidden, counts in found.items()}


def same(one: str, other: str) -> bool:
    """Whether two names count as one."""
    return one == other or any(one in names and other in names for names in CLASSES)


def _first_right(row: Row) -> bool:
    return bool(row["named"]) and any(same(row["named"][0], truth) for truth in row["hidden"])


def _stated(row: Row) -> list[str]:
    """Names that a report states: the first, and others that are as likely right as wrong."""
    further = zip(row["named"][1:], row["confidence"][1:], strict=True)
    return [*row["named"][:1], *(name for name, confidence in further if confidence >= SURE_ENOUGH)]


def _further_wrong(row: Row) -> bool:
    """Whether an effect was stated besides the first that is not there."""
    return any(not any(same(name, truth) for truth in row["hidden"]) for name in _stated(row)[1:])


def all_named(row: Row) -> bool:
    """Whether every hidden effect was stated."""
    return all(any(same(name, truth) for name in _stated(row)) for truth in row["hidden"])


def _in_set(row: Row) -> bool:
    """Whether each hidden effect is in one of the reported sets."""
    return all(any(same(name, truth) for names in row["sets"] for name in names) for truth in row["hidden"])


def value_errors(o: Outcome) -> list[float]:
    """Distance of the values of each right name from the truth, over the truth's from null.

    In prior standard deviations; parameters that only shape an effect do not count.
    """
    design, found = preset(o.trial["design"]), []
    for name, truth in o.truth["effects"].items():
        values = o.parameters.get(name)
        if not values:
            continue
        counted = [p.name for p in effect(name).parameters(design) if not p.shape]
        away = [(values[p]["value"] - truth[p]) / values[p]["sd"] for p in counted]
        size = [(truth[p] - values[p]["null"]) / values[p]["sd"] for p in counted]
        if np.linalg.norm(size) > 0:
            found.append(float(np.linalg.norm(away) / np.linalg.norm(size)))
    return found


def _inside(o: Outcome) -> Sequence[bool]:
    """Whether each stated interval of the right effects holds the truth."""
    return [
        v["low"] <= truth[p] <= v["high"]
        for name, truth in o.truth["effects"].items()
        for p, v in o.parameters.get(name, {}).items()
        if p in truth and v["low"] is not None
    ]
