"""Functions that fork this process for parallel work, and that count the available cores."""

import os
import signal
import traceback
from collections.abc import Callable


def usable_cores() -> int:
    """Return the number of processor cores on which this process is allowed to run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_in_forked_copy(forked_function: Callable[[], str]) -> tuple[int, int]:
    """Run a function in a forked copy of this process.

    The forked copy ends without running the exit handlers that it has inherited from this process.

    Args:
        forked_function: function that returns a text, which the copy writes into a pipe.

    Returns:
        the process id of the copy, and the end of the pipe from which this process reads the
        result. If the function fails, the copy prints the traceback and ends with status 1.
    """
    read_end, write_end = os.pipe()
    process = os.fork()
    if process:
        os.close(write_end)
        return process, read_end
    os.close(read_end)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    code = 1
    try:
        with os.fdopen(write_end, "w") as pipe:
            pipe.write(forked_function())
        code = 0
    finally:
        if code:
            traceback.print_exc()
        os._exit(code)
