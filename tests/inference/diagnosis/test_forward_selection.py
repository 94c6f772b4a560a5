"""The search for what is missing: what is named, what is refused, and which of two leads."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.core.progress import Work
from designlab.inference.diagnosis.emulator.rendering import fill, moved
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter
from designlab.inference.diagnosis.likelihood.normal_equations import System
from designlab.inference.diagnosis.result import Candidate
from designlab.inference.diagnosis.selection.acceptance import (
    JudgedCandidate,
    as_good,
    closes_more,
    refused,
    unsure,
)
from designlab.inference.diagnosis.selection.forward_selection import ForwardSelection, Winner
from designlab.inference.diagnosis.selection.held_out import Judged, gain, judge
from designlab.inference.diagnosis.selection.negative_control import control
from designlab.inference.diagnosis.selection.refine import refined
from designlab.inference.diagnosis.verdict.intervals import values
from designlab.simulation.effects import AppliedEffect, SensorModel, effect
from designlab.simulation.simulator import Simulator
from tests.helpers.small_sensor import (
    DESIGN,
    GAINS,
    PRESSES,
    SAMPLES,
    SEED,
    VALUES,
    applied,
    seeing,
    shots,
)
from tests.helpers.told import Told

pytestmark = pytest.mark.renders

SELECTION = "designlab.inference.diagnosis.selection.forward_selection"
NAMES = ("albedo_field", "translucency", "contact_kernel", "depth_offset", "vignetting", "colour_mixing")


@pytest.fixture(scope="module")
def bank(renders) -> Bank:
    return fill(renders, SensorModel.of(DESIGN), shots(SensorModel.of(DESIGN)), NAMES)


def searched(bank: Bank, name: str) -> tuple[ForwardSelection, State, Judged, Judged]:
    """Search for an effect that is there: where it ended, the held-out press before and after."""
    fitter = seeing(bank, applied(name))
    train, select = [0, 1, 2], [3]
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.measure(start)
    search = ForwardSelection(fitter, NAMES, train, select)
    best, before, after = search.run(start)
    return search, best.state, before, after


def test_what_poses_take_up_is_named(bank) -> None:
    search, state, before, after = searched(bank, "depth_offset")
    assert search.winners[0].name == "depth_offset"
    # The mean depth of two presses is stated to 0.014 mm; no picture tells it from their offset.
    assert state.values["depth_offset"]["offset_mm"] == pytest.approx(-0.08, abs=0.014)
    assert before.poses[2] > 9.0  # 0.08 mm are four stated errors
    assert after.poses.max() < 1.0
    assert gain(before, after, before.gap).settles_poses
    assert not gain(after, before, before.gap).settles_poses


def test_an_effect_that_begins_with_its_square_is_named(bank) -> None:
    search, state, before, after = searched(bank, "translucency")
    assert search.winners[0].name == "translucency"
    assert gain(before, after, before.gap).value > 0.8
    # Light goes through the coat to the object and back: the coat alone is known less than both together.
    found, truth = state.values["translucency"], VALUES["translucency"]
    through = [v["transmittance"] ** 2 * v["object"] for v in (found, truth)]
    assert through[0] == pytest.approx(through[1], rel=0.15)


@pytest.mark.parametrize("name", ["contact_kernel", "vignetting", "albedo_field"])
def test_the_effect_that_is_there_is_named_with_its_values(bank, name) -> None:
    fitter = seeing(bank, applied(name))
    train, select = [0, 1, 2], [3]
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.measure(start)
    told = Told()
    search = ForwardSelection(fitter, NAMES, train, select, work=Work(told))
    best, before, after = search.run(start)
    assert search.winners[0].name == name
    fitted = [c.name for c in search.tried if c.seconds is not None and c.round == 1]
    assert told.said[: 1 + len(fitted)] == ["screening effects", *(f"trying {n}" for n in fitted)]
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert 0.0 < shares[-1] < 1.0
    for parameter, value in VALUES[name].items():
        sd = next(p.sd for p in effect(name).parameters(DESIGN) if p.name == parameter)
        assert best.state.values[name][parameter] == pytest.approx(value, abs=0.15 * sd), parameter
    assert gain(before, after, before.gap).value > 0.8
    left = judge(fitter, best.state, [4])
    assert left.mean < 3 * left.floor.mean()


def test_nothing_is_named_where_nothing_is_hidden(bank) -> None:
    fitter = seeing(bank, SensorModel.of(DESIGN))
    start = fitter.fit(fitter.start([0, 1, 2]), (), [0, 1, 2]).state
    fitter.measure(start)
    search = ForwardSelection(fitter, NAMES, [0, 1, 2], [3])
    search.run(start)
    assert not search.winners
    # At the floor nothing is looked for; else every candidate is listed.
    assert {c.name for c in search.tried} in (set(), {*NAMES, "numerical"})


def test_what_is_far_is_judged_by_pictures_rendered_where_it_stands(bank, renders) -> None:
    """What pictures about null lack far from it counts neither against an effect nor for another."""
    far = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.8}),)
    )
    fitter = seeing(bank, far)
    train, select = [0, 1, 2], [3]
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.measure(start)
    ends = []
    for source in (None, renders):
        search = ForwardSelection(fitter, NAMES, train, select, source)
        best, _, after = search.run(start)
        assert next(iter(best.state.values)) == "contact_kernel"
        ends.append((search, after, abs(best.state.values["contact_kernel"]["length_ratio"] - 1.8)))
    (rough, left, off), (fine, less, closer) = ends
    assert rough.fitter is fitter
    stand = fine.fitter.bank.stands["contact_kernel"]["length_ratio"]
    assert stand == pytest.approx(1.8, abs=0.1)
    assert [winner.name for winner in fine.winners] == ["contact_kernel"]
    assert less.mean < left.mean
    assert closer < 0.5 * off


def begun(fitter, renders):
    """Search on the first three shots, judged by the fourth, and where it begins."""
    train, select = [0, 1, 2], [3]
    start = fitter.fit(fitter.start(train), (), train)
    fitter.measure(start.state)
    search = ForwardSelection(fitter, NAMES, train, select, renders)
    now = judge(fitter, start.state, select)
    search.gap = now.gap
    return search, start, now


def test_all_that_may_win_have_pictures_of_one_quality(bank, renders) -> None:
    """Pictures rendered where presses stand fit otherwise than others, whatever the effect."""
    far = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.8}),)
    )
    fitter = seeing(bank, far)
    search, start, now = begun(fitter, renders)
    rendered, combined = (search._attempt(name, start, now) for name in ("contact_kernel", "albedo_field"))
    given = [rendered, replace(combined, evidence=rendered.evidence)]
    found, own, base, judged = search._contended(given, start, now)
    assert base is not start
    for attempt in found:
        assert all(attempt.fitter.bank.of(n).exact_at is not None for n in (1, 2, 3)), attempt.name
        less = 0.5 * (base.objective - attempt.fit.objective) - search._occam(attempt.fit, attempt.name)
        less += 0.5 * float((judged.objective - attempt.judged.objective).sum())
        assert attempt.evidence == pytest.approx(less)
    assert found[1].fitter is own
    # Where none is far, nothing is rendered.
    same, kept, *_ = search._contended([given[1]], start, now)
    assert same == [given[1]]
    assert kept is fitter


def test_what_no_longer_contends_is_not_rendered_a_second_time(bank, renders, monkeypatch) -> None:
    fitter = seeing(bank, applied("contact_kernel"))
    search, start, now = begun(fitter, renders)
    names = ("contact_kernel", "albedo_field", "vignetting")
    given = {name: replace(search._attempt(name, start, now), evidence=1000.0) for name in names}
    given["vignetting"] = replace(given["vignetting"], evidence=490.0)  # less than half from the start
    judged_anew, rendered = [], []

    def judged(self, name, *_):
        judged_anew.append(name)
        return replace(given[name], evidence={"contact_kernel": 240.0, "albedo_field": 100.0}[name])

    def near(self, *_, **__):
        rendered.append(1)
        return fitter

    monkeypatch.setattr(ForwardSelection, "_judged", judged)
    monkeypatch.setattr(ForwardSelection, "_near", near)
    monkeypatch.setattr(ForwardSelection, "_standing", lambda self, base, now: (fitter, base, now))
    found = search._contended(list(given.values()), start, now)[0]
    assert judged_anew == ["contact_kernel", "albedo_field", "contact_kernel"]
    assert len(rendered) == len(judged_anew)
    assert [attempt.evidence for attempt in found] == [240.0, 100.0, 490.0]


def test_the_last_fit_is_closer_than_that_of_the_search(bank, renders) -> None:
    fitter = seeing(bank, applied("contact_kernel"))
    train = [0, 1, 2]
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.measure(start)
    best, _, _ = ForwardSelection(fitter, NAMES, train, [3]).run(start)
    near, last = refined(renders, fitter, best, train)
    assert near.bank is not bank  # a whole prior standard deviation is far
    found = last.state.values["contact_kernel"]
    before, after = (abs(fit.state.values["contact_kernel"]["length_ratio"] - 1.4) for fit in (best, last))
    assert after < before
    assert after < 0.5 * values(near, last, "contact_kernel", train)["length_ratio"].fit_sd
    model = SensorModel(design=DESIGN, effects=(AppliedEffect(name="contact_kernel", values=found),))
    simulator = Simulator(model, view=bank.of(1).view, samples=SAMPLES, seed=SEED)
    for number, press in enumerate(PRESSES[:2], start=1):
        rendered = simulator.frame(moved(press, last.state.pose(number))).basis
        still = replace(last.state, numerical=0.0)
        combined, exact = (np.abs(f.forward.light(still, number) - rendered).max() for f in (fitter, near))
        assert exact < 0.25 * combined  # values have moved a little since


def test_the_control_is_a_wrong_effect_of_the_same_size_and_closes_little(bank) -> None:
    fitter = seeing(bank, applied("vignetting"))
    train, final = [0, 1, 2], [4]
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.measure(start)
    found = control(
        fitter,
        start,
        named=["vignetting"],
        as_good=["vignetting"],
        tried=["vignetting", "albedo_field", "contact_kernel", "banding"],
        seed=SEED,
        train=train,
        final=final,
        before=judge(fitter, start, final),
    )
    # of one parameter each: banding has two of its own for every picture besides
    assert (found.name, found.parameters) == ("contact_kernel", 1)
    assert abs(found.removed) < 0.1
    assert (
        control(
            fitter,
            start,
            named=["vignetting"],
            as_good=["vignetting", "albedo_field"],
            tried=["vignetting", "albedo_field"],
            seed=SEED,
            train=train,
            final=final,
            before=judge(fitter, start, final),
        )
        is None
    )


def judged(objective: list[float], least: float = 100.0, noise: float = 0.0) -> Judged:
    values = np.array(objective)
    none = np.zeros(len(values))
    return Judged(State(GAINS), values, none + noise, none + noise + 1.0, values, none + least, np.zeros(4))


def attempt(
    fitter: Fitter,
    name: str,
    left: float,
    objective: list[float],
    before: Judged,
    *,
    evidence: float = 100.0,
) -> JudgedCandidate:
    after = judged(objective)
    null = effect(name).null(DESIGN) if name in NAMES else {}
    state = State(GAINS).with_values(name, null)
    fit = Fit(state, System((), np.zeros((0, 0)), np.zeros(0), 0.0, np.zeros(0)), 0.0)
    return JudgedCandidate(name, left, fitter, fit, after, gain(before, after, 1000.0), evidence)


def test_a_press_that_shows_most_of_an_effect_does_not_make_its_gain_unsure() -> None:
    before = judged([200.0, 210.0, 190.0, 4100.0])
    after = judged([140.0, 150.0, 140.0, 500.0])
    found = gain(before, after, before.gap)
    assert found.value < 1.5 * found.se  # the mean over presses is that of one
    assert found.own == pytest.approx(np.mean([0.6, 60 / 110, 50 / 90, 0.9]))
    assert found.own - 1.5 * found.own_se > 0.5
    worse = gain(before, judged([260.0, 280.0, 250.0, 500.0]), before.gap)
    assert worse.own - 1.5 * worse.own_se < 0
    # Of presses that leave no more than noise, shares would be shares of nothing.
    still = gain(judged([99.0, 101.0, 190.0, 210.0]), judged([70.0, 72.0, 188.0, 207.0]), 1.0)
    assert still.own == pytest.approx((2 / 90 + 3 / 110) / 2)
    none = gain(judged([99.0, 101.0]), judged([70.0, 72.0]), 1.0)
    assert (none.own, none.own_se) == (0.0, 0.0)


def test_residuals_are_shared_out_beyond_the_noise_of_the_camera() -> None:
    """Near the noise, all that an effect can take is a small share of the whole residual."""
    before, after = judged([100.0, 104.0], noise=96.0), judged([98.0, 100.0], noise=96.0)
    assert gain(before, after, 10.0).squares == pytest.approx(0.5)
    assert gain(after, before, 10.0).squares == pytest.approx(-1.0)  # 3 % of the whole is the least to share
    much = judged([10_000.0, 10_000.0], noise=96.0)
    assert gain(much, judged([9_800.0, 9_800.0], noise=96.0), 10.0).squares == pytest.approx(200 / 9904)


def test_putting_poses_right_may_cost_a_little_of_the_residual_where_hardly_any_is_left() -> None:
    """What poses had taken up leaves none; shares of what is beyond the noise would be shares of nothing."""
    off = replace(judged([100.0, 104.0], noise=102.0), poses=np.array([0.0, 0.0, 9.0, 0.0]))
    settled = gain(off, replace(judged([101.0, 104.0], noise=102.0), poses=np.full(4, 1.0)), 10.0)
    assert settled.squares < -0.1
    assert settled.settles_poses
    dearly = gain(off, replace(judged([104.0, 108.0], noise=102.0), poses=np.full(4, 1.0)), 10.0)
    assert not dearly.settles_poses


def test_where_much_is_left_what_promises_most_is_fitted_whatever_the_screen_says(bank, monkeypatch) -> None:
    least = {name: 4.0 if name == "vignetting" else -10.0 for name in NAMES}
    monkeypatch.setattr(f"{SELECTION}.screen", lambda *_: (least, {}))
    search, *_ = searched(bank, "vignetting")
    assert search.winners[0].name == "vignetting"
    monkeypatch.setattr(f"{SELECTION}.all_leave_much", lambda *_: False)
    search, *_ = searched(bank, "vignetting")
    assert not search.winners


def test_an_alternative_that_is_named_itself_is_none(bank) -> None:
    search = ForwardSelection(Fitter(bank), NAMES, [0], [3], gap=1000.0)
    before = judged([250.0, 252.0, 248.0])
    one, other, third = (
        attempt(search.fitter, name, 500.0, [160.0, 162.0, 158.0], before)
        for name in ("vignetting", "albedo_field", "contact_kernel")
    )
    search.winners += [Winner(one.name, (one, other, third), 0.5), Winner(other.name, (other,), 0.1)]
    search._drop_named()
    assert [w.coherence_set for w in search.winners] == [("vignetting", "contact_kernel"), ("albedo_field",)]


def test_a_small_lead_of_evidence_tells_apart_only_what_held_out_presses_do_too(bank) -> None:
    search = ForwardSelection(Fitter(bank), NAMES, [0], [3], gap=1000.0)
    before = judged([1150.0, 1152.0, 1148.0])

    def named(left: list[float], evidence: float) -> JudgedCandidate:
        return attempt(search.fitter, "a", 1000.0, left, before, evidence=evidence)

    best = named([160.0, 162.0, 158.0], 200.0)
    worse, alike = [260.0, 263.0, 258.0], [165.0, 150.0, 170.0]
    assert as_good(named(alike, 185.0), best, 1000.0)
    assert not as_good(named(worse, 185.0), best, 1000.0)
    assert as_good(named(worse, 195.0), best, 1000.0)  # evidence itself is known no better than that
    assert not as_good(named(alike, 175.0), best, 1000.0)


def test_what_counts_as_closing_more_goes_by_what_is_left(bank) -> None:
    """Of a twentieth of the first gap, 3 % of the first gap would be nearly all."""
    search = ForwardSelection(Fitter(bank), NAMES, [0], [3], gap=1000.0)
    before = judged([150.0, 152.0, 148.0])
    much, little = (
        attempt(search.fitter, "a", 50.0, [100.0 + s, 102.0 + s, 98.0 + s], before) for s in (10.0, 35.0)
    )
    assert closes_more(much, little, 1000.0)
    assert not closes_more(little, much, 1000.0)
    assert not closes_more(replace(much, left=1000.0), replace(little, left=1000.0), 1000.0)


def test_what_closes_less_of_held_out_presses_does_not_lead(bank) -> None:
    """However large the evidence of the presses fitted to: one of them may hold most of it."""
    search = ForwardSelection(Fitter(bank), NAMES, [0], [3], gap=1000.0)
    before = judged([150.0, 152.0, 148.0])

    def named(name: str, left: list[float], evidence: float) -> JudgedCandidate:
        return attempt(search.fitter, name, 1000.0, left, before, evidence=evidence)

    wrong = named("wrong", [140.0, 142.0, 138.0], 90.0)
    right = named("right", [60.0, 62.0, 58.0], 60.0)
    assert search._leading([wrong, right]) == [right]
    # Frames besides the presses, of other light or exposure, may say far more than these.
    told = replace(wrong, evidence=2.1 * right.evidence)
    assert search._leading([told, right]) == [told, right]
    # Presses that differ much decide nothing.
    unsure = named("unsure", [60.0, 230.0, 10.0], 60.0)
    assert search._leading([wrong, unsure]) == [wrong, unsure]


def test_a_rival_that_surely_does_more_beside_the_others_takes_an_effects_place(bank, monkeypatch) -> None:
    """One that did more alone must not stay where another explains far more together with later ones."""
    search = ForwardSelection(Fitter(bank), NAMES, [0], [3], gap=1000.0)
    before = judged([250.0, 252.0, 248.0])
    kept = attempt(search.fitter, "contact_kernel", 500.0, [160.0, 162.0, 158.0], before, evidence=100.0)
    without = Fit(State(GAINS).with_values("vignetting", {"corner_loss": 0.1}), kept.fit.system, 0.0)
    monkeypatch.setattr(search, "_alike", lambda *_: set())

    def named(evidence: float) -> tuple[str, ...]:
        rival = attempt(search.fitter, "albedo_field", 500.0, [130.0, 132.0, 128.0], before)
        monkeypatch.setattr(search, "_judged", lambda *_: replace(rival, evidence=evidence))
        ended = {"albedo_field": rival.fit.state, "vignetting": State(GAINS)}
        winner = Winner("contact_kernel", (kept, rival), 0.5, ended)
        rivals = search._rivals(winner, kept, without, before, search.fitter)
        return search._beside(winner, kept, rivals, without).coherence_set

    assert named(130.0) == ("albedo_field",)
    assert named(108.0) == ("contact_kernel", "albedo_field")  # evidence is not known that well
    assert named(85.0) == ("contact_kernel",)  # whatever it did alone


def test_a_needless_effect_leaves_what_it_closed_to_the_one_that_made_it_so(bank) -> None:
    search = ForwardSelection(Fitter(bank), NAMES, [0], [3], gap=1000.0)
    for name, share, evidence in (("vignetting", 0.5, 300.0), ("albedo_field", 0.1, 40.0)):
        search.winners.append(Winner(name, (), share))
        search.tried.append(Candidate(1, name, "passed", share, 0.01, 1.0, {}, evidence))
    dropped = search.winners.pop(0)
    search._inherit(2, dropped, State(GAINS).with_values("albedo_field", {"x": 0.03}))
    (winner,) = search.winners
    assert (winner.name, winner.gain) == ("albedo_field", pytest.approx(0.6))
    last = search.tried[-1]
    assert (last.name, last.gain, last.evidence) == ("albedo_field", pytest.approx(0.6), 340.0)
    assert last.parameters == {"albedo_field.x": 0.03}


def test_more_is_asked_of_an_effect_beside_others(bank) -> None:
    search = ForwardSelection(Fitter(bank), NAMES, [0], [3], gap=1000.0)
    before = judged([250.0, 252.0, 248.0])
    weak = attempt(search.fitter, "contact_kernel", 150.0, [210.0, 212.0, 208.0], before, evidence=25.0)
    faint = replace(weak, evidence=15.0)
    assert unsure(faint, 1000.0, later=False).startswith("evidence 15, below 16")
    assert not unsure(weak, 1000.0, later=False)
    assert unsure(weak, 1000.0, later=True).startswith("evidence 25, below 30")
    # Of presses that differ, a gain above nothing is sure, one above 3 % of what is left is not; but
    # where few show most of it, or where poses that all presses share are put right.
    differing = attempt(search.fitter, "contact_kernel", 500.0, [220.0, 245.0, 210.0], before)
    differing = replace(differing, gain=replace(differing.gain, own=0.0))
    assert 0.0 < differing.gain.value - 1.5 * differing.gain.se < 0.03 * 0.5 < differing.gain.value
    assert unsure(differing, 1000.0, later=False).endswith("1.5% are not sure")
    sharp = replace(differing, gain=replace(differing.gain, own=0.5, own_se=0.1))
    assert not unsure(sharp, 1000.0, later=False)
    settled = replace(differing, gain=replace(differing.gain, settles_poses=True))
    assert not unsure(settled, 1000.0, later=False)


def test_what_differs_between_presses_contends_only_beside_what_is_sure(bank) -> None:
    """That something is missing is sure then; what it is need not be."""
    fitter = seeing(bank, SensorModel.of(DESIGN))
    fitter.start([0, 1, 2])
    search = ForwardSelection(fitter, NAMES, [0, 1], [3], gap=1000.0)
    before = judged([250.0, 252.0, 248.0])
    sure = attempt(fitter, "contact_kernel", 500.0, [210.0, 212.0, 208.0], before, evidence=20.0)
    sure = replace(sure, gain=replace(sure.gain, squares=0.5))
    differing = attempt(fitter, "depth_offset", 500.0, [180.0, 230.0, 210.0], before, evidence=21.0)
    differing = replace(differing, gain=replace(differing.gain, own=0.0, squares=0.5, se=1.0))
    faint = replace(differing, name="vignetting", evidence=15.0)

    def passed(*attempts: JudgedCandidate) -> list[str]:
        return [a.name for a in search._passed(1, attempts, State(GAINS), fitter)]

    assert passed(differing, faint) == []
    assert search.tried[0].outcome.endswith("not sure")
    assert passed(sure, differing, faint) == ["contact_kernel", "depth_offset"]


def test_not_every_press_need_gain_by_what_puts_the_poses_of_all_right(bank) -> None:
    """The own error of a press may make up for what all have in common."""
    fitter = seeing(bank, SensorModel.of(DESIGN))
    fitter.start([0, 1, 2])
    before = judged([250.0, 252.0, 248.0, 250.0])
    some = attempt(fitter, "contact_kernel", 500.0, [150.0, 152.0, 249.0, 251.0], before)
    few = replace(some, gain=replace(some.gain, own=0.5, own_se=0.0, squares=0.5, improved=0.67))
    assert refused(few, State(GAINS), fitter, [0, 1], 1000.0).startswith("only 67%")
    settled = replace(few, gain=replace(few.gain, settles_poses=True))
    assert not refused(settled, State(GAINS), fitter, [0, 1], 1000.0)
