"""Start of the recorder process, also before the run to be recorded is known.

The recorder process needs half a second for its imports. A verb that records starts this process
before the verb's own imports (`process_ahead`), so that both import at the same time on two cores.
This module therefore imports little.
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
"""Recorder process that `process_ahead` has started and no recorder has taken yet."""


def start_process() -> RecorderProcess:
    """Start a recorder process. The process ends when the pipe is closed."""
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
    """Start a recorder process for the first recorder in this block.

    If no recorder takes the process, it is ended at the end of the block.
    """
    _ahead.append(start_process())
    try:
        yield
    finally:
        while _ahead:
            _ahead.pop().end()


def take_process() -> RecorderProcess:
    """Return the process that `process_ahead` has started, or start a process."""
    return _ahead.pop() if _ahead else start_process()
