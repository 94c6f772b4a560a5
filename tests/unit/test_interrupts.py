"""Ctrl-C where it must wait."""

import signal

import pytest

from designlab.interrupts import Interrupts, held


def test_ctrl_c_waits_until_what_holds_it_back_is_done() -> None:
    done = []

    def interrupted() -> None:
        with held():
            signal.raise_signal(signal.SIGINT)
            done.append("all of it")

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert done == ["all of it"]


def test_ctrl_c_comes_before_a_failure_it_may_have_caused() -> None:
    def failing() -> None:
        with held():
            signal.raise_signal(signal.SIGINT)
            raise ImportError

    with pytest.raises(KeyboardInterrupt):
        failing()


def test_ctrl_c_is_handed_to_whoever_holds_it_back_outside() -> None:
    with Interrupts() as outside:
        with held():
            signal.raise_signal(signal.SIGINT)
        assert outside.pending
        with pytest.raises(KeyboardInterrupt):
            outside.check()


def test_nothing_is_left_behind() -> None:
    before = signal.getsignal(signal.SIGINT)
    with held():
        assert signal.getsignal(signal.SIGINT) != before
    assert signal.getsignal(signal.SIGINT) == before
