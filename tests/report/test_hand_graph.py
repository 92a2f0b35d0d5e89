"""The text picture of a hand and the drawing of a hand both name all parts of the hand."""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand, packaged_hands
from handctl.report.hand_graph import draw_hand, text_graph
from tests.cli.command_refusals import refusal_line


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_text_names_all_parts(hand_name: str) -> None:
    hand = load_hand(hand_name)
    text = text_graph(hand)
    for name in (*hand.bus_names, *hand.digit_names, *hand.tendon_names, *hand.motor_names):
        assert name in text
    assert text.count("[load cell]") == len(hand.sensor_node.tendons)
    assert text.count("mit") == len(hand.motor)
    assert text.count("(j1)") == (len(hand.digit) + 1 if hand.sensor_node.joints else 0)


@pytest.mark.parametrize("hand_name", packaged_hands())
def test_the_drawing_is_whole(hand_name: str, tmp_path: Path) -> None:
    for suffix in ("svg", "png"):
        draw_hand(tmp_path / f"hand.{suffix}", load_hand(hand_name))
    ET.parse(tmp_path / "hand.svg")
    assert (tmp_path / "hand.png").read_bytes().startswith(b"\x89PNG")


def test_graph_shows_both_buses_an_extensor_and_an_escaped_name(tmp_path: Path) -> None:
    content = hand_content("jamia11")
    content["description"] = "a $hand$ with \x1b"
    content["bus"].append({"name": "second", "bitrate": 1_000_000, "data_bitrate": 5_000_000})
    content["motor"][10]["bus"] = "second"
    content["tendon"][10]["moment_arm_m"] = {"thumb_j1": -0.003, "thumb_j2": 0.003}
    hand = hand_from_content(content, "x")
    assert "second: 1 Mbit/s, data phase 5 Mbit/s, 1 motors" in text_graph(hand)
    assert "j1 -3 mm  j2 +3 mm" in text_graph(hand)
    draw_hand(tmp_path / "hand.svg", hand)


def test_config_show_graph_prints_or_draws_the_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["config", "show", "--graph", "--hand", "t42"]) == 0
    assert "left_flexor: j1 +10 mm  j2 +5 mm" in capsys.readouterr().out
    assert main(["config", "show", "--graph", "--hand", "t42", "--output", "t42.svg"]) == 0
    assert "t42.svg: 2 digits, 2 tendons" in capsys.readouterr().out
    assert "--graph with it" in refusal_line(
        capsys, "config", "show", "--hand", "t42", "--output", "x.svg"
    )
    assert ".svg" in refusal_line(
        capsys, "config", "show", "--graph", "--hand", "t42", "--output", "x.txt"
    )
