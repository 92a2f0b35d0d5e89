"""Test the hands that ``handctl identify`` refuses.

If a hand does not have the necessary sensors or springs, ``identify`` prints one error line.
``identify`` prints the error line before it opens a bus.
"""

from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.hand.hand_loading import hand_path, load_hand


def jamia_without_load_cell(hand_folder: Path) -> str:
    """Write the hand file of jamia without the load cell of the first tendon, and return the path of the hand file."""
    text = hand_path("jamia").read_text()
    assert 'tendons = "all"' in text
    path = hand_folder / "bare.toml"
    path.write_text(
        text.replace(
            'tendons = "all"', 'tendons = ["middle_tendon", "ring_tendon", "thumb_tendon"]'
        )
    )
    return str(path)


@pytest.mark.parametrize("hand", ["n_plus_1", "orca_like"])
def test_hands_without_return_springs_are_not_refused(
    hand: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reproduce a defect: ``identify`` refused two hands that it should accept.

    The first of the two hands has no springs. The second hand has no load cells, and each of its
    motors turns a pair of spools.
    """
    assert main(["identify", "--hand", hand, "--lockstep", "--dry-run"]) == 0
    assert f"would move {len(load_hand(hand).digit)} digits" in capsys.readouterr().out


def test_a_digit_without_load_cell_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reproduce a defect: one tendon without load cell made `identify` refuse the whole hand."""
    words = ["identify", "--hand", jamia_without_load_cell(tmp_path), "--lockstep", "--dry-run"]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert "would move 3 digits" in out
    assert "handctl: index is left out: no load cell on index_tendon" in err
    assert main([*words, "--digits", "index"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "digit index: no load cell on index_tendon" in line
    assert line.endswith("--digits middle ring thumb")
    assert (
        main(
            [
                "identify",
                "--hand",
                jamia_without_load_cell(tmp_path),
                "--lockstep",
                "--digits",
                "pinky",
            ]
        )
        == 2
    )
    assert "pinky" in capsys.readouterr().err
