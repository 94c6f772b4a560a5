"""A queue of tasks in which a newer task takes the place of an older one of the same kind."""

import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any


class Superseded(Exception):
    """Something newer is asked for: what is under way is given up."""


@dataclass
class Task:
    """Something to be done, in steps.

    Attributes
    ----------
    key : hashable
        Who wants it and what it is: of a key, only the newest task counts.
    number : int
        Ascending with time.
    work : Any
        What is to be done.
    priority : int
        Lower ones come first; a task that has done a step comes back behind those that have not.
    ready_at : float
        Time (of `time.monotonic`) before which it is not taken: something newer may come.
    """

    key: Hashable
    number: int
    work: Any
    priority: int = 0
    steps: int = 0
    ready_at: float = 0.0
    state: Any = field(default=None, repr=False)

    @property
    def order(self) -> tuple[int, int]:
        """What tasks are taken by: least first."""
        return self.priority + self.steps, self.number


class NewestQueue:
    """Tasks by key; `take` waits for one. All methods may be called from any thread."""

    def __init__(self) -> None:
        self._waiting: dict[Hashable, Task] = {}
        self._newest: dict[Hashable, int] = {}
        self._changed = threading.Condition()

    def put(self, task: Task) -> None:
        """Add a task; an older one of its key is dropped, and one that is older itself is not taken."""
        with self._changed:
            if task.number < self._newest.get(task.key, task.number):
                return
            self._newest[task.key] = task.number
            self._waiting[task.key] = task
            self._changed.notify()

    def take(self, timeout_s: float | None = None) -> Task | None:
        """Remove and return the task that comes first, or None where none has come in time.

        One that rests is waited for: its rest is short, and what is begun meanwhile would be given up for it.
        """
        end = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            while True:
                now = time.monotonic()
                first = min(self._waiting.values(), key=lambda task: task.order, default=None)
                if first is not None and first.ready_at <= now:
                    return self._waiting.pop(first.key)
                times = [] if first is None else [first.ready_at]
                times += [] if end is None else [end]
                if end is not None and now >= end:
                    return None
                self._changed.wait(min(times) - now if times else None)

    def superseded(self, task: Task) -> bool:
        """Whether a newer task of its key has come, or its key was dropped."""
        with self._changed:
            return self._newest.get(task.key) != task.number

    def newer(self, task: Task) -> Task | None:
        """The task that is to be done in place of this one, None where there is none."""
        with self._changed:
            waiting = self._waiting.get(task.key)
            return waiting if waiting is not None and waiting.number > task.number else None

    def better_waits(self, task: Task) -> bool:
        """Whether a task waits that comes before this one, or takes its place."""
        with self._changed:
            newer = self._newest.get(task.key) != task.number
            now = time.monotonic()
            waiting = [other for other in self._waiting.values() if other.ready_at <= now]
            return newer or any(other.order < task.order for other in waiting)

    def drop(self, belongs: Callable[[Hashable], bool]) -> None:
        """Forget the tasks of some keys, those under way included."""
        with self._changed:
            for key in [key for key in self._newest if belongs(key)]:
                del self._newest[key]
                self._waiting.pop(key, None)
