"""Safe text output.

Text from files, logs and arguments is printed so that it cannot control a terminal or fill the
screen. Characters that are not printable are escaped as in Python source: control characters,
terminal escapes, marks of text direction, and lone surrogates.
"""

import difflib
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, cast

LONGEST_MESSAGE = 500
"""Maximum length of a message [characters]."""
LONGEST_WORD = 60
"""Maximum length of a word that is compared with names or quoted [characters]."""
OMISSION_MARK = " [...] "
"""Replaces the middle of a longer message."""


def escape_text(text: str, kept: str = "") -> str:
    """Escape the characters that are not printable.

    Args:
        text: any text.
        kept: characters to leave as they are, such as line ends.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in kept else _escape(c) for c in text)


def _escape(character: str) -> str:
    """Write one character as Python's source does."""
    return character.encode("unicode_escape", "replace").decode()


def printable_text(text: str, most: int = 200) -> str:
    """Escape text and cut it after ``most`` characters."""
    return escape_text(text[:most]) + ("..." if len(text) > most else "")


def similar_name(word: str, names: Iterable[str], cutoff: float = 0.6) -> str:
    """Return the name that is most similar to a word, empty if no name is similar.

    Args:
        word: a word that was typed or read, of any length.
        names: the valid names.
        cutoff: lowest similarity, from 0 (none) to 1 (equal).
    """
    near = difflib.get_close_matches(word[:LONGEST_WORD], list(names), n=1, cutoff=cutoff)
    return near[0] if near else ""


def one_line_message(text: str, most: int = LONGEST_MESSAGE) -> str:
    """Return one line of bounded length. Line ends become spaces. The middle of a long text is left out.

    The mistake is at the beginning of a message, the expected value at its end.
    """
    if len(text) > 4 * most:  # escaping never makes a text shorter
        text = text[: 2 * most] + text[-2 * most :]
    line = escape_text(text.replace("\n", " "))
    if len(line) <= most:
        return line
    end = most // 3
    return line[: most - end - len(OMISSION_MARK)] + OMISSION_MARK + line[-end:]


def escape_surrogates(text: str) -> str:
    """Escape lone surrogates, which stand for the bytes of a name that is not UTF-8 and have no encoding."""
    return text.encode("utf-8", "backslashreplace").decode()


class EscapedStream:
    """Text stream that escapes characters that are not printable. Line ends and tabs remain."""

    def __init__(self, stream: Any) -> None:
        self.rich_proxied_file = stream
        """The original stream. ``rich`` writes its own escapes there, see ``cli.console.screen``."""

    def write(self, text: str) -> int:
        """Write escaped text."""
        self.rich_proxied_file.write(escape_text(text, "\n\t"))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write escaped lines."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


@contextmanager
def escaped_streams() -> Iterator[None]:
    """Escape all text on standard output and standard error during a block."""
    before = sys.stdout, sys.stderr
    out, err = (one if isinstance(one, EscapedStream) else EscapedStream(one) for one in before)
    sys.stdout, sys.stderr = cast(Any, out), cast(Any, err)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
