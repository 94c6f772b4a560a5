"""Scores of a design as the studio asks for them: given up at once when something newer comes."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

from designlab.app.studio.newest import Superseded
from designlab.app.studio.pictures import unless
from designlab.evaluation.evaluate import evaluate
from designlab.evaluation.paired_comparison import differences
from designlab.evaluation.score import Score
from designlab.report.page import rounded
from designlab.report.yardsticks import judged
from designlab.sensor.design import Design

FIDELITY, SEED = "fast", 0


class ScoreRow(NamedTuple):
    """A score as the page shows it; `change` is that since the pin, empty where there is none."""

    name: str
    title: str
    value: str
    verdict: str
    meaning: str
    limits: str
    change: str = ""
    clear: bool = False


def scored(design: Design, waits: Callable[[], bool]) -> Score:
    """Score a design.

    Raises
    ------
    Superseded
        As soon as `waits` says that something newer does.
    """

    def progress(what: str, done: int, total: int) -> None:
        if waits():
            raise Superseded

    with unless(waits):
        return evaluate(design, fidelity=FIDELITY, seed=SEED, progress=progress).score


def rows(score: Score, pinned: Score | None) -> list[ScoreRow]:
    """The main scores with verdict and yardstick, and their change since the pinned design."""
    told: dict[str, Any] = {}
    if pinned is not None:
        with suppress(
            ValueError
        ):  # other presses, as of designs with other sensing areas: nothing to compare
            told = dict(differences(pinned, score))
    found = []
    for row in judged(score.to_json()["scores"], score.presses.get("depth_mm", ())):
        change, clear = "", False
        if (difference := told.get(row["name"])) is not None:
            change, clear = f"{difference.value:+.3g} ± {difference.se:.1g}", bool(difference.differs)
        found.append(
            ScoreRow(
                row["name"],
                row["title"],
                rounded(row["value"], row["se"]),
                row["verdict"],
                row["meaning"],
                row["limits"],
                change,
                clear,
            )
        )
    return found
