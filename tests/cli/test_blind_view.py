"""If the machine has no screen, handctl refuses a command with ``--view`` before the run starts."""

import sys

import pytest

from handctl.cli.main import main


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="only X and Wayland say where the screen is"
)
@pytest.mark.parametrize(
    "command_words", [["demo", "--view"], ["run", "--bus", "local:nowhere", "--view"]]
)
def test_no_screen_is_one_line(
    command_words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(command_words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("handctl: DISPLAY: no screen")
    assert err.count("\n") == 1
