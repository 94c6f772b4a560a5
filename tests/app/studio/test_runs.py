"""Runs of studies that the studio starts, pauses and goes on with."""

import sys

import pytest

from designlab.app.studio import runs
from tests.helpers.processes import until

# `early` begins before it catches an interrupt, as the command does while it is loaded.
PROGRAM = """
import signal, sys, time
from pathlib import Path
signal.signal(signal.SIGINT, signal.default_int_handler)  # tests may run where it is ignored
folder = Path(sys.argv[1])
early = folder / "early"
if early.exists():
    (folder / "begun").touch()
    time.sleep(60)
try:
    (folder / "begun").touch()
    while not (folder / "done").exists():
        time.sleep(0.02)
        if (folder / "wrong").exists():
            sys.exit("designlab: study.toml: wrong")
except KeyboardInterrupt:
    print("interrupted; to resume: the same command", file=sys.stderr)
    sys.exit(130)
"""


@pytest.fixture
def started(monkeypatch):
    monkeypatch.setattr(runs, "COMMAND", (sys.executable, "-c", PROGRAM))
    found = runs.Runs()
    yield found
    found.stop()


def begin(found, folder):
    found.start(folder)
    until((folder / "begun").exists, "the run has begun")


@pytest.mark.parametrize("count", [1, 2])
def test_a_run_is_started_once_paused_and_gone_on_with(started, tmp_path, count):
    folders = [tmp_path / f"study {number}" for number in range(count)]
    for folder in folders:
        folder.mkdir()
        begin(started, folder)
        started.start(folder)  # runs already
        assert started.running(folder)
        assert started.said(folder) == ""
    first = folders[0]
    started.pause(first)
    until(lambda: not started.running(first), "the run has ended")
    assert started.said(first) == ""
    assert all(started.running(folder) for folder in folders[1:])
    (first / "begun").unlink()
    begin(started, first)
    (first / "done").touch()
    until(lambda: not started.running(first), "the run is done")
    assert started.said(first) == ""


def test_a_run_paused_while_it_is_loaded_has_not_failed(started, tmp_path):
    (tmp_path / "early").touch()
    begin(started, tmp_path)
    started.pause(tmp_path)
    until(lambda: not started.running(tmp_path), "the run has ended")
    assert started.said(tmp_path) == ""


@pytest.mark.faults
def test_why_a_run_has_failed_is_said(started, tmp_path):
    begin(started, tmp_path)
    (tmp_path / "wrong").touch()
    until(lambda: not started.running(tmp_path), "the run has ended")
    assert started.said(tmp_path) == "designlab: study.toml: wrong"


def test_the_end_of_the_studio_interrupts_its_runs(started, tmp_path):
    begin(started, tmp_path)
    started.stop()
    assert not started.running(tmp_path)


def test_of_an_unknown_folder_nothing_is_said(started, tmp_path):
    assert not started.running(tmp_path)
    assert started.said(tmp_path) == ""
    started.pause(tmp_path)
