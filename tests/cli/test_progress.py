"""Test that a command shows its progress on a terminal, but never in output that a program reads."""

import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from handctl.cli.console.progress import progress_bar

GOLDEN_LOG_TEXT = str(Path(__file__).parents[2] / "logs" / "golden" / "jamia-lost.mcap")


def run_at_terminal(command_words: tuple[str, ...], work_folder: Path) -> tuple[str, str]:
    """Run a command whose standard error is a terminal.

    Return the standard output of the command, and the text on the terminal.
    """
    master_side, terminal = pty.openpty()
    command = [sys.executable, "-m", "handctl.cli", *command_words]
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=terminal, cwd=work_folder, env=environment
    ) as process:
        os.close(terminal)
        error_output = b""
        try:
            while output_bytes := os.read(master_side, 4096):
                error_output += output_bytes
        except OSError:  # the command has closed the terminal
            pass
        assert process.stdout
        out = process.stdout.read()
    os.close(master_side)
    assert process.returncode == 0, error_output
    return out.decode(), error_output.decode()


def test_a_terminal_shows_a_bar_until_the_work_is_done(tmp_path: Path) -> None:
    out, error_output = run_at_terminal(
        ("replay", "execute", GOLDEN_LOG_TEXT, "--within", "1e-9", "--jobs", "1"), tmp_path
    )
    assert "0 with other decisions" in out
    assert "executing" in error_output
    assert "executing" not in out
    assert any(f" {share}%" in error_output for share in range(10, 100)), error_output


def test_programs_get_no_bar(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with progress_bar("working", 10, quiet=True) as show_progress:
        show_progress(5)
    assert capfd.readouterr() == ("", "")
