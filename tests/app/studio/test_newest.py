"""A newer task takes the place of an older one; what comes first is done first."""

import threading
import time
from types import SimpleNamespace

import pytest

from designlab.app.studio.messages import Request, ScoreJob
from designlab.app.studio.newest import NewestQueue, Superseded, Task
from designlab.app.studio.worker import _step


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
