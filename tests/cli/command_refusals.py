"""Run commands with wrong input, and return the error lines that they print."""

from handctl.cli.main import main


def refusal_line(capsys, *command_words):
    """Return the error line of a command that refuses its input and prints exactly one error line."""
    lines = refusal_lines(capsys, *command_words)
    assert len(lines) == 1, lines
    return lines[0]


def refusal_lines(capsys, *command_words):
    """Return the error lines that a command prints when it refuses its input.

    The command prints one error line for each mistake in its input.
    """
    assert main(command_words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines(keepends=True)
    assert lines
    assert all(line.startswith("handctl: ") and line.endswith("\n") for line in lines), err
    return lines
