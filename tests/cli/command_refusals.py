"""Run commands with wrong input, and return the error lines that they print."""

import json

from handctl.cli.main import main


def refusal_line(capsys, *command_words):
    """Return the error line of a command that refuses its input and prints exactly one error line."""
    lines = refusal_lines(capsys, *command_words)
    assert len(lines) == 1, lines
    return lines[0]


def refusal_lines(capsys, *command_words):
    """Return the error lines that a command prints when it refuses its input.

    The command prints one error line for each mistake in its input. With ``--json``, standard output
    contains the error as JSON.
    """
    assert main(command_words) == 2
    out, err = capsys.readouterr()
    if "--json" in command_words:
        assert f"handctl: {json.loads(out)['error']}\n" in err
    else:
        assert out == ""
    lines = err.splitlines(keepends=True)
    assert lines
    assert all(line.startswith("handctl: ") and line.endswith("\n") for line in lines), err
    return lines
