"""Copies of this process that work something out, and the cores that they may have."""

import os
import signal
import traceback
from collections.abc import Callable


def cores() -> int:
    """Return the number of cores on which this process may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_copy(work: Callable[[], str]) -> tuple[int, int]:
    """Do something in a copy of this process, which ends without anything of the original's.

    Args:
        work: is done there; what it returns comes out of the pipe.

    Returns:
        The process, and the reading end of the pipe. Its status is 1 where the work fails; the traceback is printed.
    """
    reading, writing = os.pipe()
    process = os.fork()
    if process:
        os.close(writing)
        return process, reading
    os.close(reading)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    code = 1
    try:
        with os.fdopen(writing, "w") as pipe:
            pipe.write(work())
        code = 0
    finally:
        if code:
            traceback.print_exc()
        os._exit(code)
