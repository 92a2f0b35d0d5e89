"""Text for users: one line, printable and of bounded length, independent of quoted files and arguments."""

LONGEST = 500
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
    if len(text) > 4 * LONGEST:  # Escapes make a text longer, never shorter.
        text = text[: 2 * LONGEST] + text[-2 * LONGEST :]
    line = printable(text)
    if len(line) <= LONGEST:
        return line
    end = LONGEST // 3
    return line[: LONGEST - end - len(LEFT_OUT)] + LEFT_OUT + line[-end:]
