"""Notices and progress from a run to its operator. The caller decides where they go."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

Tell = Callable[[str], None]
"""Callback that takes one notice of one line."""
Progress = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Context that shows the progress of a named step. Its callback takes the completed and the total count."""


def silent(text: str) -> None:
    """Discard a notice."""


def unseen(words: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Discard progress reports."""
    return nullcontext(lambda done, total: None)
