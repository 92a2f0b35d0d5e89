"""Signals that an operator or a terminal sends become requests to the control loop.

No signal of the operator is lost. When a run ends, the run restores the old signal handlers.
"""

import os
import signal

import pytest

from handctl.runtime.loop import StopSignals


class RaisedInTestError(Exception):
    """Error that a test raises inside a run."""


def test_the_first_signal_stops_and_every_further_one_cuts() -> None:
    signals = StopSignals()
    with signals.install_handlers():
        assert signals.take_request() == ()
        os.kill(os.getpid(), signal.SIGINT)
        assert signals.take_request() == ('{"do": "stop"}',)
        assert signals.take_request() == ()
        os.kill(os.getpid(), signal.SIGTERM)
        assert signals.take_request() == ('{"do": "cut"}',)
        os.kill(os.getpid(), signal.SIGINT)
        assert signals.take_request() == ('{"do": "cut"}',)
        assert signals.take_request() == ()


def test_two_signals_within_a_tick_both_count() -> None:
    signals = StopSignals()
    with signals.install_handlers():
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        assert signals.take_request() == ('{"do": "stop"}',)
        assert signals.take_request() == ('{"do": "cut"}',)


def test_a_closed_terminal_stops_the_hand_unless_under_nohup() -> None:
    signals = StopSignals()
    handler_before = signal.getsignal(signal.SIGHUP)
    with signals.install_handlers():
        os.kill(os.getpid(), signal.SIGHUP)
        assert signals.take_request() == ('{"do": "stop"}',)
    assert signal.getsignal(signal.SIGHUP) == handler_before
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with signals.install_handlers():
            os.kill(os.getpid(), signal.SIGHUP)
            assert signals.take_request() == ()
    finally:
        signal.signal(signal.SIGHUP, handler_before)


def test_signal_handlers_are_restored() -> None:
    handlers_before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    signals = StopSignals()

    def raise_interrupt() -> None:
        with signals.install_handlers():
            assert signal.getsignal(signal.SIGINT) is signals
            raise RaisedInTestError

    with pytest.raises(RaisedInTestError):
        raise_interrupt()
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == handlers_before
