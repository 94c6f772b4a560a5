"""Where calls are run: in this process, in several of this machine, or on a Dask cluster."""

import contextlib
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any

from designlab.core.interrupts import Interrupts

MOST_CALLS = 1000
"""Calls in flight on a cluster."""

Submit = Callable[..., "Future[Any]"]
"""Starts a call, ``submit(function, *arguments)``, and returns its future."""


def calls_at_once(workers: int, dask: str | None) -> int:
    """How many calls to start before the first has ended: a cluster sees for itself who takes them."""
    return workers if dask is None else MOST_CALLS


def submitter(
    workers: int, interrupts: Interrupts, *, dask: str | None = None
) -> contextlib.AbstractContextManager[Submit]:
    """Give the function that starts calls.

    Parameters
    ----------
    workers : int
        Processes of this machine; with one, calls are run here and now.
    interrupts : Interrupts
        Let through while a call runs here.
    dask : str, optional
        Address of a Dask scheduler, ``tcp://host:8786``, whose workers run the calls instead. They need
        designlab and the same paths.

    Raises
    ------
    ValueError
        If Dask is not installed, or the address is none.
    OSError
        If no scheduler answers.
    """
    if dask is not None:
        return _cluster(dask)
    return contextlib.nullcontext(_here(interrupts)) if workers == 1 else _processes(workers)


def completed(
    submit: Submit,
    calls: Sequence[tuple[Any, ...]],
    *,
    at_once: int,
    interrupts: Interrupts,
) -> Iterator[tuple[int, Any]]:
    """Run calls, ``(function, *arguments)`` each, and give number and result of each as it ends.

    What a call raises is raised here.
    """
    waiting = list(enumerate(calls))[::-1]
    running: dict[Future[Any], int] = {}
    while waiting or running:
        while waiting and len(running) < at_once:
            interrupts.check()
            number, call = waiting.pop()
            running[submit(*call)] = number
        with interrupts.allowed():
            finished = wait(running, return_when=FIRST_COMPLETED).done
        for future in finished:
            yield running.pop(future), future.result()


def finished(
    calls: Sequence[tuple[Any, ...]],
    *,
    workers: int,
    interrupts: Interrupts,
    dask: str | None = None,
    goes_on: str = "what is finished is kept: the same command goes on",
) -> Generator[tuple[int, Any]]:
    """Run calls as `completed` does, on workers started for them; a death of one is no end.

    What was in flight then is run again one at a time, which tells the guilty call.

    Parameters
    ----------
    calls, workers, interrupts, dask
        As of `completed` and `submitter`.
    goes_on : str
        What to say of what is finished, where this ends early.

    Raises
    ------
    RuntimeError
        If a worker dies over the same call again. Dask has tried it several times by then.
    """
    left, suspects = list(range(len(calls))), 0
    while left:
        batch = left[:suspects] or left[:]
        at_once = 1 if suspects else calls_at_once(workers, dask)
        try:
            with submitter(workers, interrupts, dask=dask) as submit:
                some = [calls[number] for number in batch]
                for place, found in completed(submit, some, at_once=at_once, interrupts=interrupts):
                    left.remove(batch[place])
                    yield batch[place], found
        except BrokenProcessPool as error:
            if suspects or dask is not None:
                raise RuntimeError(f"{death(workers)}; {goes_on}") from error
            suspects = min(at_once, len(left))  # calls are started in order
        else:
            suspects = 0


def death(workers: int) -> str:
    """What to say where workers die over and over."""
    return f"a worker process died again and again, perhaps for lack of memory with {workers} workers"


def _here(interrupts: Interrupts) -> Submit:
    def submit(function: Callable[..., Any], /, *arguments: Any) -> "Future[Any]":
        future: Future[Any] = Future()
        try:
            with interrupts.allowed():
                future.set_result(function(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future

    return submit


@contextlib.contextmanager
def _processes(workers: int) -> Iterator[Submit]:
    import multiprocessing

    context = multiprocessing.get_context("spawn")  # a forked copy of a renderer with threads would hang
    receiver, sender = context.Pipe(duplex=False)
    given = receiver, context.Value("i", 0), workers
    with ProcessPoolExecutor(workers, context, initializer=_start_worker, initargs=given) as pool:

        def submit(function: Callable[..., Any], /, *arguments: Any) -> "Future[Any]":
            # The pool notices the death of those workers only that ran when it was last woken, which is
            # before the worker of this call starts: a second call wakes it once more.
            future = pool.submit(function, *arguments)
            pool.submit(os.getpid)
            return future

        try:
            yield submit
        except BaseException:
            sender.close()
            pool.shutdown(wait=False, cancel_futures=True)
            raise


@contextlib.contextmanager
def _cluster(address: str) -> Iterator[Submit]:
    try:
        from distributed import Client
    except ImportError:
        raise ValueError("--dask: needs Dask: pip install 'designlab[dask]'") from None
    try:
        client = Client(address, timeout="10s", set_as_default=False)
    except ValueError as error:
        raise ValueError(
            f"--dask: must be an address such as tcp://host:8786, got {address!r}: {error}"
        ) from None
    with client:
        executor = client.get_executor(pure=False)

        def submit(function: Callable[..., Any], /, *arguments: Any) -> "Future[Any]":
            future: Future[Any] = Future()
            executor.submit(function, *arguments).add_done_callback(lambda theirs: _settle(future, theirs))
            return future

        try:
            yield submit
        except BaseException:
            executor.shutdown(wait=False)  # which cancels what is left
            raise


def _settle(future: "Future[Any]", theirs: "Future[Any]") -> None:
    """End a future as Dask's has ended; a call that kills its workers breaks the pool, as it does here."""
    from distributed import KilledWorker

    if theirs.cancelled():
        future.cancel()
    elif isinstance(error := theirs.exception(), KilledWorker):
        future.set_exception(BrokenProcessPool(f"Dask: {error}".partition(". ")[0]))
    elif error is not None:
        future.set_exception(error)
    else:
        future.set_result(theirs.result())


def keep_to_share(number: int, workers: int) -> None:
    """Have this process, one of several, run on its own share of the cores alone, where the system can."""
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, cores[number::workers] or [cores[number % len(cores)]])


def _start_worker(receiver: "Connection[Any, Any]", started: Any, workers: int) -> None:
    """Prepare a worker: Ctrl-C is for the parent alone, and the worker leaves with its parent, at once.

    Each has its own share of the cores: threads of several renderers on one core get in each other's way.
    """
    import signal
    import threading

    with started.get_lock():
        number = started.value
        started.value += 1
    keep_to_share(number, workers)

    def leave_with_parent() -> None:
        with contextlib.suppress(EOFError, OSError):
            receiver.recv()
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=leave_with_parent, daemon=True).start()
