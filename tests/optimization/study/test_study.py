"""Studies on an evaluator with a closed form, so that the search is judged without rendering."""

import json
import math
import os
import signal
import sqlite3
import threading
import time

import optuna
import pandas as pd
import pytest

from designlab.optimization.study import (
    Parameter,
    Plan,
    StudyError,
    StudyInterrupted,
    dumps_study,
    importance,
    load_results,
    load_study,
    sweep,
)
from designlab.optimization.study.folder import opened, reading
from designlab.optimization.study.results import STATES
from designlab.optimization.study.search import StudyRun
from designlab.sensor import design as designs
from designlab.sensor.design import InfeasibleDesign, preset
from designlab.simulation.effects.model import AppliedEffect, SensorModel, load_model
from designlab.simulation.simulator import RenderFailed
from tests.helpers.studies import BARE, RANGES, Counting, Death, closed_form, make, mortal, run, write


def counts(**given):
    return dict.fromkeys(STATES, 0) | given


def test_each_evaluated_trial_keeps_its_design_and_its_score(tmp_path):
    study = make()
    results = run(study, tmp_path)
    assert results.counts() == counts(complete=6)
    for _, row in results.frame.iterrows():
        folder = tmp_path / "trials" / f"{row['trial']:04d}"
        design = designs.load(folder / "design.toml")
        expected = closed_form(design, fidelity="fast", seed=0).scores
        stored = json.loads((folder / "score.json").read_text())["scores"]
        for name, estimate in expected.items():
            assert stored[name]["value"] == row[name] == estimate.value
            assert stored[name]["unit"] == estimate.unit
            assert row[f"{name}_se"] == estimate.se
        assert design.digest == results.design(row["trial"]).digest


def test_the_base_design_comes_first_if_the_ranges_hold_it(tmp_path):
    base = preset("gelsight-2020-flat")
    results = run(make(trials=2), tmp_path / "inside")
    assert results.start is not None
    assert results.start["trial"] == 0
    assert results.design(0).digest == base.digest
    outside = RANGES | {"leds.tilt_deg": Parameter(low=30, high=60)}
    assert run(make(trials=2, parameters=outside), tmp_path / "outside").start is None


def test_effects_of_a_model_stay_with_every_design(tmp_path):
    model = SensorModel.of(preset("gelsight-2020-flat")).with_effect(
        AppliedEffect(name="contact_kernel", values={"length_ratio": 1.5})
    )
    unit = AppliedEffect(
        name="led_position", values={"radial_mm": 0.5, "height_mm": 0.0, "tangential_mm": 0.0}
    )
    (tmp_path / "built.toml").write_text(model.with_effect(unit).dumps(), encoding="utf-8")
    text = 'version = 1\nbase = "built.toml"\n[parameters.leds.tilt_deg]\nlow = 0\nhigh = 60\n'
    study = load_study(write(tmp_path, text)).model_copy(update=BARE)
    assert study.base == model.design
    assert study.digest != make(parameters={"leds.tilt_deg": Parameter(low=0, high=60)}).digest
    assert load_study(write(tmp_path, dumps_study(study))).digest == study.digest
    asked = []

    def remember(subject, *, fidelity, seed):
        asked.append(subject)
        return closed_form(subject.design, fidelity=fidelity, seed=seed)

    run(study, tmp_path / "out", trials=2, evaluator=remember)
    assert asked[0].digest == model.digest  # where one unit's LEDs were found is no property of other designs
    assert [subject.effects for subject in asked] == [model.effects] * 2
    assert load_model(tmp_path / "out" / "trials" / "0001" / "model.toml").digest == asked[1].digest
    sweep(model.with_effect(unit), {"leds.tilt_deg": [5.0]}, progress=False, evaluator=remember)
    assert asked[2].effects == model.effects
    assert asked[2].design.leds.tilt_deg == 5.0


def test_every_evaluation_gets_the_fidelity_and_the_seed_of_the_study(tmp_path):
    asked = []

    def remember(design, *, fidelity, seed):
        asked.append((fidelity, seed))
        return closed_form(design, fidelity=fidelity, seed=seed)

    run(make(trials=2, fidelity="standard", seed=7), tmp_path, evaluator=remember)
    assert asked == [("standard", 7)] * 2


@pytest.mark.slow
@pytest.mark.parametrize("sampler", ["tpe", "nsga2", "nsga3", "cmaes", "random", "qmc", "gp"])
def test_a_run_in_two_parts_gives_the_trials_of_one_run(tmp_path, sampler):
    if sampler == "gp":
        pytest.importorskip("torch", reason="Gaussian processes need PyTorch")
    one = {"objectives": {"uniformity_u0": "maximise"}} if sampler == "cmaes" else {}
    study = make(sampler=sampler, trials=14, seed=3, **one)
    whole = run(study, tmp_path / "whole").frame
    counting = Counting()
    run(study, tmp_path / "parts", trials=5, evaluator=counting)
    parts = run(study, tmp_path / "parts", evaluator=counting).frame
    pd.testing.assert_frame_equal(whole, parts)
    assert len(counting.digests) == len(set(counting.digests)) == parts["reuse_of"].isna().sum()


def test_another_seed_gives_other_designs(tmp_path):
    study = make(trials=3)
    first = run(study, tmp_path / "a").frame
    second = run(make(trials=3, seed=1), tmp_path / "b").frame
    shared = set(first["leds.tilt_deg"]) & set(second["leds.tilt_deg"])
    assert shared == {study.base.leds.tilt_deg}


@pytest.mark.slow
def test_the_search_finds_the_optimum_of_a_closed_form(tmp_path):
    study = make(objectives={"normal_error_median_deg": "minimise"}, trials=40)
    best = run(study, tmp_path).picks.iloc[0]
    assert best["leds.tilt_deg"] == pytest.approx(10, abs=8)  # a tenth of the range
    assert best["normal_error_median_deg"] < 1.2


@pytest.mark.slow
def test_infeasible_designs_are_recorded_and_never_evaluated(tmp_path):
    # Panels of 6.34 mm at 19 deg reach 3 mm below their centre: below about 3 mm they hit the membrane.
    study = make(
        parameters=RANGES | {"leds.height_mm": Parameter(low=0, high=14)}, sampler="random", trials=12
    )
    counting = Counting()
    results = run(study, tmp_path, evaluator=counting)
    frame = results.frame
    infeasible = frame[frame["state"] == "infeasible"]
    assert results.counts()["complete"] == 12
    assert len(infeasible) >= 1
    assert results.rejections() == {"leds_above_membrane": len(infeasible)}
    for _, row in infeasible.iterrows():
        design = results.design(row["trial"])
        assert design.digest not in counting.digests
        assert row["violation_mm"] == pytest.approx(design.margins()["leds_above_membrane"])
        assert not (tmp_path / "trials" / f"{row['trial']:04d}").exists()


def test_designs_that_validation_refuses_are_infeasible(tmp_path):
    parameters = {"leds.emitting_width_mm": Parameter(low=6, high=12)}  # the board is 9 mm wide
    results = run(make(parameters=parameters, sampler="random"), tmp_path)
    assert results.counts()["complete"] == 6
    assert results.counts()["infeasible"] >= 1
    (reason, count), *rest = results.rejections().items()
    assert "emitting_width_mm: must not exceed body_width_mm (9 mm)" in reason
    assert count + sum(number for _, number in rest) == results.counts()["infeasible"]


def test_infeasibility_found_while_evaluating_does_not_count(tmp_path):
    def particular(design, *, fidelity, seed):
        if design.leds.tilt_deg < 10:
            raise InfeasibleDesign("the camera sees a LED")
        return closed_form(design, fidelity=fidelity, seed=seed)

    results = run(make(sampler="random", trials=8), tmp_path, evaluator=particular)
    assert results.counts()["complete"] == 8
    assert results.rejections() == {"the camera sees a LED": results.counts()["infeasible"]}
    assert (results.frame.loc[results.frame["state"] == "complete", "leds.tilt_deg"] >= 10).all()


@pytest.mark.slow
def test_the_sampler_learns_from_infeasible_designs(tmp_path):
    ranges = RANGES | {"leds.height_mm": Parameter(low=-20, high=14)}  # two thirds lie below the membrane
    shares = {}
    for sampler in ("random", "tpe"):
        frame = run(make(parameters=ranges, sampler=sampler, trials=40, seed=1), tmp_path / sampler).frame
        later = frame["state"].iloc[len(frame) // 2 :]
        shares[sampler] = (later == "infeasible").mean()
    assert shares["random"] > 0.5
    assert shares["tpe"] < 0.5 * shares["random"]


@pytest.mark.slow
def test_a_search_without_any_feasible_design_ends_and_says_why(tmp_path, monkeypatch):
    monkeypatch.setattr("designlab.optimization.study.search._GIVE_UP", 30)
    study = make(parameters={"leds.height_mm": Parameter(low=-20, high=-10)})
    counting = Counting()
    with pytest.raises(
        RuntimeError, match=r"no feasible design among the last 30; the last breaks leds_above"
    ):
        run(study, tmp_path, evaluator=counting)
    assert counting.digests == []


@pytest.mark.slow
def test_a_search_that_only_evaluations_find_infeasible_ends_too(tmp_path, monkeypatch):
    def refuse(design, *, fidelity, seed):
        assert len(counting.digests) <= 30
        raise InfeasibleDesign("the camera sees a LED")

    monkeypatch.setattr("designlab.optimization.study.search._GIVE_UP", 30)
    counting = Counting(refuse)
    with pytest.raises(RuntimeError, match=r"no feasible design among the last 30; .* sees a LED"):
        run(make(sampler="random"), tmp_path, evaluator=counting)
    assert len(counting.digests) == 30


@pytest.mark.slow
def test_equal_designs_are_evaluated_once(tmp_path):
    choices = tuple(10.0 + k for k in range(8))
    study = make(parameters={"leds.tilt_deg": Parameter(choices=choices)}, sampler="random", trials=6)
    counting = Counting()
    results = run(study, tmp_path, evaluator=counting)
    assert results.evaluated == 6  # what is drawn once more does not count
    assert len(counting.digests) == len(set(counting.digests)) == 6
    assert results.frame["reuse_of"].notna().sum() == results.counts()["complete"] - 6 > 0
    assert results.pareto["reuse_of"].isna().all()  # copies are not alternatives
    for _, row in results.frame[results.frame["reuse_of"].notna()].iterrows():
        source = results.frame[results.frame["trial"] == row["reuse_of"]].iloc[0]
        assert source["uniformity_u0"] == row["uniformity_u0"]
        assert source["leds.tilt_deg"] == row["leds.tilt_deg"]


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_search_ends_where_the_ranges_hold_no_more_designs(tmp_path, monkeypatch, workers):
    monkeypatch.setattr("designlab.optimization.study.search._REPEATS", 20)
    study = make(parameters={"leds.tilt_deg": Parameter(choices=(10.0, 30.0))}, sampler="random", trials=10)
    results = run(study, tmp_path, workers=workers, evaluator=closed_form)
    assert results.evaluated == 2
    assert run(study, tmp_path, evaluator=closed_form).evaluated == 2


@pytest.mark.slow
def test_whole_numbers_and_steps_are_kept(tmp_path):
    study = make(
        parameters={
            "leds.tilt_deg": Parameter(low=0, high=50, step=15),
            "leds.height_mm": Parameter(low=5, high=14, log=True),
            "optics.path_length": Parameter(low=3, high=9),
        },
        sampler="random",
        trials=12,
    )
    frame = run(study, tmp_path).frame
    assert set(frame["leds.tilt_deg"]) <= {0.0, 15.0, 30.0, 45.0}
    assert frame["leds.height_mm"].between(5, 14).all()
    assert frame["optics.path_length"].dtype.kind == "i"
    assert frame["optics.path_length"].between(3, 9).all()


@pytest.mark.slow
def test_workers_reach_the_same_number_of_designs(tmp_path):
    results = run(make(trials=8, sampler="random"), tmp_path, workers=2)
    assert results.counts() == counts(complete=8)
    alone = run(make(trials=8, sampler="random"), tmp_path / "alone")
    assert set(results.frame["leds.tilt_deg"]) == set(alone.frame["leds.tilt_deg"])


def test_the_folder_of_another_study_is_refused_by_name(tmp_path):
    run(make(trials=1), tmp_path)
    with pytest.raises(
        StudyError, match=r"holds another study, 'ring', which differs from 'new' in seed; choose"
    ):
        run(make(name="new", seed=5), tmp_path)


def test_a_folder_in_use_is_refused(tmp_path):
    messages = []

    def nested(design, *, fidelity, seed):
        with pytest.raises(RuntimeError, match="another run of this study is writing there") as caught:
            run(make(), tmp_path)
        messages.append(str(caught.value))
        return closed_form(design, fidelity=fidelity, seed=seed)

    assert run(make(trials=1), tmp_path, evaluator=nested).counts()["complete"] == 1
    assert messages == [f"{tmp_path}: another run of this study is writing there"]


def test_results_can_be_read_while_the_study_runs(tmp_path):
    seen = []

    def reading(design, *, fidelity, seed):
        now = load_results(tmp_path).counts()
        seen.append((now["complete"], now["running"]))
        return closed_form(design, fidelity=fidelity, seed=seed)

    run(make(trials=3), tmp_path, evaluator=reading)
    assert seen == [(0, 1), (1, 1), (2, 1)]


def test_a_defect_stops_the_study_and_the_design_is_tried_again(tmp_path):
    def defective(design, *, fidelity, seed):
        if len(counting.digests) == 3:
            raise KeyError("a defect")
        return closed_form(design, fidelity=fidelity, seed=seed)

    counting = Counting(defective)
    with pytest.raises(KeyError, match="a defect"):
        run(make(), tmp_path, evaluator=counting)
    assert load_results(tmp_path).counts()["complete"] == 2
    results = run(make(), tmp_path, evaluator=counting)
    assert results.counts() == counts(complete=6, interrupted=1)
    assert counting.digests[2] == counting.digests[3]
    assert len(set(counting.digests)) == 6


@pytest.mark.slow
def test_a_render_that_fails_costs_one_trial_and_ten_in_a_row_end_the_study(tmp_path):
    def failing(design, *, fidelity, seed):
        if len(counting.digests) in failures:
            raise RenderFailed("the picture is black")
        return closed_form(design, fidelity=fidelity, seed=seed)

    failures = {1, 4}
    counting = Counting(failing)
    results = run(make(), tmp_path / "two", evaluator=counting)
    assert results.counts() == counts(complete=6, failed=2)
    assert results.rejections() == {}
    failed = results.frame[results.frame["state"] == "failed"]
    assert list(failed["reason"]) == ["the picture is black"] * 2
    assert len(set(counting.digests)) == 8

    failures = set(range(2, 99))
    counting = Counting(failing)
    with pytest.raises(
        RuntimeError, match=r"10 evaluations in a row failed, .*\(trial 10\) .*picture is black"
    ):
        run(make(), tmp_path / "all", evaluator=counting)
    assert len(counting.digests) == 11


@pytest.mark.slow
def test_a_score_that_is_no_number_is_a_failure(tmp_path):
    def blind(design, *, fidelity, seed):
        score = closed_form(design, fidelity=fidelity, seed=seed)
        score.scores["uniformity_u0"].value = math.nan
        return score

    with pytest.raises(RuntimeError, match="uniformity_u0 is not a finite number"):
        run(make(), tmp_path, evaluator=blind)
    assert load_results(tmp_path).counts() == counts(failed=10)


def test_an_objective_that_is_no_score_is_named(tmp_path):
    study = make(objectives={"normal_eror": "minimise"})
    with pytest.raises(
        StudyError, match=r"no score is called 'normal_eror', only uniformity_u0, normal_error_m"
    ):
        run(study, tmp_path)


@pytest.mark.parametrize("field", ["objectives", "constraints"])
def test_of_simulated_scores_a_wrong_name_is_found_beforehand(tmp_path, field):
    """And a folder where it was found too late takes the corrected study."""
    values = {"objectives": "minimise", "constraints": {"most": 3}}
    study = make(**{field: {"normal_eror": values[field]}})
    with pytest.raises(StudyError, match=rf"field {field}: no score is called 'normal_eror', only u"):
        run(study, tmp_path, evaluator=None)
    assert not list(tmp_path.iterdir())
    with pytest.raises(StudyError, match="'normal_eror'"):
        run(study, tmp_path)  # an evaluator of one's own gives scores of its own
    assert run(make(), tmp_path).counts() == counts(complete=6)


def test_the_folder_states_the_study_as_it_was_last_run(tmp_path):
    run(make(trials=2), tmp_path)
    run(make(trials=3, plan=Plan(seeds=4), name="longer"), tmp_path)
    kept = load_study(tmp_path / "study.toml")
    assert (kept.trials, kept.plan, kept.name) == (3, Plan(seeds=4), "longer")
    assert load_results(tmp_path).study == kept


def test_the_clocks_of_machines_that_share_a_study_may_differ(tmp_path, monkeypatch):
    """What another run has just drawn is its own, whatever time it is there; unsigned for long, it died."""
    study, url = make(), f"sqlite:///{tmp_path}/shared.db"
    with opened(tmp_path / "out", study, storage=url) as record:
        search = StudyRun(study, tmp_path / "out", record, closed_form, shared=True)
        theirs = record.ask()
        with sqlite3.connect(tmp_path / "shared.db") as database:
            database.execute("update trials set datetime_start = '2001-01-01 00:00:00'")
        assert [search._others(), search._others()] == [1, 1]
        assert record.get_trials()[theirs.number].state.name == "RUNNING"
        monkeypatch.setattr("designlab.optimization.study.search.SILENT_S", 0)
        search._others()
        assert record.get_trials()[theirs.number].state.name == "FAIL"


@pytest.mark.slow
def test_a_run_that_is_taken_for_dead_while_it_draws_draws_anew(tmp_path, monkeypatch):
    taken, ask = [], optuna.Study.ask

    def taken_over(record, *given):
        trial = ask(record, *given)
        if not taken:
            taken.append(record.tell(trial.number, state=optuna.trial.TrialState.FAIL))
        return trial

    monkeypatch.setattr(optuna.Study, "ask", taken_over)
    results = run(make(trials=3), tmp_path / "out", storage=f"sqlite:///{tmp_path}/shared.db")
    assert results.counts() == counts(complete=3, interrupted=1)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_says_how_to_resume_and_loses_nothing(tmp_path, workers):
    study = make(trials=8, sampler="random")
    whole = run(study, tmp_path / "whole")

    def when_two_are_done():
        while sum(1 for _ in (tmp_path / "cut").glob("trials/*/score.json")) < 2:
            stop.wait(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    stop = threading.Event()
    threading.Thread(target=when_two_are_done, daemon=True).start()
    with pytest.raises(
        StudyInterrupted, match=r"'ring' interrupted after \d of 8 designs; run it again .*cut"
    ):
        run(study, tmp_path / "cut", evaluator=slow_closed_form, workers=workers)
    done = load_results(tmp_path / "cut").counts()
    assert 2 <= done["complete"] < 8
    assert done["running"] == 0
    results = run(study, tmp_path / "cut", workers=workers)
    assert results.counts()["complete"] == 8
    finished = results.frame[results.frame["state"] == "complete"]
    assert sorted(finished["leds.tilt_deg"]) == sorted(whole.frame["leds.tilt_deg"])


def slow_closed_form(design, *, fidelity, seed):
    threading.Event().wait(0.1)
    return closed_form(design, fidelity=fidelity, seed=seed)


@pytest.mark.slow
def test_a_design_that_kills_its_worker_is_given_up_and_those_beside_it_are_not(tmp_path, monkeypatch):
    monkeypatch.setattr("designlab.optimization.study.runner.submitter", mortal)
    deadly = preset("gelsight-2020-flat").digest

    def evaluator(design, *, fidelity, seed):
        time.sleep(0.02 if design.digest == deadly else 0.06)
        if design.digest == deadly:
            raise Death
        return closed_form(design, fidelity=fidelity, seed=seed)

    counting = Counting(evaluator)
    results = run(make(sampler="random"), tmp_path, workers=2, evaluator=counting)
    assert results.counts() == counts(complete=6, interrupted=2, failed=1)
    assert results.failures() == {"the process that evaluated it died twice": 1}
    assert counting.digests.count(deadly) == 2
    done = results.frame.loc[results.frame["state"] == "complete", "trial"]
    assert {results.design(trial).digest for trial in done} == set(counting.digests) - {deadly}


def test_workers_that_all_die_end_the_study_which_says_how_to_go_on(tmp_path, monkeypatch):
    def evaluator(design, *, fidelity, seed):
        raise Death

    monkeypatch.setattr("designlab.optimization.study.runner.submitter", mortal)
    counting = Counting(evaluator)
    with pytest.raises(RuntimeError, match=r"again and again, .* 2 workers; .*: the same command goes on"):
        run(make(sampler="random"), tmp_path, workers=2, evaluator=counting)
    assert 5 <= len(counting.digests) <= 7
    assert run(make(sampler="random"), tmp_path).counts()["complete"] == 6


def test_a_folder_without_a_study_is_named(tmp_path):
    with pytest.raises(StudyError, match="holds no study"):
        load_results(tmp_path)


@pytest.mark.parametrize("use", [load_results, lambda folder: run(make(trials=2), folder)])
def test_what_a_newer_version_wrote_is_named_and_kept(tmp_path, use):
    run(make(trials=1), tmp_path)
    with sqlite3.connect(tmp_path / "study.db") as record:
        record.execute("update alembic_version set version_num = 'v99'")
        record.execute("update version_info set schema_version = 99")
    with pytest.raises(StudyError, match=r"study\.db: is of another version: [^\n]*$"):
        use(tmp_path)
    with sqlite3.connect(tmp_path / "study.db") as record:
        assert record.execute("select count(*) from trials").fetchone() == (1,)
    definition = tmp_path / "study.toml"
    definition.write_text(definition.read_text().replace("version = 1", "version = 9", 1))
    with pytest.raises(StudyError, match=r"study\.toml: field version: has format version 9"):
        load_results(tmp_path)


def test_a_damaged_record_is_named(tmp_path):
    run(make(trials=1), tmp_path)
    (tmp_path / "study.db").write_bytes(b"not a database" * 100)
    for use in (load_results, lambda folder: run(make(trials=1), folder)):
        with pytest.raises(StudyError, match=r"study\.db: is damaged: .*; `study run --rebuild`"):
            use(tmp_path)


@pytest.mark.slow
def test_damage_inside_a_record_is_named(tmp_path):
    run(make(trials=2), tmp_path)
    record = tmp_path / "study.db"
    content = bytearray(record.read_bytes())
    page = int.from_bytes(content[16:18], "big")
    content[2 * page :] = b"\xff" * (len(content) - 2 * page)  # the head is that of a database still
    record.write_bytes(content)
    for use in (load_results, importance, lambda folder: run(make(trials=2), folder)):
        with pytest.raises(StudyError, match=r"study\.db: is damaged: database disk image is malformed"):
            use(tmp_path)


def test_a_database_that_drops_is_named(tmp_path):
    url = f"sqlite:///{tmp_path}/shared.db"
    run(make(trials=1), tmp_path / "out", storage=url)

    def read():
        with (
            reading(tmp_path / "out", url) as (_, record),
            sqlite3.connect(tmp_path / "shared.db") as database,
        ):
            database.execute("drop table trials")
            database.commit()
            record.get_trials()

    with pytest.raises(OSError, match=r"cannot read sqlite:.*shared\.db: no such table"):
        read()


@pytest.mark.slow
@pytest.mark.parametrize("lost", [False, True])
def test_a_record_is_rebuilt_of_what_was_finished(tmp_path, lost):
    study = make(
        parameters=RANGES | {"leds.height_mm": Parameter(low=0, high=14)},
        sampler="random",
        trials=8,
        constraints={"uniformity_u0": {"least": 0.5}},
        plan=Plan(promoted=1, confirmed=1, seeds=1),
    )
    before = run(study, tmp_path)
    if lost:
        (tmp_path / "study.db").unlink()
    else:
        (tmp_path / "study.db").write_bytes(b"not a database" * 100)
    counting = Counting()
    with pytest.raises(StudyError, match=r"study\.db .*`study run --rebuild`|study\.db: is damaged"):
        run(study, tmp_path, evaluator=counting)
    after = run(study, tmp_path, evaluator=counting, rebuild=True)
    assert counting.digests == []
    assert len(list(tmp_path.glob("study.db.damaged-1"))) == 1 - lost
    columns = ["trial", "leds.tilt_deg", "leds.height_mm", "uniformity_u0", "violated"]
    for frame in (before.frame, after.frame):
        frame["violated"] = frame["violated"].astype(str)
    done = [frame.loc[frame["state"] == "complete", columns] for frame in (before.frame, after.frame)]
    pd.testing.assert_frame_equal(done[1].reset_index(drop=True), done[0].reset_index(drop=True))
    pd.testing.assert_frame_equal(after.confirmed, before.confirmed)
    assert run(study, tmp_path, trials=10).counts()["complete"] == 10


@pytest.mark.slow
def test_a_record_that_lacks_finished_trials_is_refused(tmp_path):
    """An old copy of it, say: new trials would overwrite what is kept under their numbers."""
    study = make(trials=3)
    run(study, tmp_path)
    with opened(tmp_path, study, rebuild=True):
        pass
    with pytest.raises(StudyError, match=r"the record lacks trial 0, which is kept; `study run --rebuild`"):
        run(study, tmp_path)
    counting = Counting()
    assert run(study, tmp_path, rebuild=True, evaluator=counting).counts() == counts(complete=3)
    assert counting.digests == []


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"cannot write .*file/study"):
        run(make(), tmp_path / "file" / "study")
