"""Notices and progress reports from a run to the operator.

The caller of a run provides the functions that show the notices and the progress.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

NoticeCallback = Callable[[str], None]
"""Function that shows a notice of one line to the operator."""
ProgressFunction = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Function that takes the name of a step, and returns a context manager that shows the progress of this step.

The context manager yields a function. The arguments of the yielded function are the completed count
and the total count of the step.
"""


def ignore_notice(text: str) -> None:
    """Ignore a notice to the operator."""


def ignore_progress(words: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Ignore all progress reports of a preparation step before the run."""
    return nullcontext(lambda done, total: None)
