"""Text for users: one line, printable and of bounded length, independent of quoted files and arguments."""

MAX_MESSAGE_LENGTH = 500
"""Maximum length of a message [characters]."""
LEFT_OUT = " [...] "
"""Replacement for the middle of a longer message."""


def printable(text: str) -> str:
    """Replace characters that are not printable by escapes: terminal escapes, line ends, lone surrogates."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "replace").decode() for c in text)


def one_line(text: str) -> str:
    """Convert a text to a message of one line.

    The start of a message names the problem, and the end names the remedy. Therefore only the middle of a
    long text is removed.
    """
    if len(text) > 4 * MAX_MESSAGE_LENGTH:  # Escapes make a text longer, never shorter.
        text = text[: 2 * MAX_MESSAGE_LENGTH] + text[-2 * MAX_MESSAGE_LENGTH :]
    line = printable(text)
    if len(line) <= MAX_MESSAGE_LENGTH:
        return line
    end = MAX_MESSAGE_LENGTH // 3
    return line[: MAX_MESSAGE_LENGTH - end - len(LEFT_OUT)] + LEFT_OUT + line[-end:]
