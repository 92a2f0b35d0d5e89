"""Test the smallest complete hand file, which the page *Describe a hand* contains."""

import json

import pytest

from handctl.cli.main import main
from handctl.hand.hand_loading import load_hand
from handctl.hand.readiness_checks import doubtful_values
from tests.conftest import NIGHTLY
from tests.docs.code_blocks import REPOSITORY_ROOT, read_code_blocks

HAND_FILE = REPOSITORY_ROOT / "examples" / "hands" / "two_fingers.toml"
PAGE = REPOSITORY_ROOT / "docs" / "how-to" / "your-hand.md"


def test_the_page_contains_the_file():
    texts = [block.text for block in read_code_blocks(PAGE) if block.language == "toml"]
    assert HAND_FILE.read_text() in texts


def test_no_key_can_be_left_out(tmp_path, capsys):
    lines = HAND_FILE.read_text().splitlines()
    optional_keys = ("mount_rpy_deg",)
    for i, line in enumerate(lines):
        if " = " not in line or line.startswith(optional_keys):
            continue
        (tmp_path / "mine.toml").write_text("\n".join(lines[:i] + lines[i + 1 :]))
        assert main(["config", "check", "--hand", str(tmp_path / "mine.toml")]) == 2, line
    assert doubtful_values(load_hand(HAND_FILE)) == ()


@pytest.mark.parametrize("seed", range(20 if NIGHTLY else 1))
def test_the_hand_grasps_in_its_first_demo(tmp_path, capsys, monkeypatch, seed):
    monkeypatch.chdir(tmp_path)
    words = ["demo", "--lockstep", "--hand", str(HAND_FILE), "--seed", str(seed), "--json"]
    assert main(words) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["table_sunk_mm"] > 50.0
    assert result["object_slid_mm"] < 5.0
