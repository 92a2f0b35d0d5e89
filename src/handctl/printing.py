"""Output of text in a form that is safe for a terminal.

Text from files, logs and arguments must not control the terminal or fill the screen. Therefore
handctl writes unprintable characters as escape sequences, as in Python source. Examples of
unprintable characters are control characters, terminal escapes, marks that change the direction of
text, and lone surrogates.
"""

import difflib
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, cast

MAX_MESSAGE_CHARACTERS = 500
"""Largest length of a printed message [characters]."""
MAX_WORD_CHARACTERS = 60
"""Largest length of a word that is quoted, or compared with names [characters]."""
OMISSION_MARK = " [...] "
"""Text that replaces the middle of a longer message."""


def escape_text(text: str, kept_characters: str = "") -> str:
    """Replace each character that is not printable by an escape sequence.

    Args:
        text: text to escape.
        kept_characters: characters that stay as they are, such as line ends.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or c in kept_characters else _escaped_character(c) for c in text
    )


def _escaped_character(character: str) -> str:
    """Return a character as it would appear in Python source."""
    return character.encode("unicode_escape", "replace").decode()


def printable_text(text: str, max_characters: int = 200) -> str:
    """Replace unprintable characters of a text by escape sequences.

    The result is cut off after ``max_characters`` characters.
    """
    return escape_text(text[:max_characters]) + ("..." if len(text) > max_characters else "")


def similar_name(word: str, valid_names: Iterable[str], min_similarity: float = 0.6) -> str:
    """Return the valid name that is most similar to a given word.

    If no name is similar enough, the result is an empty text.

    Args:
        word: word of any length, which a user typed or a file contains.
        valid_names: the valid names.
        min_similarity: lowest similarity at which a name is accepted, from 0 (no similarity) to 1 (equal).
    """
    close_matches = difflib.get_close_matches(
        word[:MAX_WORD_CHARACTERS], list(valid_names), n=1, cutoff=min_similarity
    )
    return close_matches[0] if close_matches else ""


def one_line_message(text: str, max_characters: int = MAX_MESSAGE_CHARACTERS) -> str:
    """Return a text as one line of limited length.

    Line ends become spaces. If the text is too long, the middle of the text is left out.

    A shortened text keeps its beginning and its end, because a message begins with the mistake and
    ends with the expected value.
    """
    # Escape sequences are never shorter than the characters that they replace.
    if len(text) > 4 * max_characters:
        text = text[: 2 * max_characters] + text[-2 * max_characters :]
    line = escape_text(text.replace("\n", " "))
    if len(line) <= max_characters:
        return line
    end = max_characters // 3
    return line[: max_characters - end - len(OMISSION_MARK)] + OMISSION_MARK + line[-end:]


def escape_surrogates(text: str) -> str:
    """Replace lone surrogates, which cannot be encoded, by escape sequences.

    A lone surrogate stands for a byte in a file name that is not valid UTF-8.
    """
    return text.encode("utf-8", "backslashreplace").decode()


class EscapedStream:
    """Text stream that writes unprintable characters as escape sequences.

    Line ends and tabs are written unchanged.
    """

    def __init__(self, stream: Any) -> None:
        """Write to the given text stream."""
        self.rich_proxied_file = stream
        """The original stream.

        The package ``rich`` writes escapes directly to the original stream, see
        ``cli.console.rich_console``.
        """

    def write(self, text: str) -> int:
        """Write a text with escape sequences for unprintable characters."""
        self.rich_proxied_file.write(escape_text(text, "\n\t"))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write lines with escape sequences for unprintable characters."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        """Return any other attribute of the original stream."""
        return getattr(self.rich_proxied_file, name)


@contextmanager
def escaped_streams() -> Iterator[None]:
    """Escape all text that is written to standard output and standard error during a block."""
    streams_before = sys.stdout, sys.stderr
    escaped_stdout, err = (
        line if isinstance(line, EscapedStream) else EscapedStream(line) for line in streams_before
    )
    sys.stdout, sys.stderr = cast(Any, escaped_stdout), cast(Any, err)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams_before
