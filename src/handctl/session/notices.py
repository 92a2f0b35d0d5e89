"""What a run has to say to its operator beside its result; whoever starts it decides where that goes."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

Tell = Callable[[str], None]
"""Takes one notice, a line."""
Progress = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Shows the progress of what the words name; takes what is done, and of how much."""


def silent(text: str) -> None:
    """Take a notice and drop it: nobody reads."""


def unseen(words: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """Show no progress."""
    return nullcontext(lambda done, total: None)
