"""Test the conversion of hand files from schema 1 to schema 2.

The converted hand file describes the same hand and keeps the comments. If a value is repeated in
the old file, the converted file contains the value only once.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.hand.description import Hand
from handctl.hand.file.schema_conversion import convert_to_schema_2
from handctl.hand.hand_loading import hand_from_content, load_hand, packaged_hands, parse_toml
from tests.contracts.random_hands import random_hand
from tests.hand.test_hand_file_templates import IDENTITY_BY_HAND

SCHEMA_1_FILE = Path(__file__).with_name("jamia_schema_1.toml")
"""The earlier packaged hand file of jamia in schema 1, with a comment at every number."""


def hand_after_conversion(hand_file_text: str) -> Hand:
    """Convert the text of a hand file from schema 1 to schema 2, and return the hand that the new text describes."""
    content = parse_toml(convert_to_schema_2(hand_file_text, "old"), "new")
    assert content["schema"] == 2
    return hand_from_content(content, "new")


def test_an_old_file_still_loads() -> None:
    assert load_hand(SCHEMA_1_FILE).identity == IDENTITY_BY_HAND["jamia"]


def test_an_old_file_shrinks_and_keeps_its_comments() -> None:
    old_text = SCHEMA_1_FILE.read_text("utf-8")
    new_text = convert_to_schema_2(old_text, "old")
    assert hand_after_conversion(old_text).identity == IDENTITY_BY_HAND["jamia"]
    assert len(new_text.splitlines()) < 120 < 230 < len(old_text.splitlines())
    for comment in re.findall(r"# *(.*)", old_text):
        assert comment.strip() in new_text, comment
    for text in ("1_000_000", "0x1A0", "6.384e-3", "0.3e-3"):
        assert text in new_text, "numbers keep their notation"


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_a_packaged_hand_written_out_is_the_same_hand_again(hand_name: str) -> None:
    assert (
        hand_after_conversion(load_hand(hand_name).to_toml()).identity
        == load_hand(hand_name).identity
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_random_hand_is_the_same_hand(seed: int) -> None:
    hand = random_hand(1 + seed, np.random.default_rng(seed))
    assert (
        hand_after_conversion(hand.to_toml()).identity
        == hand_from_content(parse_toml(hand.to_toml(), "old"), "old").identity
    )


def test_differing_comments_of_one_value_are_joined() -> None:
    old_text = SCHEMA_1_FILE.read_text("utf-8")
    knee_position = old_text.index("knee_N = 200.0", old_text.index('name = "middle_tendon"'))
    old_text = (
        old_text[:knee_position]
        + "knee_N = 200.0  # measured in May"
        + old_text[knee_position + len("knee_N = 200.0") :]
    )
    assert re.search(
        r"^knee_N = 200.0 .*# the paper's section 5.*; measured in May$",
        convert_to_schema_2(old_text, "old"),
        re.M,
    )


def test_config_convert_writes_schema_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["config", "convert", str(SCHEMA_1_FILE), "--output", "new.toml"]) == 0
    assert "234, the same hand dfe326d335b4750c" in capsys.readouterr().out
    assert main(["config", "check", "--hand", "new.toml"]) == 0
    assert main(["config", "convert", "new.toml", "--output", "newer.toml"]) == 2
    assert (
        "new.toml: schema: schema 2 already; expected a file of schema 1" in capsys.readouterr().err
    )
    assert main(["config", "convert", str(SCHEMA_1_FILE), "--output", "new.toml"]) == 2, (
        "an existing file is not replaced"
    )
