"""Messages for users.

Each message is a printable line of limited length, even if it contains parts of files and
arguments.
"""

MAX_MESSAGE_LENGTH = 500
"""Maximum length of a message [characters]."""
OMISSION_MARK = " [...] "
"""Text that replaces the middle of a message that is too long."""


def printable_text(text: str) -> str:
    """Replace unprintable characters of a text by escape sequences.

    Unprintable characters are, for example, line ends and the control characters of terminals.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "replace").decode() for c in text
    )


def one_line_message(text: str) -> str:
    """Convert a text to a message that has a single line.

    A message starts with the problem and ends with the remedy. Therefore the function removes only
    the middle of a long text.
    """
    if (
        len(text) > 4 * MAX_MESSAGE_LENGTH
    ):  # a replacement by escape sequences never makes a text shorter
        text = text[: 2 * MAX_MESSAGE_LENGTH] + text[-2 * MAX_MESSAGE_LENGTH :]
    line = printable_text(text)
    if len(line) <= MAX_MESSAGE_LENGTH:
        return line
    end = MAX_MESSAGE_LENGTH // 3
    return line[: MAX_MESSAGE_LENGTH - end - len(OMISSION_MARK)] + OMISSION_MARK + line[-end:]
