"""Whoever started a run and holds the other end of its standard input: if that goes, nobody is left to stop it."""

import os
import select

from handctl.core.types import TickIn, TickOut
from handctl.runtime.mailbox import STOP

STDIN = 0
READ_BYTES = 4096
"""Bytes of standard input that are thrown away at a time."""


class StdinWatch:
    """An attendant of one run (see ``session.run.RunObserver``) that asks to stop once standard input has ended."""

    def __init__(self) -> None:
        self.input_ended = False

    def poll_requests(self) -> tuple[str, ...]:
        """To stop, once; nothing as long as somebody is there."""
        if self.input_ended or not select.select([STDIN], [], [], 0)[0] or os.read(STDIN, READ_BYTES):
            return ()
        self.input_ended = True
        return (STOP,)

    def on_tick(self, entry: TickIn, out: TickOut) -> None:
        """Nothing."""
