"""What pools teach: detection limits, how often names are right, what fits do not know of their errors."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.special import expit

from designlab.inference.diagnosis.likelihood.empirical_errors import known
from designlab.inference.diagnosis.verdict.confidence import SIGNS, share_right, sum_of
from designlab.validation.blind import Outcome, Trial, development, power
from designlab.validation.blind.detection import limits
from designlab.validation.blind.learn import (
    dirt_sd,
    learnt,
    like_dirt,
    named,
    shares_right,
    spread,
    unlisted_sd,
    with_records,
)
from designlab.validation.blind.pool import AIR, STRENGTHS
from designlab.validation.blind.score import reliability
from designlab.validation.synthetic import effects as planted
from tests.helpers.outcomes import outcome


def tried(trial: Trial, name: str, *, after: float, gain: float, rival: float) -> Outcome:
    """Record of a set of which one effect was named, with evidence 100, another having `rival`."""
    own = {"name": name, "round": 1, "outcome": "passed", "gain": gain, "evidence": 100.0}
    other = {"name": "banding", "round": 1, "outcome": "passed", "gain": 0.1, "evidence": rival}
    found = outcome(trial, verdict="named", sets=[[name]], after=after)
    return replace(found, candidates=[own, other])


def test_confidence_is_the_share_of_right_names_among_those_alike() -> None:
    random = np.random.default_rng(7)
    hidden = Trial("single", AIR[0], 1, {"vignetting": 1.0})

    def drawn(count: int) -> list[Outcome]:
        found = []
        for _ in range(count):
            left, gain, rival = random.uniform(0.0, 3.0), random.uniform(0.05, 1.0), random.uniform(1.0, 99.0)
            # What is left tells; evidence of rivals says nothing here.
            right = random.random() < expit(4.0 - 2.5 * left + np.log(gain))
            name = "vignetting" if right else "led_tilt"
            found.append(tried(hidden, name, after=float(np.exp(left)), gain=gain, rival=rival))
        return found

    taught = shares_right(drawn(400))
    weights = taught["weights"]
    assert weights["left"] < -1.5
    assert weights["gain"] > 0.4
    assert abs(weights["margin"]) < 0.3
    assert weights["set"] == weights["later"] == 0.0  # the same of all
    assert np.all(np.diff(taught["right"]) >= 0)
    seen, right = named(drawn(2000))
    said = np.interp(seen @ [weights[name] for name in SIGNS], taught["scores"], taught["right"])
    error = reliability(list(zip(said, right, strict=True)))
    assert error is not None
    assert error["error"] < 0.05
    assert error["bins"][0]["right"] < 0.4 < 0.9 < error["bins"][-1]["right"]


def test_the_sum_behind_a_confidence_is_found_again() -> None:
    scores, right = [-1.0, 0.0, 1.0, 2.0], [0.5, 0.8, 0.9, 0.9]
    for total in (-4.0, -1.0, -0.5, 0.5):
        assert sum_of(share_right(total, scores, right), scores, right) == pytest.approx(total)
    assert sum_of(0.9, scores, right) == 1.5  # of all from 1 on
    assert sum_of(0.95, scores, right) == 2.0  # stated never


def test_records_move_confidence_to_how_often_names_were_right() -> None:
    """Drawn names of which a stated half is right always, and the surest three in four times."""
    random = np.random.default_rng(3)
    before = known()["confidence"]
    low, high = 0.5, before["right"][-1]

    def rows(count: int) -> list[dict[str, object]]:
        found = []
        for _ in range(count):
            stated = low if random.random() < 0.5 else high
            right = stated == low or random.random() < 0.75
            hidden = {"banding" if right else "vignetting": 1.0}
            found.append({"named": ["banding"], "confidence": [stated], "hidden": hidden})
        return found

    after = with_records(rows(3000))
    assert np.all(np.diff(after["scores"]) > 0)
    assert np.all(np.diff(after["right"]) >= 0)
    assert after["names"] == before["names"] + 3000
    assert after["weights"] == before["weights"]
    said = [
        share_right(sum_of(stated, before["scores"], before["right"]), after["scores"], after["right"])
        for stated in (low, high)
    ]
    # shares may not fall: where the surest are right less often, both get the share of all
    assert said == pytest.approx([0.875, 0.875], abs=0.03)
    assert share_right(9.0, after["scores"], after["right"]) == pytest.approx(0.875, abs=0.03)
    few = with_records(rows(40))
    assert 0.8 < share_right(9.0, few["scores"], few["right"]) < high
    with pytest.raises(ValueError, match="hold no name"):
        with_records([{"named": [], "confidence": [], "hidden": {}}])


def test_records_that_are_right_as_stated_change_nothing() -> None:
    random, before = np.random.default_rng(5), known()["confidence"]
    stated = [round(share_right(t, before["scores"], before["right"]), 3) for t in np.linspace(-0.8, 2.5, 12)]
    rows = [
        {"named": ["banding"], "confidence": [each], "hidden": {name: 1.0}}
        for each in stated
        for name in np.where(random.random(2000) < each, "banding", "vignetting")
    ]
    after = with_records(rows)
    for each in stated:
        total = sum_of(each, before["scores"], before["right"])
        assert share_right(total, after["scores"], after["right"]) == pytest.approx(each, abs=0.02)


def test_confidence_falls_below_all_that_was_seen_as_the_regression_says() -> None:
    scores, right = [-1.0, 0.0, 2.0], [0.5, 0.8, 0.9]
    said = [share_right(total, scores, right) for total in (-4.0, -1.0, -0.5, 2.0, 9.0)]
    assert said == pytest.approx([1 / (1 + np.exp(3.0)), 0.5, 0.65, 0.9, 0.9])


def test_names_of_partial_verdicts_count_like_all_others() -> None:
    hidden = Trial("single", AIR[0], 1, {"vignetting": 1.0})
    right = [tried(hidden, "vignetting", after=1.0, gain=0.9, rival=9.0) for _ in range(20)]
    wrong = [tried(hidden, "led_tilt", after=9.0, gain=0.9, rival=9.0) for _ in range(20)]
    taught = shares_right([*right, *(replace(o, verdict="partial") for o in wrong)])
    assert taught["names"] == 40
    assert taught["right"][0] < 0.1 < 0.9 < taught["right"][-1]


def test_a_sign_cannot_count_against_what_is_known_of_it() -> None:
    """By chance, names that leave more may be right more often among few."""
    hidden = Trial("single", AIR[0], 1, {"vignetting": 1.0})
    few = [tried(hidden, "vignetting", after=5.0 + k, gain=0.5, rival=1.0) for k in range(8)]
    few += [tried(hidden, "led_tilt", after=1.0 + 0.1 * k, gain=0.5, rival=1.0) for k in range(8)]
    taught = shares_right(few)
    assert taught["weights"]["left"] == 0.0
    assert taught["right"] == [0.5]  # nothing tells them apart, in whatever order they come
    assert shares_right(few[::-1])["right"] == [0.5]
    with pytest.raises(ValueError, match="4 names teach nothing, 15 are needed"):
        shares_right(few[:4])


def test_a_pool_teaches_what_it_shows_and_keeps_the_rest() -> None:
    nothing = [outcome(Trial(f"n{k}", AIR[0], k), verdict="at_floor", sets=[]) for k in range(3)]
    hidden = Trial("single", AIR[0], 1, {"vignetting": 1.0})
    one = tried(hidden, "vignetting", after=1.0, gain=0.5, rival=1.0)
    far = outcome(hidden, verdict="named", sets=[["vignetting"]], corner_loss=1.0)
    shown = replace(one, truth=far.truth, parameters=far.parameters)
    found = learnt([*nothing, *[shown] * 15])
    assert found["confidence"]["names"] == 15
    before = known()["unlisted_sd"]
    assert found["unlisted_sd"].keys() == before.keys()
    assert {k for k, v in found["unlisted_sd"].items() if v != before[k]} == {"vignetting"}
    assert found["unlisted_sd"]["vignetting"] == pytest.approx(0.4, rel=0.1)  # a tenth, of 0.25 each


def test_dirt_teaches_how_large_it_makes_effects_that_are_not_there() -> None:
    """Values by chance of a known spread, told with errors that differ between parameters and sets."""
    random = np.random.default_rng(3)

    def told(size: float, count: int = 300) -> list[dict[str, tuple[np.ndarray, np.ndarray]]]:
        sets = []
        for _ in range(count):
            turned, _ = np.linalg.qr(random.standard_normal((3, 3)))
            information = turned @ np.diag(random.uniform(0.0, 400.0, 3)) @ turned.T
            chance = np.linalg.cholesky(information) @ random.standard_normal(3)
            right = information @ (size * random.standard_normal(3)) + chance
            sets.append({"led_profile": (information, right)})
        return sets

    for size in (0.1, 0.3):
        assert dirt_sd(told(size))["led_profile"] == pytest.approx(size, rel=0.1)
    assert dirt_sd(told(0.0))["led_profile"] < 0.02
    assert dirt_sd(told(0.1, 2)) == {}  # too few to tell
    # One set far away among few that are near: no smaller size than that of which it is not surely beyond.
    sharp = np.diag([1e6])
    few = [{"vignetting": (sharp, sharp @ [value])} for value in (*[0.0] * 20, 0.6)]
    assert dirt_sd(few)["vignetting"] == pytest.approx(0.6 / 3, rel=0.03)
    assert like_dirt(few) == ["vignetting"]
    assert like_dirt(few[:-1]) == []


def test_the_error_that_fits_do_not_know_is_found_again() -> None:
    random = np.random.default_rng(5)
    stated = random.uniform(0.0, 0.2, 2000)
    errors = random.normal(0.0, np.hypot(0.3, stated))
    assert spread(list(zip(errors, stated, strict=True))) == pytest.approx(0.3, rel=0.05)
    # One value that is hit precisely does not outweigh one that is missed by ten stated errors.
    assert spread([(0.0, 0.001), (1.0, 0.1)]) > 0.3
    # What stated errors explain leaves what is usual; that is less the more sets there are.
    few, many = (spread([(e, 0.05) for e in random.normal(0, 0.05, n)]) for n in (3, 3000))
    assert many < few < 0.2
    assert many < 0.03


def test_intervals_with_what_was_learnt_hold_as_often_as_they_say() -> None:
    random, held = np.random.default_rng(7), []
    for _ in range(400):
        true = abs(0.05 * random.standard_cauchy())
        true = min(true, 2.0)
        learnt = spread([(e, 0.02) for e in random.normal(0, np.hypot(true, 0.02), 6)])
        held.append(abs(random.normal(0, np.hypot(true, 0.02))) < 1.96 * np.hypot(learnt, 0.02))
    assert 0.92 < np.mean(held) < 0.99


def test_values_of_named_effects_tell_what_is_unlisted() -> None:
    # `outcome` finds values a tenth too large: 0.02 and 0.06 of a corner loss, whose prior spread is 0.25.
    trial = Trial("v", AIR[0], 3, {"vignetting": 1.0})
    sets = [
        replace(
            outcome(trial, verdict="named", sets=[["vignetting"]], corner_loss=loss),
            trial={**asdict(trial), "name": f"v{k}"},
        )
        for k, loss in enumerate((0.2, 0.2, 0.6))
    ]
    found = unlisted_sd(sets)
    assert found == {"vignetting": pytest.approx(spread([(0.08, 0.0), (0.08, 0.0), (0.24, 0.0)]), abs=1e-4)}
    assert unlisted_sd(sets[:2]) == {}
    both = replace(sets[0], trial={**asdict(trial), "effects": {"vignetting": 1.0, "banding": 1.0}})
    assert unlisted_sd([*sets[:2], both]) == {}  # where one was missed the other's value may stand for it


def test_sets_of_the_power_curves_can_be_planted() -> None:
    pool, known = power(), set(planted.names())
    assert len({t.kind for t in pool}) >= 20
    assert {t.kind for t in pool} <= known
    assert len({t.name for t in pool}) == len({t.seed for t in pool}) == len(pool)
    assert not {t.seed for t in pool} & {t.seed for t in development()}


@pytest.mark.slow
def test_detection_limits_are_those_that_sets_were_drawn_with() -> None:
    random = np.random.default_rng(3)
    truth = {f"kind-{k}": s for k, s in enumerate(np.geomspace(0.2, 1.4, 12))}
    held, errors = [], []
    for _ in range(10):
        named = {
            kind: [(s, random.random() < expit(4.0 * np.log(s / limit)), "one") for s in STRENGTHS * 2]
            for kind, limit in truth.items()
        }
        for kind, found in limits(named).items():
            errors.append(np.log(found.strength / truth[kind]))
            held.append((found.low or 0.0) <= truth[kind] <= (found.high or np.inf))
    assert np.mean(held) >= 0.88
    assert abs(np.mean(errors)) < 0.1
    assert np.std(errors) < 0.5


def test_designs_have_limits_of_their_own() -> None:
    random = np.random.default_rng(4)
    truth = {"flat": 0.2, "dome": 0.6}
    errors = []
    for _ in range(8):
        sets = [
            (s, random.random() < expit(4.0 * np.log(s / limit)), design)
            for design, limit in truth.items()
            for s in STRENGTHS * 12
        ]
        found = limits({"many": sets})["many"]
        assert found.designs["flat"] < found.strength < found.designs["dome"]
        errors.append([np.log(found.designs[design] / limit) for design, limit in truth.items()])
    assert np.abs(np.mean(errors, axis=0)).max() < 0.12
    few = limits({"few": [(s, s > 0.3, "flat") for s in STRENGTHS] + [(0.5, False, "dome")]})["few"]
    # One set tells little: its design is taken to be much as the others.
    assert 1.0 < few.designs["dome"] / few.designs["flat"] < 2.0


def test_a_limit_is_open_where_all_sets_or_none_are_named() -> None:
    seen = {"seen": True, "unseen": False}
    found = limits({kind: [(s, right, "one") for s in STRENGTHS] for kind, right in seen.items()})
    assert found["seen"].low is None
    assert found["seen"].high is not None
    assert found["seen"].high < 1.0
    assert found["unseen"].high is None
    assert found["unseen"].low is not None
    assert found["unseen"].low > 1.0
