"""rich as the verbs use it: for a reader who has gone, and for words of a person that are no markup."""

from typing import Any


def screen(error: bool = False, least: int = 1) -> Any:
    """A console of rich.

    Args:
        error: print on standard error, where nobody has to read.
        least: columns that a table needs; in a terminal of fewer its lines are broken, but no number is cut off.
    """
    from rich.console import Console

    class Screen(Console):
        def on_broken_pipe(self) -> None:
            """Let ``main`` end the verb as it ends those that print without rich; go on without progress."""
            if not error:
                raise BrokenPipeError
            self.quiet = True

    console = Screen(stderr=error, markup=False, emoji=False, highlight=False)
    if console.width < least:
        console.width = least
    return console
