"""What each score of an evaluation means, and what counts as good, with the reason or the source."""

import tomllib
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

from designlab.report.page import label

_UNITS = {"um": "µm"}


class Yardstick(NamedTuple):
    """Meaning of a score and its limits.

    Parameters
    ----------
    title, meaning : str
        Name for people, and what it says.
    good, fair : float, optional
        Values from which a score is good or fair; a higher one is better if `good` is above `fair`.
    reason : str
        Why these.
    higher_is_better : bool, optional
        For scores without limits.
    """

    title: str
    meaning: str
    good: float | None = None
    fair: float | None = None
    reason: str = ""
    higher_is_better: bool | None = None

    @property
    def rising(self) -> bool | None:
        """Whether a higher score is better, None where that cannot be said."""
        if self.good is None or self.fair is None:
            return self.higher_is_better
        return self.good > self.fair

    def verdict(self, value: float, se: float) -> str:
        """Good, fair or poor; "borderline" within one standard error of a limit; nothing without limits."""
        if self.good is None or self.fair is None:
            return ""
        sign = 1.0 if self.good > self.fair else -1.0
        word = "poor"
        if sign * value >= sign * self.fair:
            word = "good" if sign * value >= sign * self.good else "fair"
        close = min(abs(value - self.good), abs(value - self.fair)) < se
        return f"{word}, borderline" if close else word

    def limits(self, unit: str) -> str:
        """The limits in words."""
        if self.good is None or self.fair is None:
            return ""
        way = "at least" if self.good > self.fair else "at most"
        after = "" if unit in ("", "1") else f" {_UNITS.get(unit, unit)}"
        return f"good {way} {self.good:g}{after}, fair {self.fair:g}{after}: {self.reason}"


_TABLES = tomllib.loads(files(__package__).joinpath("yardsticks.toml").read_text(encoding="utf-8"))
YARDSTICKS = {name: Yardstick(**fields) for name, fields in _TABLES["scores"].items()}


def score_label(name: str, unit: str = "") -> str:
    """Name of a score as people read it, the same on every page, with its unit in brackets.

    What a study makes of a score, such as the mean over copies, stands before it.

    Examples
    --------
    >>> score_label("normal_error_median_deg", "deg")
    'normal error, median (deg)'
    >>> score_label("worst of uniformity_u0")
    'worst of uniformity U0'
    """
    what, of, bare = name.rpartition(" of ")
    known = YARDSTICKS.get(bare)
    title = known.title if known is not None and known.title else label(bare, unit).partition(" (")[0]
    after = "" if unit in ("", "1") else f" ({_UNITS.get(unit, unit)})"
    return f"{what}{of}{title}{after}"


HEADLINES = (
    "normal_error_mean_deg",
    "height_rmse_um",
    "information_deg",
    "uniformity_u0",
    "slant_deg",
    "shadow_share_30deg",
    "press_saturation_share",
    "dynamic_range_use",
)
"""Scores a verdict always shows."""
ALARMS = ("coverage", "stray_share", "saturation_share")
"""Scores it shows where they are not good."""


def judged(scores: Mapping[str, Mapping[str, Any]], depths_mm: Sequence[float] = ()) -> list[dict[str, Any]]:
    """Rows of a verdict: the scores that matter, each with its title, meaning, verdict and limits.

    Depths are those of presses of equal force, which heights are told with.
    """
    rows = [row(name, scores[name], depths_mm) for name in (*HEADLINES, *ALARMS) if name in scores]
    return [r for r in rows if r["name"] in HEADLINES or not r["verdict"].startswith("good")]


def row(name: str, estimate: Mapping[str, Any], depths_mm: Sequence[float] = ()) -> dict[str, Any]:
    """One score with what it means; depths as in `judged`."""
    unit = estimate["unit"]
    at = ""
    if len(depths_mm) and name.startswith("height_"):
        at = f", presses {min(depths_mm):.2g} to {max(depths_mm):.2g} mm deep"
    known = YARDSTICKS.get(name, Yardstick("", ""))
    return {
        "name": name,
        "score": score_label(name, unit) + at,
        "title": score_label(name, unit) + at,
        "meaning": known.meaning,
        "verdict": known.verdict(estimate["value"], estimate["se"]),
        "limits": known.limits(unit),
        **estimate,
    }


def summary(rows: list[dict[str, Any]]) -> str:
    """One sentence about the rows of a verdict."""
    by_word: dict[str, list[str]] = {"good": [], "fair": [], "poor": []}
    for entry in rows:
        if entry["verdict"]:
            by_word[entry["verdict"].partition(",")[0]].append(entry["title"].partition(" (")[0])
    total = sum(len(titles) for titles in by_word.values())
    if len(by_word["good"]) == total:
        return f"All {total} main scores are good."
    parts = [f"{len(by_word['good'])} of {total} main scores are good."]
    parts += [
        f"{word.capitalize()}: {', '.join(by_word[word])}." for word in ("poor", "fair") if by_word[word]
    ]
    return " ".join(parts)


def worst_place(kind: str, place: Mapping[str, Any]) -> str:
    """Sentence about a worst place: `kind` is "gel" or "press"."""
    where = f"({place['x_mm']:.1f}, {place['y_mm']:.1f}) mm"
    reason, told = place["reason"], _TABLES["worst_places"][place["reason"]]
    detail = f" ({place['detail']})" if place["detail"] else ""
    if kind == "gel":
        measure = f"information limit {place['value_deg']:.2g} deg, {place['times']:.1f} times the median"
        if reason in ("saturated", "out of view"):
            measure = "no slope can be told there"
        start = "Untouched gel"
    else:
        measure = f"normal error {place['value_deg']:.0f} deg, {place['times']:.1f} times the median"
        start = "Test presses"
    found = f"{start}: worst at {where}{detail}, {reason}: {told['reason']}; {measure}."
    return f"{found} {told['remedy']}".strip()
