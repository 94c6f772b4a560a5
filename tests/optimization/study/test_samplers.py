"""Which sampler draws the next design; chance stands in for Gaussian processes, which need PyTorch."""

import optuna
import pytest

from designlab.optimization.study import Parameter, StudyError, StudyInterrupted
from designlab.optimization.study.samplers import method
from designlab.optimization.study.samplers import sampler as sampler_of
from designlab.optimization.study.search import StudyRun
from designlab.simulation.simulator import RenderFailed
from tests.helpers.studies import RANGES, Death, closed_form, make, mortal, run

NARROW = RANGES | {"leds.height_mm": Parameter(low=0, high=14)}  # LEDs below the gel cannot be built


@pytest.fixture
def torch(monkeypatch):
    """Have Gaussian processes, of which chance draws in place."""

    def drawn(name, study, seed, infeasible):
        return optuna.samplers.RandomSampler(seed=seed)

    monkeypatch.setattr("designlab.optimization.study.samplers.has_torch", lambda: True)
    monkeypatch.setattr("designlab.optimization.study.samplers._sampler", drawn)


def test_tpe_begins_by_chance_with_ten_designs_that_can_be_built():
    study = make()
    assert sampler_of(study, "tpe", 0)._n_startup_trials == 10
    assert sampler_of(study, "tpe", 0, infeasible=30)._n_startup_trials == 40


def test_gaussian_processes_draw_where_torch_is_and_tpe_where_designs_cannot_be_built(monkeypatch):
    for torch, usual in ((True, "gp"), (False, "tpe")):
        monkeypatch.setattr("designlab.optimization.study.samplers.has_torch", lambda torch=torch: torch)
        assert method(make()) == usual
        assert method(make(), rejected=1) == "tpe"
        assert method(make(sampler="nsga2"), rejected=1) == "nsga2"
        for sampler in ("auto", "tpe", "nsga2"):
            assert method(make(sampler=sampler), rejected=21) == "random"


@pytest.mark.slow
def test_it_is_kept_which_sampler_drew_a_design(tmp_path):
    drawn = run(make(sampler="qmc", trials=3), tmp_path).frame["method"]
    assert list(drawn) == [None, "qmc", "qmc"]  # the base design is drawn by nobody


def test_gaussian_processes_need_torch(tmp_path, monkeypatch):
    monkeypatch.setattr("designlab.optimization.study.samplers.has_torch", lambda: False)
    with pytest.raises(StudyError, match=r"field sampler: 'gp' needs PyTorch.*pip install torch"):
        run(make(sampler="gp"), tmp_path)


def before(frame, states):
    """Samplers of designs after one that ended in certain ways, and of all others."""
    states_before = frame["state"].shift().isin(states)
    drawn = frame["method"].notna()
    return set(frame["method"][states_before & drawn]), set(frame["method"][~states_before & drawn])


@pytest.mark.slow
def test_tpe_draws_after_designs_that_cannot_be_built(tmp_path, torch):
    for sampler in ("auto", "gp"):
        frame = run(make(parameters=NARROW, sampler=sampler, trials=12), tmp_path / sampler).frame
        assert before(frame, ["infeasible"]) == ({"tpe"}, {"gp"})


def test_tpe_draws_after_designs_that_have_no_score(tmp_path, torch):
    def failing(design, *, fidelity, seed):
        if design.leds.tilt_deg > 30:
            raise RenderFailed("no light")
        return closed_form(design, fidelity=fidelity, seed=seed)

    frame = run(make(trials=12), tmp_path, evaluator=failing).frame
    assert before(frame, ["failed"]) == ({"tpe"}, {"gp"})


@pytest.mark.slow
def test_a_run_that_is_stopped_after_a_rejected_design_goes_on_as_it_would_have(tmp_path, torch, monkeypatch):
    study = make(parameters=NARROW, trials=12)
    whole = run(study, tmp_path / "whole").frame

    def stopping(search, *arguments):
        reject(search, *arguments)
        raise KeyboardInterrupt

    reject = StudyRun._reject
    monkeypatch.setattr(StudyRun, "_reject", stopping)
    stops = 0
    while True:
        try:
            parts = run(study, tmp_path / "cut").frame
            break
        except StudyInterrupted:
            stops += 1
    assert stops > 1
    assert list(parts["method"]) == list(whole["method"])
    assert parts["leds.height_mm"].to_list() == whole["leds.height_mm"].to_list()


@pytest.mark.slow
def test_a_new_record_and_a_second_try_keep_which_sampler_drew(tmp_path, monkeypatch):
    study = make(trials=4, sampler="qmc")
    drawn = run(study, tmp_path).frame["method"]
    (tmp_path / "study.db").unlink()
    assert list(run(study, tmp_path, rebuild=True).frame["method"]) == list(drawn)
    monkeypatch.setattr("designlab.optimization.study.runner.submitter", mortal)
    calls = []

    def dying(design, *, fidelity, seed):
        calls.append(design)
        if len(calls) == 2:
            raise Death
        return closed_form(design, fidelity=fidelity, seed=seed)

    frame = run(study, tmp_path / "dying", evaluator=dying).frame
    assert len(calls) == 5
    assert list(frame["method"]) == [None, *["qmc"] * 4]


def test_a_finished_search_needs_no_sampler(tmp_path, torch, monkeypatch):
    study = make(sampler="gp", trials=3)
    run(study, tmp_path)
    monkeypatch.setattr("designlab.optimization.study.samplers.has_torch", lambda: False)
    assert run(study, tmp_path).counts()["complete"] == 3
