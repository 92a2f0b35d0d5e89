"""A hand file that ``config init`` writes from a few answers passes `config check`, for all valid answers."""

import itertools
import json
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.drives.motor_description import GUARDED_PROTOCOLS
from handctl.hand.hand_loading import load_hand
from tests.cli.command_refusals import refusal_line

INIT_CASES = [
    (fingers, opposed, links, tendons)
    for fingers, opposed in ((1, 1), (2, 0), (4, 1), (3, 2))
    for links in ("60", "40,30", "50,30,20")
    for tendons in ("one", "each")
]


@pytest.mark.parametrize(("fingers", "opposed", "links", "tendons"), INIT_CASES)
def test_new_hand_file_passes_config_check(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    fingers: int,
    opposed: int,
    links: str,
    tendons: str,
) -> None:
    numbers = [
        "--fingers",
        str(fingers),
        "--opposed",
        str(opposed),
        "--links",
        links,
        "--tendons",
        tendons,
    ]
    assert main(["config", "init", "--yes", *numbers, "--output", "mine.toml"]) == 0
    code = main(["config", "check", "--hand", "mine.toml"])
    assert code == 0, capsys.readouterr().err
    hand = load_hand("mine.toml")
    joints = len(links.split(","))
    assert len(hand.digit) == fingers + opposed
    assert len(hand.joints) == joints * len(hand.digit)
    assert len(hand.tendon) == len(hand.digit) * (joints if tendons == "each" else 1)
    assert (
        json.loads((work_folder / "hand.schema.json").read_text())["title"]
        == "Hand file of handctl"
    )
    assert (work_folder / "mine.toml").read_text().startswith("#:schema hand.schema.json\n")


@pytest.mark.parametrize("protocol", GUARDED_PROTOCOLS)
@pytest.mark.parametrize("tension", ["20", "300"])
def test_a_new_hand_file_is_valid_for_every_drive_and_tension(
    work_folder: Path, capsys: pytest.CaptureFixture[str], protocol: str, tension: str
) -> None:
    words = ["--protocol", protocol, "--fingers", "3", "--tension", tension, "--strength", "900"]
    assert main(["config", "init", "--yes", *words, "--output", "mine.toml"]) == 0
    code = main(["config", "check", "--hand", "mine.toml"])
    assert code == 0, capsys.readouterr().err


def test_questions_are_asked_until_they_are_answered(
    work_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = iter(["gripper", "one", "1", "", "55, 35", *itertools.repeat("", 6)])
    asked: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda text: asked.append(text) or next(answers))
    assert main(["config", "init", "--tension", "50", "--output", "mine.toml"]) == 0
    assert "'one'; expected a whole number" in capsys.readouterr().out
    assert not any("Largest tension" in text for text in asked), "the answer was an option"
    hand = load_hand("mine.toml")
    assert (hand.name, hand.digit_names) == ("gripper", ("index", "thumb"))
    assert hand.digit[0].link_length_m == (0.055, 0.035)
    assert hand.tendon[0].tension_max_N == 50.0


def test_questions_without_a_terminal_are_refused(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal_line(capsys, "config", "init", "--output", "mine.toml")
    assert line.endswith(
        "config init: nobody can answer the questions: no terminal; expected --yes, and options\n"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--name", "my hand"], "--name: 'my hand'; expected letters"),
        (["--fingers", "0", "--opposed", "0"], "--fingers: no digit"),
        (["--fingers", "9"], "--fingers: 9; expected 0 to 8"),
        (["--links", "0.04,0.03"], "default.digit.link_length_m[0]: 4e-05"),
        (["--tension", "700"], "default.tendon.tension_max_N: 700"),
    ],
)
def test_invalid_answers_are_refused(
    work_folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert said in refusal_line(capsys, "config", "init", "--yes", *words, "--output", "mine.toml")
    assert not (work_folder / "mine.toml").exists()


def test_existing_file_is_not_overwritten_by_config_init(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (work_folder / "mine.toml").write_text("mine")
    refusal_line(capsys, "config", "init", "--yes", "--output", "mine.toml")
    assert (work_folder / "mine.toml").read_text() == "mine"
