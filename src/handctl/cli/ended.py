"""Signals that end a verb where no hand runs: they unwind it, so that files, children and sockets are put away.

While a hand runs the loop has the signals: see ``runtime.loop.Signals``.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Terminated(KeyboardInterrupt):
    """SIGTERM, or SIGHUP of a terminal that has gone."""


def _end(number: int, frame: FrameType | None) -> None:
    raise Terminated


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Have SIGTERM and SIGHUP end what runs as Ctrl-C does; what ``nohup`` has told to be ignored stays so."""
    numbers = [one for one in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(one) == signal.SIG_DFL]
    before = {number: signal.signal(number, _end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
