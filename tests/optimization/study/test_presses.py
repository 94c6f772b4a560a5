"""All designs of a study, a sweep or a tolerance run are pressed alike, and not as each gel allows."""

import json
import tomllib

import pytest

from designlab.evaluation.press_plan import PressPlan
from designlab.optimization import outcome
from designlab.optimization.study import StudyError, dumps_study, load_study, sweep
from designlab.optimization.study.folder import DEFINITION_FILE
from designlab.sensor.design import preset
from tests.helpers.studies import BARE, closed_form, make, run, write

FLAT = preset("gelsight-2020-flat")
THICKNESS = {"elastomer.thickness_mm": {"choices": [0.5, 1.0, 2.0]}}


class Pressing:
    """In place of simulations: a closed form that takes presses as an evaluation does."""

    def __init__(self):
        self.plans = []

    def __call__(self, design, *, presses, fidelity, seed, **_):
        plan = presses or PressPlan.of(design)
        plan.require_possible(design)
        self.plans.append(plan)
        return type("Evaluation", (), {"score": closed_form(design, fidelity=fidelity, seed=seed)})


@pytest.fixture
def pressing(monkeypatch):
    evaluation = pytest.importorskip("designlab.evaluation.evaluate")
    stand_in = Pressing()
    monkeypatch.setattr(evaluation, "evaluate", stand_in)
    return stand_in


def of_scores(**changes):
    objectives = {"uniformity_u0": "maximise", "normal_error_median_deg": "minimise"}
    return make(objectives=objectives, sampler="random", **changes)


@pytest.mark.slow
def test_every_design_of_a_study_is_pressed_alike(tmp_path, pressing):
    study = of_scores(parameters=THICKNESS, trials=2)
    results = run(study, tmp_path, evaluator=None)
    assert set(pressing.plans) == {PressPlan.of(FLAT)}
    assert results.counts()["complete"] >= 2


@pytest.mark.slow
def test_a_gel_that_is_too_thin_is_an_infeasible_trial_with_its_reason(tmp_path, pressing):
    study = of_scores(parameters={"elastomer.thickness_mm": {"choices": [0.5, 2.0]}}, trials=2)
    results = run(study, tmp_path, evaluator=None)
    thin = results.frame[results.frame["elastomer.thickness_mm"] == 0.5]
    assert len(thin) > 0
    assert set(thin["state"]) == {"infeasible"}
    assert "presses are up to 0.8 mm deep, elastomer.thickness_mm is 0.5" in thin["reason"].iloc[0]
    assert thin["violation_mm"].iloc[0] == pytest.approx(0.31)
    assert results.rejections() == {"press_depth": len(thin)}


def test_a_score_that_elastic_gels_alone_have_fails_the_trials_of_others(tmp_path):
    def of_layers(design, *, fidelity, seed):
        score = closed_form(design, fidelity=fidelity, seed=seed)
        if design.leds.tilt_deg > 20:
            score.scores["force_at_depth_n"] = score.scores["height_mae_um"]
        return score

    study = make(objectives={"force_at_depth_n": "minimise"}, sampler="random", trials=2)
    results = run(study, tmp_path, evaluator=of_layers)
    failed = results.frame[results.frame["state"] == "failed"]
    assert set(failed["reason"]) == {"force_at_depth_n: this design has no such score"}
    assert (failed["leds.tilt_deg"] <= 20).all()
    assert results.evaluated == 2


def test_a_study_states_its_presses(tmp_path):
    path = write(tmp_path, 'version = 1\nbase = "gelsight-2020-flat"\n[presses]\ndepth_mm = 0.5\n')
    study = load_study(path)
    assert study.presses == PressPlan(area_mm=FLAT.sensing_area_mm, depth_mm=0.5)
    assert tomllib.loads(dumps_study(study))["presses"] == {"area_mm": [16.0, 12.0], "depth_mm": 0.5}
    assert study.digest != make(parameters=study.parameters, **BARE).digest
    with pytest.raises(StudyError, match=r"presses.depth_mm: Input should be greater than 0, got 0"):
        load_study(write(tmp_path, path.read_text().replace("0.5", "0")))


def test_presses_lie_within_the_smallest_sensing_area_of_a_study():
    varied = {"sensing_area_mm.0": {"low": 8.0, "high": 14.0}}
    small = {"sensing_area_mm": [12.0, 9.0]}
    study = make(parameters=varied, variants={"a": {}, "b": small})
    assert study.presses.area_mm == (8.0, 9.0)


def test_a_round_variant_makes_the_presses_of_all_round_and_a_stated_area_keeps_the_shape():
    variants = {"a": {}, "b": {"sensing_area_shape": "ellipse"}}
    for stated, size in (
        ({}, (16.0, 12.0)),
        ({"area_mm": [8.0, 6.0]}, (8.0, 6.0)),
        ({"depth_mm": 0.5}, None),
    ):
        presses = make(variants=variants, presses=stated).presses
        assert presses.area_shape == "ellipse"
        assert presses.area_mm == (size or FLAT.sensing_area_mm)
    assert make(variants=variants).pressed(depth_mm=0.3).presses.area_shape == "ellipse"


def test_usual_presses_leave_the_digest_of_a_study_as_it_was():
    study = make()
    assert study.digest == make(presses={"depth_mm": 0.8}).digest
    assert study.differences(make(presses={"depth_mm": 0.7})) == ["presses"]


def test_a_folder_goes_on_with_its_own_presses_alone(tmp_path):
    run(make(trials=1), tmp_path)
    with pytest.raises(StudyError, match="differs from 'ring' in presses"):
        run(make(trials=2, presses={"depth_mm": 0.5}), tmp_path)


@pytest.mark.parametrize(("parameters", "goes_on"), [(None, True), (THICKNESS, False)])
def test_an_old_folder_goes_on_where_its_designs_were_pressed_alike(tmp_path, parameters, goes_on):
    """Presses were 0.4 of the thickness of each gel, 0.8 mm at most, before studies stated them."""
    study = make(trials=1, **({} if parameters is None else {"parameters": parameters}))
    run(study, tmp_path)
    definition = tmp_path / DEFINITION_FILE
    text = definition.read_text()
    start = text.index("[presses]")
    definition.write_text(text[:start] + text[text.index("\n[", start) + 1 :])
    assert "presses" not in tomllib.loads(definition.read_text())
    assert load_study(definition).presses == study.presses
    if goes_on:
        assert run(study.model_copy(update={"trials": 2}), tmp_path).evaluated == 2
    else:
        with pytest.raises(StudyError, match="cannot be compared with what would follow"):
            run(study.model_copy(update={"trials": 2}), tmp_path)


def test_every_design_of_a_sweep_is_pressed_alike(pressing):
    frame = sweep(FLAT, {"elastomer.thickness_mm": [0.5, 1.0, 2.0]}, progress=False)
    assert list(frame["feasible"]) == [False, True, True]
    assert "elastomer.thickness_mm is 0.5" in frame["reason"].iloc[0]
    assert pressing.plans == 2 * [PressPlan.of(FLAT)]
    sweep(FLAT, {"elastomer.thickness_mm": [0.5]}, depth_mm=0.4, progress=False)
    assert pressing.plans[-1].depth_mm == 0.4


def test_a_sweep_of_sensing_areas_presses_in_the_smallest(pressing):
    sweep(FLAT, {"sensing_area_mm": [(14.0, 10.0), (10.0, 11.0)]}, progress=False)
    assert {plan.area_mm for plan in pressing.plans} == {(10.0, 10.0)}


def test_why_a_design_takes_no_presses_can_be_stored(pressing):
    found = outcome.evaluate_design(
        outcome.Simulated(presses=PressPlan.of(FLAT)),
        FLAT.replace({"elastomer.thickness_mm": 0.5}),
        "fast",
        0,
    )
    assert json.loads(json.dumps(found))["broken"] == {"press_depth": pytest.approx(0.31)}
