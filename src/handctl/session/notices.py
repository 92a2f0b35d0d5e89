"""Notices and progress reports from a run to the operator.

The caller of the run supplies the functions that show them.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

NoticeCallback = Callable[[str], None]
"""Function that shows a notice of one line to the operator."""
ProgressFunction = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Function that returns a context manager, which shows the progress of a named step.

The context yields a function that takes the completed count and the total count.
"""


def ignore_notice(text: str) -> None:
    """Ignore a notice to the operator."""


def ignore_progress(words: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Ignore all progress reports of a step."""
    return nullcontext(lambda done, total: None)
