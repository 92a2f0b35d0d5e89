"""rich as the verbs use it: for a reader who has gone, and for words of a person that are no markup."""

from collections.abc import Iterable
from typing import Any

from handctl.printing import escaped


def screen(error: bool = False, min_width: int = 1) -> Any:
    """A console of rich.

    Args:
        error: print on standard error, where nobody has to read.
        min_width: columns that a table needs; in a terminal of fewer its lines are broken, but no number is cut off.
    """
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

    class Screen(Console):
        def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
            """Escape every text, and leave rich's own control codes."""
            for segment in super().render(renderable, options):
                done = segment.control or segment.text.isprintable()
                yield segment if done else Segment(escaped(segment.text, "\n\t"), segment.style)

        def render_str(self, text: str, **keywords: Any) -> Any:
            """Escape a string before its width is measured."""
            return super().render_str(escaped(text, "\n\t"), **keywords)

        def on_broken_pipe(self) -> None:
            """Let ``main`` end the verb as it ends those that print without rich; go on without progress."""
            if not error:
                raise BrokenPipeError
            self.quiet = True

    console = Screen(stderr=error, markup=False, emoji=False, highlight=False)
    if console.width < min_width:
        console.width = min_width
    return console
