"""Outcomes of trials as a run would give them, without running any."""

from dataclasses import asdict

from designlab.validation.blind import Outcome, Trial

FLOOR = 1.75  # of which nothing hidden leaves 1


def outcome(
    trial: Trial,
    *,
    verdict: str,
    sets: list[list[str]],
    after: float = 2.0,
    confidence: float = 0.8,
    **truth: float,
) -> Outcome:
    effects = {name: dict(truth) for name in trial.effects}
    found = {
        names[0]: {
            p: {"value": 1.1 * v, "low": v - 0.1, "high": v + 0.1, "sd": 0.125, "null": 0.0, "fit_sd": 0.0}
            for p, v in truth.items()
        }
        for names in sets
        if names[0] in effects
    }
    return Outcome(
        trial=asdict(trial),
        truth={"effects": effects},
        verdict=verdict,
        named=[names[0] for names in sets],
        sets=sets,
        parameters=found,
        confidence=[confidence] * len(sets),
        control=0.1,
        next_frames=[],
        gap={
            use: {"before": 11.0, "after": after, "floor": FLOOR, "usual": 1.0, "removed": (11 - after) / 10}
            for use in ("select", "final")
        },
        candidates=[],
        seconds=1.0,
        processor_seconds=1.0,
        code="0123abcd4567",
    )
