"""The search for what is missing: what is named, what is refused, and which of two leads."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.core.progress import Work
from designlab.inference.diagnosis.emulator.rendering import fill, moved
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter, log_score
from designlab.inference.diagnosis.likelihood.normal_equations import System
from designlab.inference.diagnosis.result import Candidate
from designlab.inference.diagnosis.selection.acceptance import accepted, leads_like_dirt
from designlab.inference.diagnosis.selection.criterion import (
    LIKE_DIRT,
    OF_PRESSES,
    JudgedCandidate,
    difference,
)
from designlab.inference.diagnosis.selection.forward_selection import ForwardSelection, Winner
from designlab.inference.diagnosis.selection.held_out import Judged, Stand, gain, judge
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
    given, best = search.run(start)
    return search, best.state, given.judged, best.judged


def test_what_poses_take_up_is_named(bank) -> None:
    search, state, before, after = searched(bank, "depth_offset")
    assert search.winners[0].name == "depth_offset"
    # The mean depth of two presses is stated to 0.014 mm; no picture tells it from their offset.
    assert state.values["depth_offset"]["offset_mm"] == pytest.approx(-0.08, abs=0.014)
    assert abs(before.state.pose(3)[2] + 0.08) < 0.04  # four stated errors off
    assert abs(after.state.pose(3)[2]) < 0.02


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
    given, best = search.run(start)
    before, after = given.judged, best.judged
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
    left = judge(fitter, best.fit, [4])
    assert left.mean < 3 * left.floor.mean()


def test_a_finer_form_is_fitted_where_it_is_needed(bank) -> None:
    coat = VALUES["albedo_field"]
    for added in ({}, {"wave_3_0": -0.08, "wave_2_2": 0.06}):
        model = AppliedEffect(name="albedo_field", values=coat | added)
        fitter = seeing(bank, SensorModel(design=DESIGN, effects=(model,)))
        train, select = [0, 1, 2], [3]
        start = fitter.fit(fitter.start(train), (), train).state
        fitter.measure(start)
        search = ForwardSelection(fitter, NAMES, train, select)
        _, best = search.run(start)
        assert search.winners[0].name == "albedo_field"
        found = best.state.values["albedo_field"]
        assert (len(found) > len(coat)) == bool(added)
        for name, value in added.items():
            assert found[name] == pytest.approx(value, abs=0.008)


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
        _, best = search.run(start)
        assert next(iter(best.state.values)) == "contact_kernel"
        ends.append((search, best.judged, abs(best.state.values["contact_kernel"]["length_ratio"] - 1.8)))
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
    base = Stand(fitter, start, train, judge(fitter, start, select))
    search.gap = base.judged.gap
    return search, base


def test_all_that_may_win_have_pictures_of_one_quality(bank, renders) -> None:
    """Pictures rendered where presses stand fit otherwise than others, whatever the effect."""
    far = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.8}),)
    )
    fitter = seeing(bank, far)
    search, start = begun(fitter, renders)
    rendered, combined = (search._attempt(name, start) for name in ("contact_kernel", "albedo_field"))
    given = [rendered, replace(combined, evidence=rendered.evidence)]
    found, base = search._contended(given, start)
    assert base is not start
    for attempt in found:
        pictures = attempt.stand.fitter.bank
        assert all(pictures.of(n).exact_at is not None for n in (1, 2, 3)), attempt.name
        price = search._occam(attempt.stand.fit, attempt.name)
        assert attempt.evidence == difference(attempt.stand, base, price=price)
    assert found[1].stand.fitter is base.fitter
    # Where none is far, nothing is rendered.
    same, kept = search._contended([given[1]], start)
    assert same == [given[1]]
    assert kept is start


def test_what_no_longer_contends_is_not_rendered_a_second_time(bank, renders, monkeypatch) -> None:
    fitter = seeing(bank, applied("contact_kernel"))
    search, start = begun(fitter, renders)
    names = ("contact_kernel", "albedo_field", "vignetting")

    def with_evidence(attempt: JudgedCandidate, value: float) -> JudgedCandidate:
        return replace(attempt, evidence=attempt.evidence._replace(value=value))

    given = {name: with_evidence(search._attempt(name, start), 1000.0) for name in names}
    given["vignetting"] = with_evidence(given["vignetting"], 320.0)  # less than a third from the start
    judged_anew, rendered = [], []

    def judged(self, name, *_):
        judged_anew.append(name)
        return with_evidence(given[name], {"contact_kernel": 240.0, "albedo_field": 70.0}[name])

    def near(self, *_, **__):
        rendered.append(1)
        return fitter

    monkeypatch.setattr(ForwardSelection, "_judged", judged)
    monkeypatch.setattr(ForwardSelection, "_near", near)
    monkeypatch.setattr(ForwardSelection, "_exact", lambda *_: fitter)
    found, _ = search._contended(list(given.values()), start)
    assert judged_anew == ["contact_kernel", "albedo_field", "contact_kernel"]
    assert len(rendered) == len(names)
    assert [attempt.evidence.value for attempt in found] == [240.0, 70.0, 320.0]


def test_the_last_fit_is_closer_than_that_of_the_search(bank, renders) -> None:
    fitter = seeing(bank, applied("contact_kernel"))
    train = [0, 1, 2]
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.measure(start)
    _, best = ForwardSelection(fitter, NAMES, train, [3]).run(start)
    near, last = refined(renders, fitter, best.fit, train)
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
    start = fitter.fit(fitter.start(train), (), train)
    fitter.measure(start.state)
    right = judge(fitter, fitter.fit(start.state, ["vignetting"], train), final)
    found = control(
        fitter,
        start.state,
        named=["vignetting"],
        as_good=["vignetting"],
        tried=["vignetting", "albedo_field", "contact_kernel", "banding"],
        seed=SEED,
        train=train,
        final=final,
        before=judge(fitter, start, final),
        corrected=right,
    )
    # of one parameter each: banding has two of its own for every picture besides
    assert (found.name, found.parameters) == ("contact_kernel", 1)
    assert abs(found.removed) < 0.1
    assert (
        control(
            fitter,
            start.state,
            named=["vignetting"],
            as_good=["vignetting", "albedo_field"],
            tried=["vignetting", "albedo_field"],
            seed=SEED,
            train=train,
            final=final,
            before=judge(fitter, start, final),
            corrected=right,
        )
        is None
    )


@pytest.fixture(scope="module")
def measured(bank) -> Fitter:
    """Fitter that knows the noise of its shots."""
    fitter = Fitter(bank)
    fitter.start([0])
    return fitter


def judged(objective: list[float]) -> Judged:
    """Held-out shots of a thousand values each, of which noise leaves a hundred of the misfit."""
    values = np.array(objective)
    none = np.zeros(len(values))
    return Judged(State(GAINS), True, values / 10, none + 1.0, values, none + 100.0, none + 1000.0)


def test_what_granted_errors_take_up_is_left_where_frames_have_no_grain() -> None:
    """Residuals of 12 times the floor, all but noise of which the granted errors take up."""
    taken_up = replace(judged([120.0, 120.0]), objective=np.full(2, 101.0))
    assert taken_up.excess == 0
    assert replace(taken_up, grainy=False).excess == pytest.approx(12 - 0.75)


def stand(fitter: Fitter, name: str, objective: list[float]) -> Stand:
    values = {name: effect(name).null(DESIGN)} if name else {}
    fit = Fit(State(GAINS, values), System((), np.zeros((0, 0)), np.zeros(0), 0.0, np.zeros(0)), 0.0)
    return Stand(fitter, fit, [0], judged(objective))


def attempt(
    fitter: Fitter, name: str, objective: list[float], before: list[float], *, left: float = 1.0
) -> JudgedCandidate:
    """A candidate that says nothing of the shots fitted to."""
    after, base = stand(fitter, name, objective), stand(fitter, "", before)
    held_out = float((after.judged.scores - base.judged.scores).sum())
    share = gain(base.judged, after.judged, base.judged.gap / left)
    return JudgedCandidate(name, after, share, difference(after, base), held_out, left)


def test_small_misfits_count_as_of_gaussian_errors_and_large_ones_by_their_ratio() -> None:
    values = 1000.0
    small = log_score(np.array([104.0, 102.0, 0.0]), values)
    assert small.tolist() == [-52.0, -51.0, 0.0]
    # Half of a misfit taken away: the likelihood of errors of unknown size, n / 2 times the logarithm.
    large = log_score(np.array([2e6, 1e6]), values)
    assert large[1] - large[0] == pytest.approx(500.0 * np.log(2))
    # Where the misfit is as large as expected, one goes over into the other.
    near = log_score(np.array([1000.0, 999.9, 1000.1]), values)
    assert near[1] - near[0] == pytest.approx(near[0] - near[2], rel=1e-3)


def test_the_error_of_evidence_is_that_of_a_sum_over_all_shots(measured) -> None:
    left = [140.0, 140.0, 140.0]
    base, better = (stand(measured, "", own) for own in (left, [120.0, 130.0, 110.0]))
    apart = better.judged.scores - base.judged.scores
    found = difference(better, base, price=2.0)
    assert found.value == pytest.approx(apart.sum() - 2.0)
    assert found.se == pytest.approx(apart.std(ddof=1) * np.sqrt(1 + 3))
    assert difference(base, better).value == pytest.approx(-apart.sum())
    assert difference(*(stand(measured, "", [own]) for own in (140.0, 150.0))).se == 0.0  # one tells none


def test_presses_agree_that_gain_alike_or_as_much_as_they_lack(measured) -> None:
    """Presses differ in how much they show of an effect: that is no error."""
    base = np.array([104.0, 120.0, 180.0])
    for gained in (0.5 * (base - 100.0), 0.9 * (base - 100.0), np.array([19.0, 20.0, 21.0])):
        better = stand(measured, "", (base - gained).tolist())
        found = difference(better, stand(measured, "", base.tolist()))
        assert found.se < 0.06 * found.value
    uneven = difference(stand(measured, "", [104.0, 140.0, 100.0]), stand(measured, "", base.tolist()))
    assert not uneven.sure


def test_where_much_is_left_what_promises_most_is_fitted_whatever_the_screen_says(bank, monkeypatch) -> None:
    least = {name: 4.0 if name == "vignetting" else -10.0 for name in NAMES}
    monkeypatch.setattr(f"{SELECTION}.screen", lambda *_: (least, {}))
    search, *_ = searched(bank, "vignetting")
    assert search.winners[0].name == "vignetting"
    monkeypatch.setattr(f"{SELECTION}.all_leave_much", lambda *_: False)
    search, *_ = searched(bank, "vignetting")
    assert not search.winners


def test_an_alternative_that_is_named_itself_is_none(measured) -> None:
    search = ForwardSelection(measured, NAMES, [0], [3], gap=1000.0)
    one, other, third = (
        attempt(measured, name, [160.0, 162.0, 158.0], [250.0, 252.0, 248.0])
        for name in ("vignetting", "albedo_field", "contact_kernel")
    )
    search.winners += [Winner(one.name, (one, other, third), 0.5), Winner(other.name, (other,), 0.1)]
    search._drop_named()
    assert [w.coherence_set for w in search.winners] == [("vignetting", "contact_kernel"), ("albedo_field",)]


def test_what_is_not_surely_behind_does_as_well_and_the_simplest_leads(measured) -> None:
    search = ForwardSelection(measured, NAMES, [0], [3], gap=1000.0)
    before = [1150.0, 1152.0, 1148.0]
    coat = attempt(measured, "albedo_field", [160.0, 162.0, 158.0], before)
    behind = attempt(measured, "vignetting", [260.0, 263.0, 258.0], before)
    unsure = attempt(measured, "vignetting", [300.0, 140.0, 170.0], before)
    close = attempt(measured, "vignetting", [163.0, 166.0, 162.0], before)
    assert [a.name for a in search._best([coat, behind])[1]] == ["albedo_field"]
    assert search._best([coat, unsure]) == (unsure, (unsure, coat))
    # The second is surely behind, but evidence itself is known no better than that.
    assert search._best([coat, close]) == (coat, (coat, close))


def test_why_a_candidate_does_not_join(measured) -> None:
    before = [250.0, 252.0, 248.0]

    def reason(objective: list[float], *, left: float = 1.0, told: float = 0.0) -> str:
        """Reason, with what shots fitted to tell."""
        made = attempt(measured, "albedo_field", objective, before, left=left)
        evidence = made.evidence._replace(value=made.evidence.value + told)
        return OF_PRESSES.refused(replace(made, evidence=evidence))

    assert reason([244.0, 246.0, 242.0]).startswith("evidence 9, below 10")
    assert "is not sure, give or take" in reason([110.0, 252.0, 248.0])
    # However much the shots fitted to say.
    assert reason([255.0, 257.0, 253.0], told=100.0).startswith("what was held out speaks against it")
    assert reason([248.0, 250.0, 246.0], told=100.0).startswith("closes 1.3% of the gap, less than 3.0%")
    assert not reason([245.0, 247.0, 243.0], told=100.0, left=0.3)  # 3.3 % of what is left
    assert not reason([160.0, 162.0, 158.0])


def test_beside_others_an_effect_has_to_show_more(measured) -> None:
    alone = attempt(measured, "albedo_field", [234.0, 236.0, 232.0], [250.0, 252.0, 248.0])
    assert OF_PRESSES.evidence < alone.evidence.value == pytest.approx(24.0)
    both = alone.stand.state.with_values("vignetting", effect("vignetting").null(DESIGN))
    beside = replace(alone, stand=replace(alone.stand, fit=replace(alone.stand.fit, state=both)))
    seen = alone.evidence._replace(value=31.0)
    assert not OF_PRESSES.refused(alone)
    assert OF_PRESSES.refused(beside) == "evidence 24, below 24"
    assert not OF_PRESSES.refused(replace(beside, evidence=seen))


def test_what_pictures_of_another_effect_may_miss_does_not_count(measured) -> None:
    """A tenth of the first gap is left, of which 3.3 % go; pictures may miss more, exact effects nothing."""
    alone = attempt(measured, "albedo_field", [245.0, 247.0, 243.0], [250.0, 252.0, 248.0], left=0.1)

    def reason(other: str) -> str:
        both = alone.stand.state.with_values(other, effect(other).null(DESIGN))
        beside = replace(alone.stand, fit=replace(alone.stand.fit, state=both))
        return OF_PRESSES.refused(replace(alone, stand=beside, evidence=alone.evidence._replace(value=100.0)))

    for other in ("contact_kernel", "camera_pose", "depth_offset"):
        assert reason(other).startswith("closes 0.3% of the gap, less than 0.5%")
    for other in ("black_level", "colour_mixing", "vignetting"):
        assert not reason(other)


def test_where_light_is_off_by_smooth_errors_an_effect_has_to_show_more(measured) -> None:
    made = attempt(measured, "albedo_field", [160.0, 162.0, 158.0], [250.0, 252.0, 248.0])
    assert made.evidence.value == pytest.approx(135.0)
    assert not OF_PRESSES.refused(replace(made, smooth=62_000.0))  # of which it needs 0.2 % besides
    assert OF_PRESSES.refused(replace(made, smooth=63_000.0)) == "evidence 135, below 136"


def test_what_explains_less_than_dirt_in_the_guise_of_another_does_not_join(measured, monkeypatch) -> None:
    before = [1250.0, 1252.0, 1248.0]
    veil, strong, weak = (
        attempt(measured, name, [left, left + 2.0, left - 2.0], before)
        for name, left in (("vignetting", 600.0), ("albedo_field", 400.0), ("contact_kernel", 800.0))
    )
    monkeypatch.setattr(Fitter, "beyond_dirt", lambda *a: a[-1] != "vignetting")
    behind = "less evidence than vignetting, which dirt makes"
    assert accepted([veil, weak]) == ([], None, [LIKE_DIRT, behind])
    assert accepted([veil, strong, weak])[:2] == ([strong], None)
    empty = replace(veil, gain=replace(veil.gain, value=-0.01))  # which explains nothing of held-out presses
    assert accepted([empty, weak])[:2] == ([weak], None)


@pytest.mark.slow
def test_what_leads_settles_before_it_is_taken_for_dirt(bank, renders, monkeypatch) -> None:
    """A size that is still on its way says too little; what stands near null is left as it is."""
    far = SensorModel(
        design=DESIGN, effects=(AppliedEffect(name="contact_kernel", values={"length_ratio": 1.8}),)
    )

    def near_truth(_: Fitter, found: Fit, name: str) -> bool:
        return name != "contact_kernel" or abs(found.state.values[name]["length_ratio"] - 1.8) < 0.02

    fitter = seeing(bank, far)
    monkeypatch.setattr(Fitter, "beyond_dirt", near_truth)
    search, start = begun(fitter, renders)
    best = search._round(1, start)
    assert best is not None
    assert best.name == "contact_kernel"
    first = search._attempt("contact_kernel", start)
    assert OF_PRESSES.refused(first) == LIKE_DIRT
    assert not leads_like_dirt(first, [first])  # from pictures about null
    monkeypatch.setattr(ForwardSelection, "_settled", lambda _, attempt, __: attempt)
    search, start = begun(fitter, renders)
    assert search._round(1, start) is None
    assert LIKE_DIRT in [tried.outcome for tried in search.tried]


def test_a_pattern_that_rounding_makes_is_none_of_the_sensor(measured) -> None:
    made = attempt(measured, "fixed_pattern", [160.0, 162.0, 158.0], [250.0, 252.0, 248.0])
    pattern = np.random.default_rng(0).standard_normal(measured.bank.shots[0].signal.shape)

    def reason(rounding: float) -> str:
        shots = tuple(replace(shot, rounding=rounding) for shot in measured.bank.shots)
        fitter = measured.of(replace(measured.bank, shots=shots), measured.noises)
        fit = replace(made.stand.fit, state=State(GAINS).with_pattern("fixed_pattern", pattern, 0.002))
        return OF_PRESSES.refused(replace(made, stand=replace(made.stand, fitter=fitter, fit=fit)))

    assert reason(0.003) == "no more than the rounding of these files, 0.30% of their light"
    assert not reason(0.001)


def at_bound(fitter: Fitter, left: float) -> JudgedCandidate:
    """A candidate whose value is at its bound."""
    made = attempt(fitter, "vignetting", [left, left + 2.0, left - 2.0], [1250.0, 1252.0, 1248.0])
    most = next(p.high for p in effect("vignetting").parameters(DESIGN))
    fit = replace(made.stand.fit, state=State(GAINS).with_values("vignetting", {"corner_loss": most}))
    return replace(made, stand=replace(made.stand, fit=fit))


def test_a_value_at_its_bound_does_not_join(measured) -> None:
    assert OF_PRESSES.refused(at_bound(measured, 450.0)) == "at the bound of corner_loss"


def test_far_ahead_and_with_nothing_left_a_value_at_its_bound_joins(measured) -> None:
    closing, leaving = at_bound(measured, 160.0), at_bound(measured, 450.0)
    far, near = (
        attempt(measured, "albedo_field", [left, left + 2.0, left - 2.0], [1250.0, 1252.0, 1248.0])
        for left in (1200.0, 600.0)
    )
    assert accepted([closing, far]) == ([far], closing, ["", ""])
    assert accepted([closing, near])[:2] == ([near], None)
    assert accepted([leaving, far]) == ([far], None, ["at the bound of corner_loss", ""])
    # Later rounds do not ask again for what is usual.
    found = Winner("vignetting", (closing,), 0.9, unusual=True)
    assert not found.refused(closing)
    assert replace(found, unusual=False).refused(closing) == "at the bound of corner_loss"


def test_a_rival_that_surely_does_more_beside_the_others_takes_an_effects_place(
    measured, monkeypatch
) -> None:
    """One that did more alone must not stay where another explains far more together with later ones."""
    search = ForwardSelection(measured, NAMES, [0], [3], gap=1000.0)
    before, own = [250.0, 252.0, 248.0], [160.0, 162.0, 158.0]
    first = attempt(measured, "contact_kernel", own, before)
    later = attempt(measured, "vignetting", own, before)
    without = stand(measured, "vignetting", before)
    monkeypatch.setattr(ForwardSelection, "_without", lambda *_: without)

    def named(objective: list[float]) -> tuple[list[str], Stand]:
        rival = attempt(measured, "albedo_field", objective, before)
        monkeypatch.setattr(ForwardSelection, "_judged", lambda *_: rival)
        ended = {"albedo_field": rival.stand.state}
        search.winners = [Winner("contact_kernel", (first,), 0.5, ended), Winner("vignetting", (later,), 0.1)]
        best = search._pruned(2, stand(measured, "contact_kernel", own))
        return list(search.winners[0].coherence_set), best

    names, best = named([130.0, 132.0, 128.0])
    assert names == ["albedo_field"]
    assert "albedo_field" in best.state.values
    assert named([156.0, 158.0, 154.0])[0] == ["contact_kernel", "albedo_field"]
    assert named([190.0, 192.0, 188.0])[0] == ["contact_kernel"]  # whatever it did alone


def test_a_needless_effect_leaves_what_it_closed_to_the_one_that_made_it_so(measured) -> None:
    search = ForwardSelection(measured, NAMES, [0], [3], gap=1000.0)
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
