"""Further frames, which a report asks for, are taken to see whether they tell apart what was ambiguous."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from designlab.core.progress import silent
from designlab.core.types import Progress
from designlab.validation.blind.pool import Trial
from designlab.validation.blind.runner import ALONE, Crew, Outcome, run
from designlab.validation.blind.score import rate, same


def run_further(
    trials: Iterable[Trial], folder: Path, *, progress: Progress = silent, crew: Crew = ALONE
) -> list[tuple[Outcome, Outcome]]:
    """Run trials, and those that are ambiguous once more with the frames that their reports ask for.

    Returns
    -------
    list of (Outcome, Outcome)
        Of each ambiguous set without and with these frames; the same where a report asks for none.
    """
    trials = list(trials)
    before = run(trials, folder, progress=progress, crew=crew)
    asked = [
        (trial, outcome)
        for trial, outcome in zip(trials, before, strict=True)
        if outcome.verdict == "ambiguous"
    ]
    again = [replace(trial, further=tuple(outcome.next_frames)) for trial, outcome in asked]
    after = run(again, folder, progress=progress, crew=crew)
    return [(outcome, then) for (_, outcome), then in zip(asked, after, strict=True)]


def summary(pairs: Sequence[tuple[Outcome, Outcome]]) -> dict[str, Any]:
    """How often the right name alone is left, and a row for each set."""
    return {
        "sets": len(pairs),
        "resolved": rate(resolved(after) for _, after in pairs),
        "rows": [
            {
                "set": before.trial["name"],
                "hidden": [*before.trial["effects"], *before.trial["outside"]],
                "sets": before.sets,
                "frames": before.next_frames,
                "verdict": after.verdict,
                "sets_after": after.sets,
                "resolved": resolved(after),
            }
            for before, after in pairs
        ],
    }


def resolved(o: Outcome) -> bool:
    """Whether every name is right and none stands beside another that does as well."""
    return bool(o.named) and all(
        any(same(name, truth) for truth in o.trial["effects"]) for names in o.sets for name in names
    )
