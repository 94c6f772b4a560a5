"""Calls in this process, in several, and on a Dask cluster give the same."""

import math
import os
import signal
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from designlab.core.interrupts import Interrupts
from designlab.core.workers import completed, finished, submitter
from tests.helpers.studies import Death, mortal


def results(workers: int, calls: list[tuple], *, dask: str | None = None) -> dict[int, object]:
    with Interrupts() as interrupts, submitter(workers, interrupts, dask=dask) as submit:
        return dict(completed(submit, calls, at_once=workers, interrupts=interrupts))


CALLS = [(math.factorial, n) for n in range(7)]
EXPECTED = {n: math.factorial(n) for n in range(7)}


@pytest.mark.parametrize("workers", [1, 2])
def test_every_call_is_run_once(workers) -> None:
    assert results(workers, CALLS) == EXPECTED


def test_processes_are_others_and_run_at_once() -> None:
    # Each call takes long enough for the other process to get the next one.
    calls = [(time.sleep, 0.3), (os.getpid,), (time.sleep, 0.3), (os.getpid,)]
    found = results(2, calls)
    assert os.getpid() not in {found[1], found[3]}


@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_call_raises_is_raised(workers) -> None:
    with pytest.raises(ValueError, match="factorial"):
        results(workers, [*CALLS, (math.factorial, -1)])


@pytest.mark.slow
def test_the_death_of_any_worker_is_noticed_while_the_others_go_on() -> None:
    begun = time.monotonic()
    with pytest.raises(BrokenProcessPool):
        results(2, [(time.sleep, 60), (_die_after, 1.0)])
    assert time.monotonic() - begun < 30


def _die_after(seconds: float) -> None:
    time.sleep(seconds)
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.slow
def test_a_death_costs_no_result_and_a_call_that_kills_again_is_the_end(monkeypatch) -> None:
    """In place of processes, threads whose calls may break all that run beside them."""
    started: list[int] = []

    def call(number: int, deaths: int) -> int:
        started.append(number)
        time.sleep(0.02 if deaths else 0.06)
        if started.count(number) <= deaths:
            raise Death
        return number

    def given(deaths: dict[int, int]) -> dict[int, int]:
        started.clear()
        calls = [(call, number, deaths.get(number, 0)) for number in range(5)]
        with Interrupts() as interrupts:
            return dict(finished(calls, workers=2, interrupts=interrupts))

    monkeypatch.setattr("designlab.core.workers.submitter", mortal)
    assert given({1: 1}) == {number: number for number in range(5)}
    assert started.count(1) == 2
    with pytest.raises(RuntimeError, match=r"again and again, .* 2 workers; what is finished is kept"):
        given({3: 2})
    assert started.count(3) == 2


def test_results_before_a_failure_are_given() -> None:
    with Interrupts() as interrupts, submitter(1, interrupts) as submit:
        found = completed(
            submit, [(math.factorial, 3), (math.factorial, -1)], at_once=1, interrupts=interrupts
        )
        assert next(found) == (0, 6)
        with pytest.raises(ValueError, match="factorial"):
            next(found)


@pytest.mark.slow
def test_a_dask_cluster_runs_calls() -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is an extra")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        assert results(7, CALLS, dask=cluster.scheduler_address) == EXPECTED
        with pytest.raises(ValueError, match="factorial"):
            results(7, [*CALLS, (math.factorial, -1)], dask=cluster.scheduler_address)


@pytest.mark.slow
@pytest.mark.parametrize("allowed", [3, 0])
def test_dask_gives_the_call_of_a_dead_worker_to_another_but_not_for_ever(tmp_path, allowed) -> None:
    distributed = pytest.importorskip("distributed", reason="Dask is an extra")
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": allowed}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        calls = [(_die_once, tmp_path / "died"), *CALLS[1:]]
        if allowed:
            assert results(2, calls, dask=cluster.scheduler_address) == {**EXPECTED, 0: "alive"}
        else:
            with pytest.raises(BrokenProcessPool, match="_die_once"):
                results(2, calls, dask=cluster.scheduler_address)


def _die_once(mark: Path) -> str:
    if mark.exists():
        return "alive"
    mark.touch()
    os.kill(os.getpid(), signal.SIGKILL)
    return "dead"


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_an_error_and_not_a_wait() -> None:
    pytest.importorskip("distributed", reason="Dask is an extra")
    with pytest.raises(OSError, match=r"127\.0\.0\.1:9"):
        results(1, CALLS, dask="tcp://127.0.0.1:9")
