"""Watch of standard input for ``--until-eof``.

Standard input ends when the program that started the run has ended.
"""

import os
import select

from handctl.core.types import TickIn, TickOut
from handctl.runtime.mailbox import STOP

STDIN = 0
READ_BYTES = 4096
"""Largest number of bytes that one read of standard input discards."""


class StdinWatch:
    """Observer of a run that requests a stop after the end of standard input. See ``session.run.RunObserver``."""

    def __init__(self) -> None:
        """Start with an open standard input."""
        self.input_ended = False

    def poll_requests(self) -> tuple[str, ...]:
        """Return one stop request after the end of standard input."""
        if self.input_ended or not select.select([STDIN], [], [], 0)[0] or os.read(STDIN, READ_BYTES):
            return ()
        self.input_ended = True
        return (STOP,)

    def on_tick(self, entry: TickIn, out: TickOut) -> None:
        """Ignore the tick. See ``session.run.RunObserver``."""
