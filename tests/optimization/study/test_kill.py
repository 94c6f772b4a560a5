"""A study whose process is killed without warning, at any moment, loses and repeats nothing."""

import re
import time
from collections import Counter

import numpy as np
import pandas as pd
import pytest

from designlab.optimization.study import Parameter, Plan, Study, dumps_study, load_results
from tests.helpers.processes import until

pytestmark = pytest.mark.faults

TRIALS = 10
PLAN = Plan(promoted=2, confirmed=1, seeds=2)
UNCONFIRMED = Plan(promoted=0)

PROGRAM = """
import contextlib, math, os, signal, sys, time
from types import SimpleNamespace
from designlab.optimization.study import load_study, run_study

def evaluator(design, *, fidelity, seed):
    log(design, "start")
    time.sleep(0.15)
    log(design, "end")
    if "DEADLY" in os.environ and fidelity != "standard":
        with contextlib.suppress(FileExistsError):
            open(os.environ["DEADLY"] + "-" + fidelity, "x").close()
            os.kill(os.getpid(), signal.SIGKILL)
    tilt = design.leds.tilt_deg
    estimate = lambda value: SimpleNamespace(value=value, se=0.0, bias_bound=0.0, unit="1")
    return SimpleNamespace(scores={
        "uniformity_u0": estimate(math.exp(-((tilt - 30) / 40) ** 2)),
        "normal_error_median_deg": estimate(1 + ((tilt - 10) / 20) ** 2),
    })

def log(design, event):
    with open(os.environ["EVALUATIONS"], "a") as file:
        file.write(f"{design.digest} {event} {os.getpid()}\\n")

if __name__ == "__main__":
    folder, workers = sys.argv[1], int(sys.argv[2])
    if "LARGEST_FILE" in os.environ:
        import resource
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(os.environ["LARGEST_FILE"]),) * 2)
    if "DIES_SIGNING" in os.environ:
        import optuna
        signed = optuna.trial.Trial.set_user_attr
        def sign(trial, name, value):
            signed(trial, name, value)
            if trial.number == int(os.environ["DIES_SIGNING"]):
                os.kill(os.getpid(), signal.SIGKILL)
        optuna.trial.Trial.set_user_attr = sign
    run_study(load_study(folder + ".toml"), out=folder, workers=workers, progress=False, evaluator=evaluator)
"""


@pytest.fixture
def start(tmp_path, processes):
    """Start the study of a folder in a process of its own."""
    study = Study(
        base="gelsight-2020-flat",
        parameters={
            "leds.tilt_deg": Parameter(low=-20, high=60),
            "leds.height_mm": Parameter(low=1, high=14),  # the lowest are infeasible
        },
        trials=TRIALS,
        constraints={},
        seed=5,
    )

    def starter(name, workers=1, plan=UNCONFIRMED, **variables):
        planned = study.model_copy(update={"plan": plan})
        (tmp_path / f"{name}.toml").write_text(dumps_study(planned))
        log = str(tmp_path / f"{name}.log")
        return processes.start(tmp_path / name, workers, EVALUATIONS=log, **variables)

    return starter


def kill_after(process, log, events, delay_s):
    """Kill the process some time after a number of new lines in its log; False if it ended before."""
    already = count(log)
    until(lambda: count(log) >= already + events or process.poll() is not None, "no progress")
    if process.poll() is not None:
        return False
    time.sleep(delay_s)
    process.kill()
    process.wait()
    return True


def count(log):
    """Lines of a log."""
    return len(log.read_text().splitlines()) if log.exists() else 0


def complete(folder):
    frame = load_results(folder).frame
    return frame[frame["state"] == "complete"].drop(columns="trial").reset_index(drop=True)


@pytest.mark.slow
def test_killed_studies_end_like_one_that_was_not(tmp_path, start, processes):
    processes.finish(start("whole"))
    folder, log = tmp_path / "cut", tmp_path / "cut.log"
    random = np.random.default_rng(0)
    # Once while a trial is signed, which is too quick to be met by chance.
    assert start("cut", DIES_SIGNING="3").wait() < 0
    kept = complete(folder)
    kills = 1
    # Three log lines into a run: in the second evaluation, while it is stored, or while the next is drawn.
    while kill_after(start("cut"), log, 3, random.uniform(0, 0.3)):
        kills += 1
        now = complete(folder)
        if len(kept):
            pd.testing.assert_frame_equal(now.iloc[: len(kept)], kept)
        kept = now
    assert kills >= 4
    processes.finish(start("cut"))

    whole, cut = complete(tmp_path / "whole"), complete(folder)
    assert len(cut) == TRIALS
    pd.testing.assert_frame_equal(cut, whole)
    counts = load_results(folder).counts()
    assert counts["running"] == counts["waiting"] == 0
    assert counts["interrupted"] <= kills
    ended = Counter(line.split()[0] for line in log.read_text().splitlines() if line.split()[1] == "end")
    # A design is evaluated again only if the kill fell between the end of its evaluation and its storage.
    assert sum(ended.values()) <= TRIALS + kills
    assert len(ended) == TRIALS


@pytest.mark.slow
def test_workers_die_with_their_parent_and_the_study_goes_on(tmp_path, start, processes):
    folder, log = tmp_path / "many", tmp_path / "many.log"
    process = start("many", workers=2)
    assert kill_after(process, log, 5, 0.05)
    workers = {int(line.split()[2]) for line in log.read_text().splitlines()}
    until(lambda: not any(alive(worker) for worker in workers), "a worker outlived its parent", seconds=20)
    finished = len(complete(folder))
    processes.finish(start("many", workers=2))
    assert 1 <= finished < len(complete(folder)) == TRIALS


@pytest.mark.slow
def test_the_death_of_a_worker_costs_nothing_in_search_and_confirmation(tmp_path, start, processes):
    processes.finish(start("whole", plan=PLAN))
    finished = start("deaths", plan=PLAN, workers=2, DEADLY=str(tmp_path / "died"))
    processes.finish(finished)
    assert sorted(path.name for path in tmp_path.glob("died-*")) == ["died-fast", "died-reference"]
    results, whole = (load_results(tmp_path / name) for name in ("deaths", "whole"))
    assert results.counts()["complete"] == TRIALS
    assert results.counts()["failed"] == results.counts()["running"] == 0
    assert set(results.confirmed["fidelity"]) == {"fast", "standard", "reference"}
    base = [found.confirmed.set_index(["trial", "fidelity"]).loc[-1] for found in (results, whole)]
    pd.testing.assert_frame_equal(*base)


def alive(process_id):
    try:
        with open(f"/proc/{process_id}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_a_design_that_kills_its_process_is_given_up_after_the_second_time(tmp_path, start, processes):
    folder, log = tmp_path / "deadly", tmp_path / "deadly.log"
    for _ in range(2):
        assert kill_after(start("deadly"), log, 1, 0.05)  # always within the first evaluation
    started = [line.split()[0] for line in log.read_text().splitlines()]
    assert started[0] == started[1]
    processes.finish(start("deadly"))
    results = load_results(folder)
    assert results.counts()["complete"] == TRIALS
    assert results.counts()["interrupted"] == results.counts()["failed"] == 1
    assert results.failures() == {"the process that evaluated it died twice": 1}
    assert started[0] not in {results.design(int(t)).digest for t in results.pareto["trial"]}
    assert log.read_text().count(f"{started[0]} start") == 2


@pytest.mark.slow
def test_a_full_disk_is_named_and_costs_no_finished_trial(tmp_path, start, processes):
    # Files that may not grow stand for a disk that is full: the record's log reaches 300 kB within the study.
    process = start("full", LARGEST_FILE="300000")
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 1
    assert re.search(
        r"OSError: cannot write .*full/study\.db: (disk I/O error|database or disk is full)", errors
    )
    finished = complete(tmp_path / "full")
    assert 1 <= len(finished) < TRIALS
    processes.finish(start("full"))
    whole = complete(tmp_path / "full")
    assert len(whole) == TRIALS
    pd.testing.assert_frame_equal(whole.iloc[: len(finished)], finished)
    processes.finish(start("whole"))
    pd.testing.assert_frame_equal(whole, complete(tmp_path / "whole"))
