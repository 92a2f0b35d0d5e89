"""Text for people: one line, printable and of bounded length, whatever it quotes of files and arguments."""

LONGEST = 500
"""Characters of one message."""
LEFT_OUT = " [...] "
"""Stands for the middle of a message that is longer."""


def printable(text: str) -> str:
    """Escape what is not printable: terminal escapes, line ends, lone surrogates."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape", "replace").decode() for c in text)


def one_line(text: str) -> str:
    """Make a message of a text: its first words say what is wrong, its last what would be right."""
    if len(text) > 4 * LONGEST:  # escaping makes a text longer, never shorter
        text = text[: 2 * LONGEST] + text[-2 * LONGEST :]
    line = printable(text)
    if len(line) <= LONGEST:
        return line
    end = LONGEST // 3
    return line[: LONGEST - end - len(LEFT_OUT)] + LEFT_OUT + line[-end:]
