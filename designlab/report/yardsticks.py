"""What each score of an evaluation means, and what counts as good, with the reason or the source."""

from collections.abc import Mapping
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


_AREA = "Agarwal et al., Commun. Eng. 2025, doi 10.1038/s44172-025-00350-4"
YARDSTICKS: dict[str, Yardstick] = {
    "normal_error_mean_deg": Yardstick(
        "normal error, mean",
        "angle between reconstructed and true normals, on and around the contact",
        5,
        10,
        "normals within 5 deg count as right; a real, optimised sensor had 9.8 deg RMS in polar angle "
        f"({_AREA})",
    ),
    "height_rmse_um": Yardstick(
        "height error, RMS",
        "reconstructed against true height, on and around the contact",
        25,
        50,
        "5 % and 10 % of a press 0.5 mm deep",
    ),
    "information_deg": Yardstick(
        "information limit",
        "tilt that noise alone makes up on slopes up to 30 deg, in single pixels; smoothing can undercut it",
        1,
        2.5,
        "they add 2 % and 12 % to a normal error of 5 deg",
    ),
    "uniformity_u0": Yardstick(
        "uniformity U0",
        "darkest over mean of the untouched gel, worst LED group",
        0.55,
        0.3,
        "flat-field maps of a six-light GelSight have 0.56 to 0.69 (GelSight Inc., gssim); "
        "below 0.3 the darkest place has less than a third of the light",
    ),
    "slant_deg": Yardstick(
        "slant of the light",
        "angle to the normal of a distant light with the same effect, worst LED group",
        45,
        30,
        "the noise of slopes goes with 1 / sin(slant): 1.4 and 2 times that of grazing light",
    ),
    "shadow_share_30deg": Yardstick(
        "shadows on slopes of 30 deg",
        "share of the directions into which such a slope may face that lose one LED group",
        0.1,
        0.3,
        "a slope that loses one of three lights has two colours for two unknowns, none to spare",
    ),
    "press_saturation_share": Yardstick(
        "saturated contact",
        "share of the pixels on and around the contact that reach full scale",
        0.01,
        0.05,
        "a channel at full scale no longer changes with slope",
    ),
    "dynamic_range_use": Yardstick(
        "use of the camera's range",
        "bright end of the least exposed channel over full scale, untouched gel",
        0.25,
        0.125,
        "half the range stays free for slopes that face the light, which double it; below these limits "
        "one and two more bits of the camera are never used",
    ),
    "coverage": Yardstick(
        "coverage",
        "share of the sensing area that the camera sees",
        0.99,
        0.95,
        "what is not seen is not sensed",
    ),
    "stray_share": Yardstick(
        "stray light",
        "share of the light that does not come straight from the membrane, worst LED group",
        0.05,
        0.15,
        "it lowers the response to slope by as much",
    ),
    "saturation_share": Yardstick(
        "saturated gel",
        "share of the untouched gel at full scale",
        0.001,
        0.01,
        "a channel at full scale no longer changes with slope",
    ),
    "normals_within_5deg": Yardstick(
        "normals within 5 deg",
        "share of the normals on and around the contact",
        0.9,
        0.7,
        "nine and seven of ten",
    ),
    "rgb2normal": Yardstick(
        "RGB2Normal",
        "correlation of colour with the angle of normals along lines from the contact's middle",
        0.9,
        0.7,
        f"an area light reached 0.97 ({_AREA})",
    ),
    "colour_balance": Yardstick(
        "colour balance",
        "mean of the brightest over that of the dimmest camera channel",
        1.5,
        3.0,
        "photon noise of the dimmest channel is 1.2 and 1.7 times that of the brightest",
    ),
    "normal_error_median_deg": Yardstick(
        "normal error, median", "half of the normals are better", higher_is_better=False
    ),
    "height_mae_um": Yardstick(
        "height error, mean size", "reconstructed against true height", higher_is_better=False
    ),
    "uniformity_cv": Yardstick(
        "variation", "standard deviation over mean, worst LED group", higher_is_better=False
    ),
    "uniformity_min_max": Yardstick(
        "least over greatest", "darkest over brightest, worst LED group", higher_is_better=True
    ),
    "uniformity_nine_point": Yardstick(
        "nine points", "least over greatest mean of 9 cells, worst LED group", higher_is_better=True
    ),
    "uniformity_gradient": Yardstick(
        "gradient", "mean change across the width over mean, worst LED group", higher_is_better=False
    ),
    "combined_u0": Yardstick(
        "combined U0", "darkest over mean of the sum of the camera's channels", higher_is_better=True
    ),
    "combined_cv": Yardstick(
        "combined variation", "standard deviation over mean of that sum", higher_is_better=False
    ),
    "information_flat_deg": Yardstick(
        "information limit, flat",
        "tilt that camera noise alone makes up on the untouched gel",
        higher_is_better=False,
    ),
    "combined_min_max": Yardstick(
        "combined least over greatest", "darkest over brightest of that sum", higher_is_better=True
    ),
    "combined_nine_point": Yardstick(
        "combined nine points", "least over greatest mean of its 9 cells", higher_is_better=True
    ),
    "combined_gradient": Yardstick(
        "combined gradient", "its mean change across the width over mean", higher_is_better=False
    ),
}

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


def judged(scores: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Rows of a verdict: the scores that matter, each with its title, meaning, verdict and limits."""
    rows = [row(name, scores[name]) for name in (*HEADLINES, *ALARMS) if name in scores]
    return [r for r in rows if r["name"] in HEADLINES or not r["verdict"].startswith("good")]


def row(name: str, estimate: Mapping[str, Any]) -> dict[str, Any]:
    """One score with what it means."""
    unit = estimate["unit"]
    known = YARDSTICKS.get(name, Yardstick("", ""))
    return {
        "name": name,
        "score": label(name, unit),
        "title": (known.title or label(name)) + ("" if unit in ("", "1") else f" ({_UNITS.get(unit, unit)})"),
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


_REASONS = {
    "dark": "little light gets there, so the camera's noise weighs more",
    "flat response": "the picture hardly changes with slope there",
    "stray light": "light that did not come straight from the membrane lies over the picture there",
    "shadowed": "an LED group is missing there",
    "saturated": "the camera is at full scale there",
    "out of view": "the camera does not see it",
    "steep": "the membrane is steeper than what the balls have calibrated",
    "calibration": "none of the known reasons holds: the calibration itself errs there",
    "even": "no place is much worse than the others",
}
_REMEDIES = {
    "dark": "More or nearer LEDs on that side help, or a longer exposure.",
    "flat response": "Light that comes flatter, or from another side, helps.",
    "stray light": "A darker housing and a clearer core help.",
    "shadowed": "Light from a second side or from higher up helps.",
    "saturated": "A shorter exposure helps; so does light that grazes less.",
    "out of view": "Move the camera, or make the sensing area smaller.",
    "steep": "Smaller or deeper calibration balls help.",
    "calibration": "More calibration presses may help.",
    "even": "",
}


def worst_place(kind: str, place: Mapping[str, Any]) -> str:
    """Sentence about a worst place: `kind` is "gel" or "press"."""
    where = f"({place['x_mm']:.1f}, {place['y_mm']:.1f}) mm"
    reason = place["reason"]
    detail = f" ({place['detail']})" if place["detail"] else ""
    if kind == "gel":
        measure = f"information limit {place['value_deg']:.2g} deg, {place['times']:.1f} times the median"
        if reason in ("saturated", "out of view"):
            measure = "no slope can be told there"
        start = "Untouched gel"
    else:
        measure = f"normal error {place['value_deg']:.0f} deg, {place['times']:.1f} times the median"
        start = "Test presses"
    found = f"{start}: worst at {where}{detail}, {reason}: {_REASONS[reason]}; {measure}."
    return f"{found} {_REMEDIES[reason]}".strip()
