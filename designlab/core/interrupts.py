"""Ctrl-C at safe moments only."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType, TracebackType
from typing import Any, Self


class Interrupts:
    """Holds Ctrl-C back, except where it is allowed: an interrupted write would leave the record locked.

    Used as a context manager; outside the main thread, which alone receives Ctrl-C, it does nothing.
    """

    def __init__(self) -> None:
        self._allowed = False
        self._pending = False
        self._before: Any = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._pending = True
        if self._allowed:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def allowed(self) -> Iterator[None]:
        """Let Ctrl-C through, one that was held back as well."""
        self._allowed = True
        try:
            self.check()
            yield
        finally:
            self._allowed = False

    @property
    def pending(self) -> bool:
        """Whether Ctrl-C was pressed since the beginning."""
        return self._pending

    def check(self) -> None:
        """Raise KeyboardInterrupt if Ctrl-C was pressed since the beginning."""
        if self._pending:
            raise KeyboardInterrupt


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Hold Ctrl-C back while code runs that it would leave half done, then hand it on.

    A native library that is interrupted while it loads fails in ways of its own, or ends the process later.
    """
    try:
        with Interrupts() as interrupts:
            yield
    finally:
        if interrupts.pending:
            signal.raise_signal(signal.SIGINT)
