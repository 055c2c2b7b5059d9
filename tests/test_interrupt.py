"""Signals end a training in order: at once where that is safe, later where it is not."""

from __future__ import annotations

import contextlib
import signal
import threading

import pytest

from fbrl.training.faults import Interrupt, Interrupted


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGUSR1])
def test_a_signal_leaves_an_allowed_block_at_once(number):
    reached = []
    with Interrupt() as interrupt:
        with contextlib.suppress(Interrupted), interrupt.allowed():
            signal.raise_signal(number)
            reached.append("after the signal")
        assert interrupt.requested
    assert reached == []


def test_elsewhere_the_work_is_finished_and_the_next_allowed_block_not_begun():
    reached = []
    with Interrupt() as interrupt:
        signal.raise_signal(signal.SIGTERM)
        reached.append("work finished")
        with pytest.raises(Interrupted), interrupt.allowed():
            reached.append("block begun")
    assert reached == ["work finished"]


def test_a_second_signal_ends_at_once():
    with Interrupt():
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_further_sigterms_change_nothing_because_schedulers_repeat_them():
    reached = []
    with Interrupt() as interrupt:
        for _ in range(3):
            signal.raise_signal(signal.SIGTERM)
        reached.append("work finished")
        assert interrupt.requested
    assert reached == ["work finished"]


def test_no_signal_breaks_off_a_save():
    reached = []
    with Interrupt() as interrupt, interrupt.saving():
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
        reached.append("saved")
    assert reached == ["saved"]


def test_a_signal_that_has_to_wait_is_answered_once():
    answered = []
    with Interrupt(lambda: answered.append(True)) as interrupt:
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        assert interrupt.requested
    assert answered == [True]


def test_a_signal_that_was_ignored_stays_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupt() as interrupt:
            signal.raise_signal(signal.SIGHUP)
            assert not interrupt.requested
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_handler_of_errors_does_not_swallow_it():
    swallowing = contextlib.suppress(Exception)
    with Interrupt() as interrupt, pytest.raises(Interrupted), interrupt.allowed(), swallowing:
        signal.raise_signal(signal.SIGINT)


def test_without_a_signal_nothing_happens_and_the_handlers_come_back():
    before = signal.getsignal(signal.SIGINT)
    with Interrupt() as interrupt:
        assert signal.getsignal(signal.SIGINT) is not before
        with interrupt.allowed():
            pass
        assert not interrupt.requested
    assert signal.getsignal(signal.SIGINT) is before


def test_it_works_in_another_thread_where_signals_cannot_be_taken():
    errors = []

    def body():
        try:
            with Interrupt() as interrupt, interrupt.allowed():
                pass
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=body)
    thread.start()
    thread.join()
    assert errors == []
