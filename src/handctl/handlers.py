"""Temporary signal handlers."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def installed_handler(handler: Callable[[int, FrameType | None], None], *numbers: signal.Signals) -> Iterator[None]:
    """Install a signal handler for a block and restore the previous handlers.

    Args:
        handler: handler of all signals.
        numbers: signals.
    """
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, handled in before.items():
            signal.signal(number, handled)


class TerminationFlag:
    """Flag that SIGTERM sets, so that a step in progress is completed."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, number: int, frame: object) -> None:
        """Handle the signal: set the flag."""
        self.asked = True
