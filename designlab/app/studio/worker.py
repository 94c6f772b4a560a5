"""The worker process: one render session that answers the jobs of all tabs, the newest first."""

import contextlib
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from designlab.app.failures import judged
from designlab.app.studio.messages import (
    ExportJob,
    GapJob,
    ModelJob,
    PictureJob,
    Reply,
    Request,
    Rest,
    ScoreJob,
    StudyJob,
    UploadJob,
    still_shown,
)
from designlab.app.studio.newest import NewestQueue, Superseded, Task

FORGET = "forget"
"""Message with a tab and a lane that nothing is wanted of any more; without a lane the tab was closed."""
END = "end"
"""Message that the studio ends."""

Waits = Callable[[], bool]
Steps = Iterator[Any]


def main(pipe: "Connection[Any, Any]") -> None:
    """Answer jobs until the page's process has ended.

    Parameters
    ----------
    pipe : Connection
        Requests come from it, replies go into it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page's process, which ends this one
    queue = NewestQueue()
    threading.Thread(target=_listen, args=(pipe, queue), daemon=True).start()
    handlers = Handlers()
    while True:
        task = queue.take()
        if task is not None:
            _step(task, queue, pipe, handlers)


def _listen(pipe: "Connection[Any, Any]", queue: NewestQueue) -> None:
    """Put what comes into the queue; leave when nobody is there any more."""
    while True:
        try:
            message = pipe.recv()
        except (EOFError, OSError):
            os._exit(0)
        if isinstance(message, Request):
            key = message.client, message.lane
            queue.put(Task(key, message.number, message, priority=message.priority))
        elif message[0] == FORGET:
            queue.drop(partial(_belongs, client=message[1], lane=message[2]))
        elif message[0] == END:
            os._exit(0)


def _belongs(key: Any, *, client: str, lane: str | None) -> bool:
    return bool(key[0] == client and lane in (None, key[1]))


def _step(task: Task, queue: NewestQueue, pipe: "Connection[Any, Any]", handlers: "Handlers") -> None:
    """Do one step of a task and tell; the task goes back into the queue unless it is done."""
    request: Request = task.work
    try:
        if task.state is None:
            task.state = handlers.steps(request.job, lambda: queue.better_waits(task))
        content = next(task.state)
    except StopIteration:
        _tell(pipe, _reply(request, last=True))
        return
    except Superseded:
        task.state = None  # begins anew when nothing better waits
        if not queue.superseded(task):
            queue.put(task)
        return
    except Exception as error:
        found = judged(error)
        if found.cause == "defect":
            traceback.print_exception(error)  # the page tells its name alone
        _tell(pipe, _reply(request, error=found.text, last=True))
        return
    reply = _reply(request, content=content)
    if queue.superseded(task):
        newer = queue.newer(task)
        if newer is not None and still_shown(reply, newer.work):
            _tell(pipe, reply)
        return
    if isinstance(content, Rest):
        task.ready_at = time.monotonic() + content.seconds
    else:
        _tell(pipe, reply)
        task.steps += 1
    queue.put(task)


def _reply(request: Request, **told: Any) -> Reply:
    return Reply(request.client, request.lane, request.number, request.digest, **told)


def _tell(pipe: "Connection[Any, Any]", reply: Reply) -> None:
    with contextlib.suppress(BrokenPipeError, OSError):
        pipe.send(reply)


class Handlers:
    """What answers each kind of job; heavy packages are imported with the first job that needs them."""

    def __init__(self) -> None:
        self._bench: Any = None
        self._gaps: Any = None

    def steps(self, job: Any, waits: Waits) -> Steps:
        """Steps of the answer to a job."""
        match job:
            case PictureJob():
                return self._pictures(job, waits)
            case ScoreJob():
                return self._scores(job, waits)
            case ModelJob():
                return self._model(job)
            case ExportJob():
                return self._export(job)
            case StudyJob():
                return self._study(job)
            case GapJob():
                return self._gap(job)
            case UploadJob():
                return self._upload(job)
        raise TypeError(f"no handler of {type(job).__name__}")

    @property
    def bench(self) -> Any:
        """What pictures are made on."""
        if self._bench is None:
            from designlab.app.studio.pictures import Bench

            self._bench = Bench()
        return self._bench

    def _pictures(self, job: PictureJob, waits: Waits) -> Steps:
        from designlab.app.studio.pictures import steps

        yield from steps(self.bench, job, waits)

    def _scores(self, job: ScoreJob, waits: Waits) -> Steps:
        from designlab.app.studio.scoring import scored

        yield scored(job.design, waits)

    def _model(self, job: ModelJob) -> Steps:
        from designlab.report.view3d.model import glb

        yield glb(job.design, section=job.section)

    def _export(self, job: ExportJob) -> Steps:
        from designlab.fabrication import export

        manifest = export(job.design, job.out)
        yield {"files": len(manifest["files"]), "warnings": list(manifest["warnings"])}

    def _study(self, job: StudyJob) -> Steps:
        from designlab.app.studio.studies import state

        yield state(job)

    def _gap(self, job: GapJob) -> Steps:
        from designlab.app.studio.gaps import Gaps

        self._gaps = self._gaps or Gaps()
        yield from self._gaps.steps(job)

    def _upload(self, job: UploadJob) -> Steps:
        from designlab.app.studio.uploads import relief

        yield relief(self.bench, job)
