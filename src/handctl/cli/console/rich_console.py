"""Console of the package rich, for the output of all commands.

The console escapes control characters in text from files. If the program that reads the output
closes its pipe, the console raises an error that ends the command.
"""

from collections.abc import Iterable
from typing import Any

from handctl.printing import escape_text


def rich_console(error: bool = False, min_width: int = 1) -> Any:
    """Return a console of the package rich.

    Args:
        error: True to print on standard error. If standard error is closed, the text is dropped
            without an error.
        min_width: smallest width of the console [columns]. If the terminal is narrower, the lines
            of a table wrap, so that no number is cut off.
    """
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class EscapingConsole(Console):
        def render(
            self, renderable: RenderableType, options: ConsoleOptions | None = None
        ) -> Iterable[Segment]:
            """Escape all printed text.

            The control codes that rich itself writes are not escaped.
            """
            for segment in super().render(renderable, options):
                is_printable = segment.control or segment.text.isprintable()
                yield (
                    segment
                    if is_printable
                    else Segment(escape_text(segment.text, "\n\t"), segment.style)
                )

        def render_str(self, text: str, **keywords: Any) -> Any:
            """Escape a string before rich measures the width of the string."""
            return super().render_str(escape_text(text, "\n\t"), **keywords)

        def on_broken_pipe(self) -> None:
            """Raise the error that every command raises for a closed pipe.

            The function ``main`` handles the error of a closed pipe. If only the pipe of the
            progress output is closed, the command continues without the progress output.
            """
            if not error:
                raise BrokenPipeError
            self.quiet = True

    console = EscapingConsole(stderr=error, markup=False, emoji=False, highlight=False)
    if console.width < min_width:
        console.width = min_width
    return console
