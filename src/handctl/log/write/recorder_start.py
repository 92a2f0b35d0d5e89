"""Functions that start the recorder process, either for a run or in advance.

A recorder process that is started in advance later receives the path of the log and the header of
the run. The recorder process needs half a second for its imports. A command that records a run
first starts the recorder process, and then imports its other modules (see
`prestarted_recorder_process`). The command and the recorder process then import their modules at
the same time, on two cores. This module itself imports only a few modules, so that the command can
start the recorder process early.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple


class RecorderProcess(NamedTuple):
    """Recorder process that does not have a log file yet.

    Attributes:
        child: the process. The stdout of this process is a pipe with notes to the controller.
        pipe: file descriptor of the pipe into which the controller writes records.
    """

    child: "subprocess.Popen[bytes]"
    pipe: int

    def end_process(self) -> None:
        """End the recorder process at once, and close both pipes."""
        os.close(self.pipe)
        self.child.kill()
        self.child.wait()
        assert self.child.stdout is not None
        self.child.stdout.close()


_started_ahead: list[RecorderProcess] = []
"""Recorder process that `prestarted_recorder_process` has started, until a recorder takes it.

The list has at most one element.
"""


def start_recorder_process() -> RecorderProcess:
    """Start a recorder process. The process ends when the pipe for the records is closed."""
    read_end, write_end = os.pipe()
    # With the option `-P`, Python imports no modules from the working directory.
    command = [sys.executable, "-P", "-m", "handctl.log.write.recorder_process"]
    try:
        child = subprocess.Popen(
            command, stdin=read_end, stdout=subprocess.PIPE, start_new_session=True
        )
    except OSError:
        os.close(write_end)
        raise
    finally:
        os.close(read_end)
    return RecorderProcess(child, write_end)


@contextmanager
def prestarted_recorder_process() -> Iterator[None]:
    """Start a recorder process in advance.

    The first recorder that is created in the `with` block uses the prestarted process. If no
    recorder has used the prestarted process, the end of the `with` block ends the process.
    """
    _started_ahead.append(start_recorder_process())
    try:
        yield
    finally:
        while _started_ahead:
            _started_ahead.pop().end_process()


def get_recorder_process() -> RecorderProcess:
    """Return the recorder process that `prestarted_recorder_process` has started.

    If no recorder process was started in advance, start a recorder process.
    """
    return _started_ahead.pop() if _started_ahead else start_recorder_process()
