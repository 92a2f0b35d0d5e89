"""Preparation of standard input, standard output and standard error for all commands."""

import os
import sys
from contextvars import ContextVar
from io import TextIOWrapper

has_printed_json: ContextVar[bool] = ContextVar("has_printed_json", default=False)
"""True if the running command has printed JSON."""


def open_standard_streams() -> None:
    """Open each standard stream that is closed.

    After the call, standard output and standard error escape each character that the terminal
    cannot show. If a standard stream stayed closed, the next opened file would get the file
    descriptor of this stream.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # the opened file gets the lowest free descriptor, which is the descriptor of the closed
            # stream
            os.open(os.devnull, os.O_RDWR)
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def flush_stdout() -> None:
    """Write all buffered text to standard output.

    Raises:
        OSError: the disk is full, or the reader has closed the pipe.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        discard_output()
        raise OSError(error.errno, error.strerror, "standard output") from None


def discard_output() -> None:
    """Discard buffered output that cannot be written to standard output.

    If the output stayed in the buffer, Python would try to write the output again at the end of the
    process, and fail again.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
