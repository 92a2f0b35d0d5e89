"""Observer that stops a run when standard input ends, for the option ``--until-eof``.

A run with ``--until-eof`` ends when standard input ends. Standard input ends when the program that
started the run ends.
"""

import os
import select

from handctl.core.tick_types import TickIn, TickOut
from handctl.runtime.mailbox import STOP_REQUEST

STDIN_FD = 0
MAX_READ_BYTES = 4096
"""Largest number of bytes that one read of standard input discards."""


class StdinWatch:
    """Observer of a run.

    The observer requests a stop when standard input has ended, see ``session.run.RunObserver``.
    """

    def __init__(self) -> None:
        """Create the observer. The end of standard input has not been seen yet."""
        self.input_ended = False

    def poll_requests(self) -> tuple[str, ...]:
        """Return a stop request once, after standard input has ended."""
        if (
            self.input_ended
            or not select.select([STDIN_FD], [], [], 0)[0]
            or os.read(STDIN_FD, MAX_READ_BYTES)
        ):
            return ()
        self.input_ended = True
        return (STOP_REQUEST,)

    def on_tick(self, tick_input: TickIn, tick_output: TickOut) -> None:
        """Do nothing after a tick of the run.

        The interface ``session.run.RunObserver`` requires this method.
        """
