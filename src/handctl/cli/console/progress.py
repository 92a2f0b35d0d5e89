"""What a person sees who waits: a bar on the terminal, gone when the work is done."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from handctl.cli.console.screen import screen
from handctl.cli.console.verbosity import is_quiet


class ProgressCallback(Protocol):
    """How the work tells where it is."""

    def __call__(self, done: int, total: int | None = None, label: str | None = None) -> None:
        """So much is done, of so much, which is called so."""
        ...


@contextmanager
def progress(label: str, total: int | None = None, quiet: bool = False) -> Iterator[ProgressCallback]:
    """A bar on standard error, if that is a terminal.

    Args:
        words: what is done.
        total: how much there is to do; None if nobody knows.
        quiet: show none.

    """
    if quiet or is_quiet() or not sys.stderr.isatty():
        yield lambda done, total=None, label=None: None
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
    with Progress(*columns, console=screen(error=True), transient=True) as bar:
        task = bar.add_task(label, total=total)

        def update(done: int, total: int | None = None, label: str | None = None) -> None:
            bar.update(task, completed=done, total=total, description=label)

        yield update
