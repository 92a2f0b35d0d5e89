"""``handctl identify`` on hands that lack what the fits need: one line, before a bus is opened."""

from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.hand.load import hand_path


def without_cell(folder: Path) -> str:
    """Write jamia without the load cell of its first tendon, and return the path."""
    text = hand_path("jamia").read_text()
    assert 'tendons = "all"' in text
    path = folder / "bare.toml"
    path.write_text(text.replace('tendons = "all"', 'tendons = ["middle_tendon", "ring_tendon", "thumb_tendon"]'))
    return str(path)


@pytest.mark.parametrize("words", [["--lockstep"], ["--bus"], ["--lockstep", "--dry-run"]])
def test_a_hand_without_springs_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    buses = ["--bus", "main=local:one", "--bus", "second=local:two"] if "--bus" in words else words
    assert main(["identify", "--hand", "n_plus_1", *buses]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no springs" in line
    assert "return springs" in line


def test_a_hand_without_load_cells_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["identify", "--hand", without_cell(tmp_path), "--lockstep"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no load cell on index_tendon" in line
    assert main(["identify", "--hand", without_cell(tmp_path), "--lockstep", "--digits", "pinky"]) == 2
    assert "pinky" in capsys.readouterr().err
