"""Pools of planted sets, and what their scores count."""

from dataclasses import asdict

import pytest

from designlab.design import preset
from designlab.plant import effects as planted
from designlab.plant.beyond import outside_kinds
from designlab.trials import Outcome, Trial, development, score

POOL = development()


def outcome(
    trial: Trial, *, verdict: str, sets: list[list[str]], after: float = 2.0, **truth: float
) -> Outcome:
    effects = {name: dict(truth) for name in trial.effects}
    found = {
        names[0]: {p: {"value": v, "low": v - 0.1, "high": v + 0.1} for p, v in truth.items()}
        for names in sets
    }
    return Outcome(
        trial=asdict(trial),
        truth={"effects": effects},
        verdict=verdict,
        named=[names[0] for names in sets],
        sets=sets,
        parameters=found,
        gap={"final": {"before": 11.0, "after": after, "floor": 1.0}},
        candidates=[],
        seconds=1.0,
        processor_seconds=1.0,
    )


def test_the_pool_holds_what_it_should() -> None:
    assert sum(trial.kind == "nothing" for trial in POOL) == 30
    assert len({trial.kind for trial in POOL if trial.effects}) >= 16
    assert sum(bool(trial.outside) for trial in POOL) == 18
    assert len({trial.name for trial in POOL}) == len({trial.seed for trial in POOL}) == len(POOL)
    assert not {t.seed for t in development(base=10_000)} & {t.seed for t in POOL}


def test_every_set_can_be_planted() -> None:
    known = set(planted.names())
    for trial in POOL:
        assert preset(trial.design).name == trial.design
        assert set(trial.effects) <= known
        assert set(trial.outside) <= set(outside_kinds())


def test_names_sets_gaps_and_intervals_are_counted() -> None:
    nothing, wrong = Trial("n", "d", 1), Trial("w", "d", 2, {"vignetting": 1.0})
    right, strange = Trial("r", "d", 3, {"vignetting": 1.0}), Trial("s", "d", 4, outside={"debris": 1.0})
    found = score(
        [
            outcome(nothing, verdict="at_floor", sets=[]),
            outcome(nothing, verdict="named", sets=[["banding"]]),
            outcome(right, verdict="named", sets=[["vignetting"]], after=2.0, corner_loss=0.3),
            outcome(wrong, verdict="ambiguous", sets=[["albedo_field", "vignetting"]], after=7.0),
            outcome(strange, verdict="partial", sets=[["banding"]]),
            outcome(strange, verdict="named", sets=[["banding"]]),
        ]
    )
    assert found["nothing"] == {"sets": 2, "named": 1}
    assert found["outside"] == {"sets": 2, "named": 1}
    single = found["single"]
    assert (single["right_first"], single["truth_in_set"], single["intervals_hold"]) == (0.5, 1.0, 1.0)
    assert single["gap_removed_median"] == pytest.approx((0.9 + 0.4) / 2)
