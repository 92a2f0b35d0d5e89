"""Amount of text on standard error: less with ``--quiet``, more with ``--verbose``.

Results, errors and cautions are always printed.
"""

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from enum import IntEnum

from handctl.printing import one_line_message


class Verbosity(IntEnum):
    """Amount of text that a command prints in addition to its result."""

    QUIET = 0
    NORMAL = 1
    VERBOSE = 2


_current_verbosity: ContextVar[Verbosity] = ContextVar("verbosity", default=Verbosity.NORMAL)
_printed_cautions: ContextVar[set[str] | None] = ContextVar("printed_cautions", default=None)
"""Cautions that the running command has printed, None if no command runs."""


@contextmanager
def apply_verbosity(args: argparse.Namespace) -> Iterator[None]:
    """Apply ``--quiet`` and ``--verbose`` of a command line while the command runs.

    The record of printed cautions begins empty for each command, see ``is_first_caution``.
    """
    quiet = getattr(args, "quiet", False)
    verbose = getattr(args, "verbose", False)
    verbosity = Verbosity.QUIET if quiet else Verbosity.VERBOSE if verbose else Verbosity.NORMAL
    token = _current_verbosity.set(verbosity)
    cautions = _printed_cautions.set(set())
    try:
        yield
    finally:
        _printed_cautions.reset(cautions)
        _current_verbosity.reset(token)


def is_first_caution(text: str) -> bool:
    """Return True if the running command has not printed the given caution yet.

    Record that the caution is printed now.
    """
    printed_cautions = _printed_cautions.get()
    if printed_cautions is None:
        return True
    is_first_time = text not in printed_cautions
    printed_cautions.add(text)
    return is_first_time


def is_quiet() -> bool:
    """Return True if the command should print only results and errors."""
    return _current_verbosity.get() == Verbosity.QUIET


def is_verbose() -> bool:
    """Return True if the command should print details."""
    return _current_verbosity.get() == Verbosity.VERBOSE


def print_note(text: str) -> None:
    """Print a notice, or a text about progress, to standard error, unless ``--quiet`` is given."""
    if not is_quiet():
        print(one_line_message(text), file=sys.stderr, flush=True)


def print_detail(text: str) -> None:
    """Print a detail to standard error, if ``--verbose`` is given."""
    if is_verbose():
        print(one_line_message(text), file=sys.stderr, flush=True)
