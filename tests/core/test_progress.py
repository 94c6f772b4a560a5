"""How long work tells what it is doing."""

import numpy as np
import pytest

from designlab.core.progress import THOUSANDTHS, Work, bar, named, part_of


def test_parts_tell_in_thousandths_of_the_whole():
    told = []
    part = part_of(lambda *step: told.append(step), "fitting", begun=10, cost=30, total=40)
    part("", 0, 1)
    part("two", 2, 3)
    part("none", 0, 0)
    part("too many", 7, 3)
    assert told == [
        ("fitting", 250, THOUSANDTHS),
        ("fitting: two", 750, THOUSANDTHS),
        ("fitting: none", 250, THOUSANDTHS),
        ("fitting: too many", THOUSANDTHS, THOUSANDTHS),
    ]


def test_a_part_without_a_title_says_what_it_is():
    told = []
    part_of(lambda *step: told.append(step), "", begun=0, cost=1, total=2)("pictures", 1, 2)
    assert told == [("pictures", 250, THOUSANDTHS)]


@pytest.fixture
def told():
    return []


@pytest.fixture
def work(told):
    return Work(lambda *step: told.append(step), {"pictures": 6, "fits": 3, "report": 1})


def test_work_tells_of_its_parts_by_what_they_cost(work, told):
    work.begin("pictures")
    for _ in range(5):
        work.step()
    work.begin("fits")
    work.tell("fit of tilt")
    work.step()
    work.begin("report")
    work.end()
    assert told == [
        ("pictures", 0, THOUSANDTHS),
        *(("pictures", 100 * done, THOUSANDTHS) for done in range(1, 6)),
        ("fits", 555, THOUSANDTHS),  # 5 of 5 + 3 + 1: a picture less than was expected
        ("fit of tilt", 555, THOUSANDTHS),
        ("fit of tilt", 666, THOUSANDTHS),
        ("report", 857, THOUSANDTHS),
        ("done", THOUSANDTHS, THOUSANDTHS),
    ]


def test_what_is_there_already_is_taken_off_what_was_expected(work, told):
    """Else the time left would follow from pictures that took none."""
    work.begin("pictures")
    for _ in range(5):
        work.skip()
    work.begin("fits")
    assert {done for _, done, _ in told} == {0}
    work.step()
    assert told[-1] == ("fits", 250, THOUSANDTHS)


@pytest.mark.parametrize("seed", range(20))
def test_the_share_never_falls_and_is_whole_at_the_end_alone(work, told, seed):
    random = np.random.default_rng(seed)
    for part in ("pictures", "fits", "report"):
        work.begin(part)
        for cost in random.uniform(0, 3, random.integers(0, 40)):
            random.choice([work.step, work.skip])(cost)
    assert all(done < THOUSANDTHS for _, done, _ in told)
    work.end()
    shares = [done / total for _, done, total in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_part_of_more_steps_than_expected_still_moves(work, told):
    work.begin("pictures")
    for _ in range(60):
        work.step()
    shares = [done for _, done, _ in told]
    assert len(set(shares)) > 40
    assert shares[6] < 650  # as expected so far
    work.begin("fits")
    assert told[-1][1] == pytest.approx(60 / 64 * THOUSANDTHS, abs=1)


def test_a_last_part_that_costs_nothing_does_not_end_the_work(told):
    work = Work(lambda *step: told.append(step), {"pictures": 1, "held out": 0})
    work.begin("pictures")
    work.step()
    work.begin("held out")
    assert told[-1] == ("held out", THOUSANDTHS - 1, THOUSANDTHS)


def test_work_that_nobody_asks_about_is_silent():
    work = Work()
    work.step()
    work.end()


def test_a_part_is_told_of_under_its_name():
    told = []
    named(lambda *step: told.append(step), "dome: ")("press", 1, 2)
    assert told == [("dome: press", 1, 2)]


@pytest.mark.parametrize("shown", [True, False])
def test_a_bar_says_what_is_done_and_in_all(shown, capsys):
    with bar("copy", begun=3, keep=True, shown=shown) as tell:
        tell("copies", 3, 8)
        tell("copies", 8, 8)
    said = capsys.readouterr().err
    assert ("copies: 100%" in said) == ("8/8" in said) == shown
