"""Standard input, output and error as a verb can rely on them, whatever it was started with."""

import os
import sys
from io import TextIOWrapper


def make_usable() -> None:
    """Open what is closed, or the next file would take its place; a name that a terminal cannot show is escaped."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free: this one
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def flush() -> None:
    """Have all that was printed out of this process.

    Raises:
        OSError: there is no room for it, or nobody reads it.
    """
    try:
        sys.stdout.flush()
    except OSError as error:
        give_up_output()
        raise OSError(error.errno, error.strerror, "standard output") from None


def give_up_output() -> None:
    """Throw away what was printed and cannot be written: it would fail again when the process ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
