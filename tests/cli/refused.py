"""Error lines of a command with bad input."""

from handctl.cli.main import main


def refused(capsys, *words):
    """Return the one line that a command ends with."""
    lines = refused_lines(capsys, *words)
    assert len(lines) == 1, lines
    return lines[0]


def refused_lines(capsys, *words):
    """Return the lines that a command ends with, one for each mistake."""
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines(keepends=True)
    assert lines
    assert all(line.startswith("handctl: ") and line.endswith("\n") for line in lines), err
    return lines
