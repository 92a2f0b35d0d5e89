"""Start of the recorder process, if wanted before the run that it records is known.

The process imports for half a second. A verb that records starts it before its own imports (`process_ahead`), so that
both import at the same time on two cores. This module therefore imports little.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple


class RecorderProcess(NamedTuple):
    """Recorder process that has no file yet.

    Attributes:
        child: the process. Its stdout is a pipe with notes.
        pipe: file descriptor for the records.
    """

    child: "subprocess.Popen[bytes]"
    pipe: int

    def end(self) -> None:
        """End the process at once, and close the pipes."""
        os.close(self.pipe)
        self.child.kill()
        self.child.wait()
        assert self.child.stdout is not None
        self.child.stdout.close()


_ahead: list[RecorderProcess] = []
"""Process that was started ahead and not taken yet."""


def start_process() -> RecorderProcess:
    """Start a recorder process. It ends when the pipe is closed."""
    reading, writing = os.pipe()
    # `-P` keeps the working directory out of the import path.
    command = [sys.executable, "-P", "-m", "handctl.log.write.process"]
    try:
        child = subprocess.Popen(command, stdin=reading, stdout=subprocess.PIPE, start_new_session=True)
    except OSError:
        os.close(writing)
        raise
    finally:
        os.close(reading)
    return RecorderProcess(child, writing)


@contextmanager
def process_ahead() -> Iterator[None]:
    """Start a recorder process for the first recorder in this block. If no recorder takes it, it is ended after it."""
    _ahead.append(start_process())
    try:
        yield
    finally:
        while _ahead:
            _ahead.pop().end()


def take_process() -> RecorderProcess:
    """Return the process that was started ahead, or start one."""
    return _ahead.pop() if _ahead else start_process()
