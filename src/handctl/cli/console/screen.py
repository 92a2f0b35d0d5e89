"""Console of the package rich for all commands.

The console escapes text from files. If the reader of a command's output closes the pipe, the
console ends the command.
"""

from collections.abc import Iterable
from typing import Any

from handctl.printing import escape_text


def rich_console(error: bool = False, min_width: int = 1) -> Any:
    """Return a console of the package rich.

    Args:
        error: True to print on standard error. If standard error is closed, the output is dropped
            without an error.
        min_width: smallest width [columns]. A narrower terminal wraps the lines of a table, but
            cuts no number.
    """
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class Screen(Console):
        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterable[Segment]:
            """Escape every text except the control codes that rich itself writes."""
            for segment in super().render(renderable, options):
                done = segment.control or segment.text.isprintable()
                yield segment if done else Segment(escape_text(segment.text, "\n\t"), segment.style)

        def render_str(self, text: str, **keywords: Any) -> Any:
            """Escape a string before rich measures the width."""
            return super().render_str(escape_text(text, "\n\t"), **keywords)

        def on_broken_pipe(self) -> None:
            """Raise the same error as in commands without rich, which ``main`` handles.

            If only progress output has no reader any more, the command continues silently.
            """
            if not error:
                raise BrokenPipeError
            self.quiet = True

    console = Screen(stderr=error, markup=False, emoji=False, highlight=False)
    if console.width < min_width:
        console.width = min_width
    return console
