"""Notices and progress reports from a run to the operator.

The caller of the run supplies the functions.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

NoticeCallback = Callable[[str], None]
"""Callback for a notice of one line."""
Progress = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Context manager that shows the progress of a named step.

The context yields a callback for completed and total count.
"""


def ignore_notice(text: str) -> None:
    """Ignore a notice."""


def ignore_progress(words: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Ignore progress reports."""
    return nullcontext(lambda done, total: None)
