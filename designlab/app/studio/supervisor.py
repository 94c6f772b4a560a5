"""Keeps the worker process: starts it, starts it again when it dies, hands requests and replies on."""

import contextlib
import multiprocessing
import threading
from collections.abc import Callable
from typing import Any

from designlab.app.studio import worker
from designlab.app.studio.messages import Reply, Request, still_shown

MOST_DEATHS = 3
"""Deaths over one request after which it is given up."""
END_S = 2.0  # that the worker may take to end

OnReply = Callable[[Reply], None]


class Supervisor:
    """The page's side of the worker.

    Parameters
    ----------
    on_reply : callable
        Called with each reply, in a thread of its own.
    on_restart : callable
        Called when the worker has died and is started again.
    """

    def __init__(self, on_reply: OnReply, on_restart: Callable[[], None]) -> None:
        self._on_reply, self._on_restart = on_reply, on_restart
        self._context = multiprocessing.get_context("spawn")  # a forked renderer with threads would hang
        self._lock = threading.Lock()
        self._open: dict[tuple[str, str], Request] = {}
        self._deaths: dict[int, int] = {}
        self._number = 0
        self._ended = False
        self.restarts = 0

    def start(self) -> None:
        """Start the worker and listen to it."""
        self._spawn()
        self._listener = threading.Thread(target=self._listen, daemon=True, name="studio-replies")
        self._listener.start()

    @property
    def pid(self) -> int | None:
        """Process id of the worker."""
        return self._process.pid

    def ask(self, client: str, lane: str, job: Any, *, digest: str, priority: int = 0) -> int:
        """Ask for something; an older request of the lane is forgotten. Returns the request's number."""
        with self._lock:
            self._number += 1
            request = Request(client, lane, self._number, digest, job, priority)
            self._open[client, lane] = request
            self._send(request)
            return self._number

    def forget(self, client: str, lane: str | None = None) -> None:
        """Forget what a tab has asked for: in a lane, or all of it."""
        with self._lock:
            for key in [key for key in self._open if key[0] == client and lane in (None, key[1])]:
                del self._open[key]
            self._send((worker.FORGET, client, lane))

    def stop(self) -> None:
        """End the worker."""
        with self._lock:
            self._ended = True
            self._send((worker.END,))
        self._process.join(timeout=END_S)
        if self._process.is_alive():
            self._process.kill()
        # The listener reads to the end of the pipe, which may not be closed below it.
        self._listener.join(timeout=END_S)

    def _spawn(self) -> None:
        self._pipe, theirs = self._context.Pipe()
        self._process = self._context.Process(
            target=worker.main, args=(theirs,), daemon=True, name="studio-worker"
        )
        self._process.start()
        theirs.close()

    def _send(self, message: Any) -> None:
        # A worker that has just died gets what is open again when it was started anew.
        with contextlib.suppress(OSError):
            self._pipe.send(message)

    def _listen(self) -> None:
        while not self._ended:
            try:
                reply: Reply = self._pipe.recv()
            except (EOFError, OSError):
                if self._ended:
                    return
                self._restart()
                continue
            if self._is_open(reply):
                self._on_reply(reply)

    def _is_open(self, reply: Reply) -> bool:
        """Whether somebody still waits for a reply: few of an older request are of use."""
        with self._lock:
            request = self._open.get((reply.client, reply.lane))
            if request is None:
                return False
            if request.number != reply.number:
                return still_shown(reply, request)
            if reply.last:
                del self._open[reply.client, reply.lane]
            return True

    def _restart(self) -> None:
        self._process.join(timeout=1)
        with self._lock:
            if self._ended:
                return
            self._pipe.close()
            self._spawn()
            self.restarts += 1
            given_up = []
            waiting = {request.number for request in self._open.values()}
            self._deaths = {number: self._deaths.get(number, 0) + 1 for number in waiting}
            for key, request in list(self._open.items()):
                if self._deaths[request.number] >= MOST_DEATHS:
                    given_up.append(self._open.pop(key))
                else:
                    self._send(request)
        self._on_restart()
        for request in given_up:
            self._on_reply(
                Reply(
                    request.client,
                    request.lane,
                    request.number,
                    request.digest,
                    error="the worker process died over this again and again; change the design",
                    last=True,
                )
            )
