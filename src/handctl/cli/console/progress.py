"""What a person sees who waits: a bar on the terminal, gone when the work is done."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from handctl.cli.console.screen import screen
from handctl.cli.console.verbosity import is_quiet


class Told(Protocol):
    """How the work tells where it is."""

    def __call__(self, done: int, most: int | None = None, words: str | None = None) -> None:
        """So much is done, of so much, which is called so."""
        ...


@contextmanager
def progress(words: str, most: int | None = None, quiet: bool = False) -> Iterator[Told]:
    """A bar on standard error, if that is a terminal.

    Args:
        words: what is done.
        most: how much there is to do; None if nobody knows.
        quiet: show none.

    """
    if quiet or is_quiet() or not sys.stderr.isatty():
        yield lambda done, most=None, words=None: None
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=screen(error=True), transient=True) as bar:
        task = bar.add_task(words, total=most)

        def told(done: int, most: int | None = None, words: str | None = None) -> None:
            bar.update(task, completed=done, total=most, description=words)

        yield told
