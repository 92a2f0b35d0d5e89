"""Signal handlers that are installed only for the duration of a block."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def installed_handler(
    handler: Callable[[int, FrameType | None], None], *numbers: signal.Signals
) -> Iterator[None]:
    """Install a signal handler for the duration of a block, and restore the previous handlers afterwards.

    Args:
        handler: function that handles every signal in ``numbers`` during the block.
        numbers: signals to handle.
    """
    previous_handlers = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, previous_handler in previous_handlers.items():
            signal.signal(number, previous_handler)


class TerminationFlag:
    """Flag that is set when the process receives SIGTERM.

    A program that checks the flag between two steps of its work can complete the present step
    before the program ends.
    """

    def __init__(self) -> None:
        """Start with the flag not set."""
        self.requested = False

    def __call__(self, signal_number: int, frame: object) -> None:
        """Handle a signal: set the flag."""
        self.requested = True
