"""The verdict follows from what effects leave of the gap on presses not fitted to, and how sure names are."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from designlab.inference.diagnosis.result import GapReport, Level, Verdict
from designlab.inference.diagnosis.selection.held_out import CLOSED
from designlab.inference.diagnosis.verdict.confidence import SURE_ENOUGH, confidence

UNEXPLAINED_ABOVE = 0.5  # leftover share of the gap from which nothing is named
AT_FLOOR = 1.3  # mean squared residual over the floor below which there is no gap to explain
USUAL_SELECT = 6  # presses to choose by of the sets that confidence was learnt from
NAMELESS = ("unexplained", "at_floor")  # verdicts that name nothing


def verdict_of(alike: Sequence[Sequence[str]], gap: Level) -> Verdict:
    """Verdict by presses that were not fitted to, before anything is said of how sure names are.

    The floor is what the simulation may be wrong by. Names that leave more than half of what is not noise,
    grain or smooth errors of light have explained nothing. Where there is no gap, or where hardly anything
    is left, none is unexplained.

    Parameters
    ----------
    alike : sequence of sequence of str
        Of each effect found, those that do as well.
    gap : Level
        Of these presses.
    """
    if not alike:
        return "at_floor" if gap.after < AT_FLOOR * gap.floor else "unexplained"
    left = max(gap.after - gap.usual, 0.0)
    much = gap.after >= AT_FLOOR * gap.floor and left > CLOSED * gap.floor
    if much and left > UNEXPLAINED_ABOVE * (gap.before - gap.usual):
        return "unexplained"
    return "ambiguous" if any(len(names) > 1 for names in alike) else "named"


def settled(verdict: Verdict, alike: Sequence[Sequence[str]], gap: Mapping[str, Level]) -> Verdict:
    """Verdict that presses which had no say in it do not speak against: it can become weaker only."""
    if verdict == "at_floor":
        others = max(gap[name].before / gap[name].floor for name in ("train", "final"))
        return verdict if others < AT_FLOOR else "unexplained"
    own = verdict_of(alike, gap["final"])
    return "partial" if verdict in ("named", "ambiguous") and own == "unexplained" else verdict


def sure(report: GapReport, presses: int) -> GapReport:
    """Say how sure each name is; one that is more likely wrong than right explains a part at best."""
    content = report.to_json()
    verdict = report.verdict
    if report.effects and confidence(content, 0) < SURE_ENOUGH:
        verdict = "partial"
    # Few presses cannot make anything certain (rule of succession), whatever many have taught.
    most = (presses + 1) / (presses + 2) if presses < USUAL_SELECT else 1.0
    effects = (
        replace(found, confidence=min(confidence(content, place), most))
        for place, found in enumerate(report.effects)
    )
    return replace(report, verdict=verdict, effects=tuple(effects))
