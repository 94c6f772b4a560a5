"""Runs one command: where its output goes, what its exit status is, how its failures read."""

import contextlib
import json
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import Any, NamedTuple

from designlab.app.cli.arguments import parse
from designlab.app.cli.arguments.options import UsageError
from designlab.app.failures import OWN_PACKAGES, judged
from designlab.core.plain import plain

DEBUG_VARIABLE = "DESIGNLAB_DEBUG"
"""Environment variable that shows the traceback of every failure, as ``--debug`` does."""

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


class Result(NamedTuple):
    """What a command has to say: plain data for ``--json``, text for people, and the exit status."""

    data: dict[str, Any]
    text: str
    status: int = DONE


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; those of the process when absent.

    Returns
    -------
    int
        0 done, 1 failure, 2 bad input, 130 interrupted.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    as_json = "--json" in arguments
    try:
        status = _run(arguments, as_json)
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # the reader, `head` for example, has seen enough
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115  for the interpreter's last flush
        return FAILED
    except OSError as error:
        return _complain(f"cannot write the result to the standard output: {error.strerror or error}")


def _run(arguments: list[str], as_json: bool) -> int:
    debug = "--debug" in arguments or bool(os.environ.get(DEBUG_VARIABLE))
    resume = "nothing half-written is left; run the same command again"
    try:
        args = parse(arguments)
        resume = getattr(args, "resume", resume)
        module, _, function = args.run.partition(":")
        with _stdout_kept_clean(), _notes_in_one_line():
            result: Result = getattr(import_module(module), function)(args)
    except SystemExit as ended:  # --help and --version have printed what was asked for
        return int(ended.code or DONE)
    except KeyboardInterrupt as interrupt:
        status, reason = INTERRUPTED, str(interrupt) or f"interrupted; {resume}"
    except Exception as error:
        if debug:
            traceback.print_exc()
        if _is_interrupt(error):
            status, reason = INTERRUPTED, f"interrupted; {resume}"
        else:
            status, reason = _judge(error)
    else:
        print(_encoded(result.data) if as_json else result.text, flush=True)
        return result.status
    if as_json:
        print(_encoded({"error": reason, "exit_status": status}), flush=True)
    return _complain(reason, status)


@contextlib.contextmanager
def _notes_in_one_line() -> Iterator[None]:
    """Show warnings of our own without the place in the code."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if category.__module__.partition(".")[0] in OWN_PACKAGES:
            print(f"designlab: note: {message}", file=sys.stderr)
        else:
            usual(message, category, *place, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual


def _is_interrupt(error: Exception) -> bool:
    """Whether Ctrl-C is behind a failure: a native library that it meets while loading fails its own way."""
    before: BaseException | None = error if isinstance(error, ImportError | SystemError) else None
    while before is not None and not isinstance(before, KeyboardInterrupt):
        before = before.__cause__ or before.__context__
    return before is not None


def _judge(error: Exception) -> tuple[int, str]:
    """Exit status and one line for a failure."""
    if isinstance(error, UsageError):
        return BAD_INPUT, str(error)
    found = judged(error)
    if found.cause == "defect":
        return FAILED, f"{found.text}. Please report it with what `--debug` prints"
    return BAD_INPUT if found.cause == "input" else FAILED, found.text


def _complain(reason: str, status: int = FAILED) -> int:
    with contextlib.suppress(OSError):
        print(f"designlab: {reason}", file=sys.stderr, flush=True)
    return status


def _encoded(data: dict[str, Any]) -> str:
    """JSON text; numbers without a finite value become null."""
    return json.dumps(plain(data), allow_nan=False)


@contextlib.contextmanager
def _stdout_kept_clean() -> Iterator[None]:
    """Send whatever libraries print, from Python or from C, to stderr: stdout is for the result alone."""
    with contextlib.redirect_stdout(sys.stderr), contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):  # closed, or not files at all: there is nothing to keep clean
            kept = os.dup(1)
            stack.callback(_restore, kept)
            if sys.__stdout__ is not None:
                sys.__stdout__.flush()
            os.dup2(2, 1)
        yield


def _restore(kept: int) -> None:
    import ctypes

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)  # what C code has buffered still belongs to stderr
    os.dup2(kept, 1)
    os.close(kept)
