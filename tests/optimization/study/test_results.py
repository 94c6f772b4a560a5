"""What studies found: front, shortlist, history, importance; sweeps."""

import json
import math

import numpy as np
import pandas as pd
import pytest

import designlab
from designlab.optimization.constraint import Bound
from designlab.optimization.study import (
    Plan,
    StudyError,
    SweepInterrupted,
    history,
    importance,
    load_results,
    optimise,
    pareto,
    picks,
    sweep,
)
from designlab.optimization.study.front import hypervolume, losses
from designlab.optimization.study.shortlist import trades
from designlab.sensor.design import DesignError, preset
from designlab.simulation.effects import SensorModel
from designlab.simulation.simulator import RenderFailed
from tests.helpers.studies import BARE, Counting, closed_form, make, run


def table(loss):
    names = [f"f{column}" for column in range(loss.shape[1])]
    frame = pd.DataFrame(loss, columns=names).assign(state="complete", reuse_of=None, trial=range(len(loss)))
    return frame, dict.fromkeys(names, "minimise")


@pytest.mark.parametrize("count", [2, 3])
def test_the_front_agrees_with_a_comparison_one_by_one(count):
    frame, objectives = table(np.random.default_rng(count).integers(0, 6, (60, count)).astype(float))
    rows = frame[list(objectives)].to_numpy()
    expected = {
        i for i, row in enumerate(rows) if not any(all(other <= row) and any(other < row) for other in rows)
    }
    assert set(pareto(frame, objectives)["trial"]) == expected


def test_a_score_that_is_no_number_is_never_best():
    frame, objectives = table(np.array([[math.nan, 1.0], [2.0, math.nan], [3.0, 3.0]]))
    assert list(picks(frame, objectives)["trial"]) == [2]
    assert picks(frame.iloc[:2], objectives).empty


def test_maximised_scores_count_upwards():
    frame = pd.DataFrame(
        {"trial": [0, 1, 2], "state": "complete", "reuse_of": None, "a": [1, 2, 3], "b": [1, 3, 2]}
    )
    assert list(pareto(frame, {"a": "maximise", "b": "minimise"})["trial"]) == [2, 0]
    assert list(pareto(frame, {"a": "maximise", "b": "maximise"})["trial"]) == [2, 1]


def test_the_shortlist_holds_the_extremes_and_the_knee():
    x = np.linspace(0.05, 1, 40)
    frame, objectives = table(np.stack([x, 0.05 / x], axis=1))
    chosen = picks(frame, objectives)
    assert len(chosen) == 5
    assert list(chosen["pick"][:3]) == ["best f0", "best f1", "knee"]
    # The curve y = c / x is symmetric about x = y, where it is nearest to the corner.
    assert chosen.iloc[2]["f0"] == pytest.approx(math.sqrt(0.05), abs=0.03)
    assert list(picks(frame, objectives, most=2)["pick"]) == ["knee", "best f0"]


def test_of_designs_that_cannot_be_told_apart_one_is_shortlisted():
    """Within error bars and close in parameters; the same scores by other parameters are another design."""
    frame, objectives = table(np.array([[0.0, 3.0], [0.1, 2.9], [3.0, 0.0], [3.1, -0.1], [1.0, 1.0]]))
    frame = frame.assign(tilt=[0.0, 1.0, 50.0, 90.0, 20.0], side=list("gggpg"), f0_se=0.1, f1_se=0.1)
    by_score = picks(frame, objectives)
    assert set(by_score["trial"]) == {0, 1, 2, 3, 4}
    chosen = picks(frame, objectives, parameters=("tilt", "side"))
    assert dict(zip(chosen["trial"], chosen["pick"], strict=True)) == {
        0: "best f0",
        3: "best f1",
        4: "knee",
        2: "different",
    }
    units = {"f0": "1", "f1": "um", "tilt": "deg"}
    said = trades(chosen, frame.iloc[0], frame, objectives, ("tilt", "side"), units, str.upper)
    assert said[3] == (
        "better in F1 (-0.1 µm, not 3 µm); worse in F0 (3.1, not 0); "
        "changed most: TILT 90 deg, not 0 deg; SIDE p, not g"
    )
    assert (
        "not told apart in f0 (0.1, not 0)" in trades(frame, frame.iloc[0], frame, objectives, (), units)[1]
    )
    assert 0 not in said


def test_what_the_reference_lacks_is_said_without_a_before():
    frame, objectives = table(np.array([[0.0, 3.0], [3.0, 0.0]]))
    frame = frame.assign(variant=["dome", "flat"], radius=[40.0, None], tilt=[None, 20.0])
    (words,) = trades(
        frame.iloc[1:], frame.iloc[0], frame, objectives, ("variant", "radius", "tilt"), {}
    ).values()
    assert words.endswith("changed most: variant flat, not dome; tilt 20")


def test_the_hypervolume_of_a_staircase_is_its_area():
    loss = np.array([[0.0, 2.0], [1.0, 1.0], [2.0, 0.0], [2.5, 2.5], [9.0, 0.0]])
    assert hypervolume(loss, np.array([3.0, 3.0])) == pytest.approx(6.0)  # 1 + 2 + 3 unit cells


@pytest.mark.slow
def test_the_history_never_gets_worse(tmp_path):
    results = run(make(trials=12, sampler="random"), tmp_path)
    progress = history(results.frame, results.study.objectives)
    assert progress["uniformity_u0"].iloc[-1] == results.frame["uniformity_u0"].max()
    assert progress["normal_error_median_deg"].is_monotonic_decreasing
    assert progress["hypervolume"].is_monotonic_increasing
    assert progress["hypervolume"].iloc[-1] == 1


@pytest.mark.slow
def test_importance_finds_the_parameter_that_matters(tmp_path):
    study = make(trials=30, sampler="qmc")
    run(study, tmp_path, trials=4)
    assert importance(tmp_path) is None
    run(study, tmp_path)
    shares = importance(tmp_path)
    assert shares is not None
    for share in shares.values():  # the tilt moves both scores more than ten times as far as the height
        assert share["leds.tilt_deg"] > 0.8
        assert sum(share.values()) == pytest.approx(1)


def test_results_as_json_hold_the_front(tmp_path):
    results = run(make(), tmp_path)
    content = json.loads(json.dumps(results.to_json(), allow_nan=False))
    assert content["trials"]["complete"] == 6
    assert [row["trial"] for row in content["pareto"]] == list(results.pareto["trial"])
    assert {"leds.tilt_deg", "uniformity_u0", "uniformity_u0_se", "pick"} <= set(content["picks"][0])


def test_losses_turn_maximised_scores():
    frame = pd.DataFrame({"a": [1.0], "b": [2.0]})
    np.testing.assert_array_equal(losses(frame, {"a": "maximise", "b": "minimise"}), [[-1.0, 2.0]])


def test_a_sweep_has_one_row_for_each_combination():
    counting = Counting()
    grid = {"leds.tilt_deg": range(0, 60, 20), "leds.height_mm": [1.0, 8.0]}
    frame = sweep(preset("gelsight-2020-flat"), grid, progress=False, evaluator=counting)
    assert list(zip(frame["leds.tilt_deg"], frame["leds.height_mm"], strict=True)) == [
        (tilt, height) for tilt in (0, 20, 40) for height in (1.0, 8.0)
    ]
    low = frame[frame["leds.height_mm"] == 1.0]
    assert not low["feasible"].any()
    assert low["uniformity_u0"].isna().all()
    assert low["reason"].str.match(r"leds_above_membrane by [\d.]+ mm: every LED body lies above").all()
    high = frame[frame["leds.height_mm"] == 8.0]
    assert high["feasible"].all()
    np.testing.assert_allclose(high["uniformity_u0"], np.exp(-(((high["leds.tilt_deg"] - 30) / 40) ** 2)))
    assert len(counting.digests) == 3


def test_a_sweep_keeps_what_is_finished_and_goes_on(tmp_path):
    def stopped(design, *, fidelity, seed):
        if len(counting.digests) == 3:
            raise KeyboardInterrupt
        if len(counting.digests) == 2:
            raise RenderFailed("the picture is black")
        return closed_form(design, fidelity=fidelity, seed=seed)

    base, heights = preset("gelsight-2020-flat"), {"leds.height_mm": [1.0, 8.0]}
    common = {"progress": False, "out": tmp_path}
    counting = Counting(stopped)
    with pytest.raises(
        SweepInterrupted, match=r"after 5 of 6 designs; what is finished is kept: the same call"
    ):
        sweep(base, {"leds.tilt_deg": range(0, 60, 20)} | heights, evaluator=counting, **common)
    counting = Counting()
    grid = {"leds.tilt_deg": np.arange(0, 80, 20)} | heights
    frame = sweep(base, grid, evaluator=counting, **common)
    assert len(counting.digests) == 3  # one failed, one was cut off, one is new
    assert frame.equals(sweep(base, grid, evaluator=closed_form, progress=False))
    assert sweep(base, grid, evaluator=counting, **common).equals(frame)
    assert len(counting.digests) == 3
    another = "holds a sweep of another design, fidelity, seed or other presses"
    with pytest.raises(ValueError, match=rf"{another} \(.*seed 0\);"):
        sweep(base, grid, evaluator=counting, seed=1, **common)
    with pytest.raises(ValueError, match=another):
        sweep(base, grid, evaluator=counting, depth_mm=0.5, **common)


@pytest.mark.slow
def test_a_sweep_on_a_cluster_has_the_same_rows():
    distributed = pytest.importorskip("distributed", reason="Dask is an extra")
    grid = {"leds.tilt_deg": range(0, 60, 20), "leds.height_mm": [1.0, 8.0]}
    here = sweep(preset("gelsight-2020-flat"), grid, progress=False, evaluator=closed_form)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        there = sweep(
            preset("gelsight-2020-flat"),
            grid,
            dask=cluster.scheduler_address,
            progress=False,
            evaluator=closed_form,
        )
    pd.testing.assert_frame_equal(there, here)


def test_a_sweep_over_no_field_of_a_design_is_refused():
    with pytest.raises(DesignError, match=r"no field 'leds\.tilt' in a design"):
        sweep(preset("default"), {"leds.tilt": [1]}, progress=False, evaluator=closed_form)
    with pytest.raises(ValueError, match="give at least one field"):
        sweep(preset("default"), {"leds.tilt_deg": []}, progress=False, evaluator=closed_form)


def test_optimise_takes_ranges_and_choices(tmp_path):
    results = optimise(
        preset("gelsight-2020-flat"),
        {"leds.tilt_deg": (0.0, 60.0), "leds.height_mm": [7.0, 9.0]},
        out=tmp_path,
        trials=4,
        progress=False,
        evaluator=closed_form,
        **BARE,
    )
    with pytest.raises(StudyError, match=r"'coverage', .*hold unless others are given, \{\} for none"):
        optimise(preset("default"), {"leds.tilt_deg": (0, 9)}, out=tmp_path / "own", evaluator=closed_form)
    assert set(results.frame["leds.height_mm"]) <= {7.0, 9.0}
    assert results.frame["leds.tilt_deg"].between(0, 60).all()
    wrong = {
        (40, 10): r"field parameters\.leds\.tilt_deg: low must be below high, got low 40, high 10",
        5: r"field parameters\.leds\.tilt_deg: must be a range \(low, high\), a list .*, got 5",
        "steep": r"field parameters\.leds\.tilt_deg: must be a range .*, got 'steep'",
    }
    for given, message in wrong.items():
        with pytest.raises(StudyError, match=message):
            optimise(preset("default"), {"leds.tilt_deg": given}, out=tmp_path, evaluator=closed_form)
    with pytest.raises(StudyError, match=r"optimise\(\): .*leds\.tilt_deg: .*got 120\.0"):
        optimise(preset("default"), {"leds.tilt_deg": (0.0, 120.0)}, out=tmp_path, evaluator=closed_form)


def test_optimise_takes_all_that_a_study_file_states(tmp_path):
    study = designlab.optimise(
        preset("gelsight-2020-flat"),
        {"leds.tilt_deg": {"low": 0, "high": 40, "step": 5}},
        out=tmp_path,
        constraints={"uniformity_u0": {"least": 0.2}},
        variants={"low": {"leds.height_mm": 6.0}, "high": {"leds.height_mm": 9.0}},
        plan={"promoted": 2, "confirmed": 1, "seeds": 1},
        robust={"copies": 3, "spread": [{"field": "leds.height_mm", "sd": 0.1}]},
        trials=2,
        progress=False,
        evaluator=of_copy,
    ).study
    assert study.constraints == {"uniformity_u0": Bound(least=0.2)}
    assert set(study.variants) == {"low", "high"}
    assert study.plan == Plan(promoted=2, confirmed=1, seeds=1)
    assert study.robust is not None
    assert study.robust.copies == 3
    assert load_results(tmp_path).study == study


def of_copy(model, *, fidelity, seed):
    return closed_form(SensorModel.of(model).design, fidelity=fidelity, seed=seed)
