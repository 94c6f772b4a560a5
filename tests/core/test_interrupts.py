"""Ctrl-C where it must wait."""

import signal

import pytest

from designlab.core.interrupts import Interrupts, held


@pytest.fixture(autouse=True)
def _heard():
    """A run in the background may have inherited the order to ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


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


def test_who_ignores_ctrl_c_goes_on_ignoring_it() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with held():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN
