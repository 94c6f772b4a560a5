"""How long work tells what it is doing."""

import pytest

from designlab.core.progress import THOUSANDTHS, bar, named, part_of


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
