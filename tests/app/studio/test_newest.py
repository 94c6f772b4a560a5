"""A newer task takes the place of an older one; what comes first is done first."""

import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from designlab.app.studio.messages import (
    Picture,
    PictureJob,
    Relief,
    Reply,
    Request,
    Rest,
    ScoreJob,
    StudyJob,
)
from designlab.app.studio.newest import NewestQueue, Superseded, Task
from designlab.app.studio.supervisor import Supervisor
from designlab.app.studio.worker import _step
from designlab.sensor.design import preset

LANE = ("tab", "picture")
POINTS = np.zeros((9, 9))
FIRST = Picture(b"", (4, 3), True, POINTS, POINTS, 0.0, "coarse")
FULL = FIRST._replace(step="full light")
RELIEF = Relief(b"", b"", 0.0, 1.0, {})


def asked(number, digest="one"):
    return Request(*LANE, number, digest, PictureJob(None, None))


def put(queue, request):
    queue.put(Task(LANE, request.number, request))


def task(key, number, **more):
    return Task(key, number, f"{key} {number}", **more)


@pytest.mark.parametrize("count", [2, 10, 200])
def test_of_a_key_only_the_newest_is_taken(count):
    queue = NewestQueue()
    for number in range(count):
        queue.put(task("picture", number))
    assert queue.take(0).number == count - 1
    assert queue.take(0) is None


def test_an_older_task_that_comes_late_is_not_taken():
    queue = NewestQueue()
    queue.put(task("picture", 5))
    queue.put(task("picture", 3))
    assert queue.take(0).number == 5
    queue.put(task("picture", 4))
    assert queue.take(0) is None


@pytest.mark.parametrize(
    ("put", "order"),
    [
        ([("scores", 1, 100), ("picture", 2, 0)], ["picture", "scores"]),
        ([("a", 1, 0), ("b", 2, 0), ("c", 3, 0)], ["a", "b", "c"]),
        ([("model", 1, 2), ("scores", 2, 100), ("picture", 3, 0)], ["picture", "model", "scores"]),
    ],
)
def test_the_least_priority_then_the_oldest_comes_first(put, order):
    queue = NewestQueue()
    for key, number, priority in put:
        queue.put(task(key, number, priority=priority))
    assert [queue.take(0).key for _ in put] == order


def test_a_task_that_has_done_steps_comes_behind_those_that_have_not():
    queue = NewestQueue()
    refined = task(("one", "picture"), 1, steps=2)
    queue.put(refined)
    queue.put(task(("two", "picture"), 2))
    assert queue.take(0).key == ("two", "picture")
    assert queue.take(0) is refined


def test_a_task_knows_that_something_newer_or_better_waits():
    queue = NewestQueue()
    scores = task("scores", 1, priority=100)
    queue.put(scores)
    assert queue.take(0) is scores
    assert not queue.better_waits(scores)
    queue.put(task("picture", 2))
    assert queue.better_waits(scores)
    assert not queue.superseded(scores)
    queue.put(task("scores", 3, priority=100))
    assert queue.superseded(scores)


def test_what_was_dropped_is_neither_taken_nor_goes_on():
    queue = NewestQueue()
    mine, other = task(("one", "picture"), 1), task(("two", "picture"), 2)
    queue.put(mine)
    queue.put(other)
    queue.drop(lambda key: key[0] == "one")
    assert queue.superseded(mine)
    assert queue.take(0) is other
    assert queue.take(0) is None


def test_a_task_that_rests_is_waited_for_unless_something_better_comes():
    queue = NewestQueue()
    queue.put(task("picture", 1, steps=1, ready_at=time.monotonic() + 0.2))
    queue.put(task("scores", 2, priority=100))
    queue.put(task("other picture", 3))
    assert queue.take(0).number == 3
    assert queue.take(0) is None
    assert queue.take(5).number == 1
    assert queue.take(0).number == 2
    queue.put(task("picture", 2, ready_at=time.monotonic() + 60))
    queue.put(task("picture", 3))
    assert queue.take(0).number == 3
    assert queue.take(0) is None


def test_one_who_waits_is_woken():
    queue, found = NewestQueue(), []
    waiting = threading.Thread(target=lambda: found.append(queue.take(10)))
    waiting.start()
    queue.put(task("picture", 1))
    waiting.join(10)
    assert [each.number for each in found] == [1]


@pytest.mark.parametrize(("dropped", "left"), [(False, 1), (True, 0)])
def test_what_is_given_up_begins_anew_unless_nothing_is_wanted_of_it(dropped, left):
    queue, told = NewestQueue(), []
    request = Request("tab", "scores", 1, "", ScoreJob(None), priority=100)
    queue.put(Task(("tab", "scores"), 1, request, priority=100))
    taken = queue.take(0)

    def given_up(job, waits):
        if dropped:
            queue.drop(lambda key: key == ("tab", "scores"))
        else:
            queue.put(task(("tab", "picture"), 2))
        assert waits()
        raise Superseded
        yield

    _step(taken, queue, SimpleNamespace(send=told.append), SimpleNamespace(steps=given_up))
    found = []
    while (waiting := queue.take(0)) is not None:
        found.append(waiting.key[1])
    assert found.count("scores") == left
    assert told == []


@pytest.mark.parametrize(
    ("content", "digest", "told"),
    [(FIRST, "one", True), (FIRST, "other", False), (RELIEF, "one", False), (Rest(1.0), "one", False)],
)
def test_a_picture_that_is_overtaken_is_told_where_the_design_is_the_same(content, digest, told):
    queue, found = NewestQueue(), []
    put(queue, asked(1))

    def made(job, waits):
        put(queue, asked(2, digest))
        put(queue, asked(3, digest))
        yield content

    _step(queue.take(0), queue, SimpleNamespace(send=found.append), SimpleNamespace(steps=made))
    assert [reply.number for reply in found] == ([1] if told else [])
    assert queue.take(0).number == 3
    assert queue.take(0) is None


def test_a_picture_of_a_tab_that_was_closed_meanwhile_is_not_told():
    queue, found = NewestQueue(), []
    put(queue, asked(1))

    def made(job, waits):
        put(queue, asked(2))
        queue.drop(lambda key: True)
        yield FIRST

    _step(queue.take(0), queue, SimpleNamespace(send=found.append), SimpleNamespace(steps=made))
    assert found == []


@pytest.mark.parametrize("count", [5, 40])
def test_pictures_follow_a_probe_that_is_dragged_faster_than_they_are_made(count):
    queue, found = NewestQueue(), []
    moved, moves = [], iter(range(1, count + 1))

    def move():
        if (number := next(moves, None)) is not None:
            put(queue, asked(number))
            moved.append(number)

    def made(job, waits):
        for _ in range(3):  # moves while a picture is made
            move()
        yield FIRST
        yield Rest(0.0)
        yield FULL

    move()
    while (task := queue.take(0)) is not None:
        _step(
            task,
            queue,
            SimpleNamespace(send=lambda reply: found.append((reply, len(moved)))),
            SimpleNamespace(steps=made),
        )
    pictures = [(reply.number, reply.content.step) for reply, _ in found if reply.content]
    assert pictures[-2:] == [(count, FIRST.step), (count, FULL.step)]
    numbers = [number for number, _ in pictures]
    assert numbers == sorted(numbers)
    # Each was begun with the newest move of then, 3 moves before it was told.
    during = [(reply.number, newest) for reply, newest in found if newest < count]
    assert len(during) == (count - 2) // 3
    assert all(number == newest - 3 for number, newest in during)


@pytest.mark.parametrize(
    ("content", "digest", "number", "handed_on"),
    [
        (FIRST, "one", 3, True),
        (FIRST, "one", 2, True),
        (FIRST, "older", 2, False),
        (RELIEF, "one", 2, False),
        (None, "one", 2, False),
    ],
)
def test_of_older_requests_the_page_gets_pictures_of_the_same_design_alone(
    content, digest, number, handed_on
):
    supervisor = Supervisor(lambda reply: None, lambda: None)
    supervisor._pipe = SimpleNamespace(send=lambda message: None)
    for each in (digest, digest, "one"):
        supervisor.ask(*LANE, None, digest=each)
    last = content is None
    assert supervisor._is_open(Reply(*LANE, number, digest, content, last=last)) is handed_on
    assert supervisor._is_open(Reply(*LANE, 3, "one", last=True))  # it still waits for its own
    assert not supervisor._is_open(Reply(*LANE, 2, "one", FIRST))


def test_a_request_is_of_the_design_of_its_job():
    """So a picture of what was pinned before is not taken for that of what is pinned now."""
    pytest.importorskip("nicegui", reason="NiceGUI is not installed")
    from designlab.app.studio.page import Page

    told = []
    worker = SimpleNamespace(ask=lambda client, lane, job, **more: told.append(more["digest"]))
    page = Page(SimpleNamespace(id="tab"), Path(), worker, None)
    own, other = page.session.design, preset("gelsight-2020-flat")
    for job in (PictureJob(own, None), PictureJob(other, None), StudyJob(Path())):
        page.ask("lane", job, told.append)
    assert told == [own.digest, other.digest, own.digest]
