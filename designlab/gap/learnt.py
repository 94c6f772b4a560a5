"""What generated sets with known answers have taught about diagnoses: how far their values can be trusted.

A fit knows noise and the errors that are granted to the simulation. What no catalogue lists pulls values too,
in the same way in all frames, and by how much only sets with known answers tell.
"""

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

FILE = "learnt.json"
"""Written by ``designlab gap benchmark`` for whole pools, power or calibration."""


def unlisted_sd(effect: str, parameter: str, *, shape: bool) -> float:
    """Standard deviation of what the unlisted does to a fitted value, in prior standard deviations.

    Parameters
    ----------
    effect, parameter : str
        Names; an effect that was never seen has the median of all.
    shape : bool
        Whether the parameter only says how another acts: such have values of their own, all others of an
        effect share one.
    """
    known: dict[str, float] = _learnt()["unlisted_sd"]
    if shape and f"{effect}.{parameter}" in known:
        return known[f"{effect}.{parameter}"]
    if effect in known:
        return known[effect]
    ordered = sorted(known.values())
    return ordered[len(ordered) // 2]


def left_of_nothing() -> float:
    """Mean squared residual over the floor that is usual of sets in which nothing is hidden."""
    return float(_learnt()["left_of_nothing"])


@cache
def _learnt() -> Mapping[str, Any]:
    content: Mapping[str, Any] = json.loads(files("designlab.gap").joinpath(FILE).read_text(encoding="utf-8"))
    return content
