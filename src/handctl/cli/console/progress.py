"""Progress bar on the terminal. The progress bar disappears when the work is done."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from handctl.cli.console.rich_console import rich_console
from handctl.cli.console.verbosity import is_quiet


class ProgressCallback(Protocol):
    """Function that a long computation calls to report its progress."""

    def __call__(self, done: int, total: int | None = None, label: str | None = None) -> None:
        """Report that ``done`` of ``total`` steps are complete.

        ``label`` names the present step.
        """
        ...


@contextmanager
def progress_bar(
    label: str, total: int | None = None, quiet: bool = False
) -> Iterator[ProgressCallback]:
    """Show a progress bar during a block, if standard error is a terminal.

    Args:
        label: name of the work.
        total: number of steps, or None if unknown.
        quiet: True to show no progress bar.
    """
    if quiet or is_quiet() or not sys.stderr.isatty():
        yield lambda done, total=None, label=None: None
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=rich_console(error=True), transient=True) as bar:
        task = bar.add_task(label, total=total)

        def update_progress(done: int, total: int | None = None, label: str | None = None) -> None:
            bar.update(task, completed=done, total=total, description=label)

        yield update_progress
