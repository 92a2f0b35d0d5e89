"""Test that `config check` accepts the hand files that ``config init`` writes for valid answers to its questions."""

import itertools
import json
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.hand.hand_loading import load_hand
from handctl.session.run_plan import default_control_rate
from tests.cli.command_refusals import refusal_line

INIT_CASES = [
    (fingers, opposed, links, tendons)
    for fingers, opposed in ((1, 1), (2, 0), (4, 1), (3, 2))
    for links in ("60", "40,30", "50,30,20")
    for tendons in ("one", "each")
]


@pytest.mark.parametrize(
    ("finger_count", "opposed_digit_count", "link_lengths_mm", "tendon_choice"), INIT_CASES
)
def test_new_hand_file_passes_config_check(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    finger_count: int,
    opposed_digit_count: int,
    link_lengths_mm: str,
    tendon_choice: str,
) -> None:
    numbers = [
        "--fingers",
        str(finger_count),
        "--opposed",
        str(opposed_digit_count),
        "--links",
        link_lengths_mm,
        "--tendons",
        tendon_choice,
    ]
    assert main(["config", "init", "--yes", *numbers, "--output", "mine.toml"]) == 0
    code = main(["config", "check", "--hand", "mine.toml"])
    assert code == 0, capsys.readouterr().err
    hand = load_hand("mine.toml")
    joints = len(link_lengths_mm.split(","))
    assert len(hand.digit) == finger_count + opposed_digit_count
    assert len(hand.joints) == joints * len(hand.digit)
    assert len(hand.tendon) == len(hand.digit) * (joints if tendon_choice == "each" else 1)
    assert (
        json.loads((work_folder / "hand.schema.json").read_text())["title"]
        == "Hand file of handctl"
    )
    assert (work_folder / "mine.toml").read_text().startswith("#:schema hand.schema.json\n")


@pytest.mark.parametrize("protocol", VERIFIABLE_PROTOCOLS)
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
    answers = iter(["gripper", "one", "1", "", "55, 35", *itertools.repeat("", 9)])
    questions: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda text: questions.append(text) or next(answers))
    assert main(["config", "init", "--tension", "50", "--output", "mine.toml"]) == 0
    assert "'one'; expected a whole number" in capsys.readouterr().out
    assert not any("Largest tension" in text for text in questions), "the answer was an option"
    hand = load_hand("mine.toml")
    assert (hand.name, hand.digit_names) == ("gripper", ("index", "thumb"))
    assert hand.digit[0].link_length_m == (0.055, 0.035)
    assert hand.tendon[0].tension_max_N == 50.0


SENSOR_CASES = [
    (tendons, springs, cells, encoders)
    for tendons, springs in (("one", "all"), ("each", "all"), ("each", "none"))
    for cells in ("all", "none")
    for encoders in ("all", "none")
]
"""Valid answers to the questions about tendons, springs, load cells and encoders."""


def sensor_options(sensor_case: tuple[str, str, str, str]) -> list[str]:
    """Return the options of `config init` for one of ``SENSOR_CASES``."""
    names = ("--tendons", "--springs", "--cells", "--encoders")
    return [word for pair in zip(names, sensor_case, strict=True) for word in pair]


@pytest.mark.parametrize("case_index", range(len(SENSOR_CASES)))
def test_every_choice_of_sensors_and_springs_is_a_valid_hand(
    work_folder: Path, capsys: pytest.CaptureFixture[str], case_index: int
) -> None:
    """Reproduce a defect: `config init` refused `--cells none` without a robot description."""
    tendons, springs, cells, encoders = SENSOR_CASES[case_index]
    protocol = VERIFIABLE_PROTOCOLS[case_index % len(VERIFIABLE_PROTOCOLS)]
    links = ("60", "40,30", "50,30,20")[case_index % 3]
    words = [*sensor_options(SENSOR_CASES[case_index]), "--protocol", protocol, "--links", links]
    assert main(["config", "init", "--yes", *words, "--output", "mine.toml"]) == 0
    code = main(["config", "check", "--hand", "mine.toml"])
    assert code == 0, capsys.readouterr().err
    hand = load_hand("mine.toml")
    count = len(links.split(","))
    motors_per_digit = 1 if tendons == "one" else count + (springs == "none")
    assert len(hand.tendon) == len(hand.motor) == 3 * motors_per_digit
    assert all(
        any(digit.spring_stiffness_N_m_per_rad) == (springs == "all") for digit in hand.digit
    )
    assert default_control_rate(hand) >= 250.0
    assert hand.sensor_node.tendons == (hand.tendon_names if cells == "all" else ())
    assert hand.sensor_node.joints == (hand.joints if encoders == "all" else ())
    text = (work_folder / "mine.toml").read_text()
    assert ("[sensor_node]" in text) == ("all" in (cells, encoders))
    assert {motor.protocol for motor in hand.motor} == {protocol}


def test_sensors_springs_and_protocol_are_asked_for(
    work_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reproduce a defect.

    ``config init`` did not ask for sensors, springs and drive protocol. Without a message, ``config
    init`` wrote the drive protocol `mit` and a load cell for every tendon into the hand file.
    """
    answers = iter(
        [
            *itertools.repeat("", 6),
            "each",
            *itertools.repeat("", 4),
            "none",
            "all",
            "none",
            "odrive",
        ]
    )
    questions: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda text: questions.append(text) or next(answers))
    assert main(["config", "init", "--output", "mine.toml"]) == 0
    assert [text.rpartition(" [")[2] for text in questions[-4:]] == [
        "all]: ",
        "none]: ",
        "all]: ",
        "mit]: ",
    ]
    hand = load_hand("mine.toml")
    assert (hand.sensor_node.tendons, hand.sensor_node.joints) == ((), hand.joints)
    assert hand.digit[0].spring_stiffness_N_m_per_rad == (0.0, 0.0)
    assert {motor.protocol for motor in hand.motor} == {"odrive"}


@pytest.mark.parametrize(
    ("command_options", "proposed_options"),
    [
        (("--opposed", "0"), "--fingers 1 --opposed 1"),
        (("--opposed", "0", "--fingers", "1"), "--fingers 1 --opposed 1"),
        (("--opposed", "3", "--fingers", "0"), "--fingers 2 --opposed 1"),
    ],
)
def test_two_opposed_digits_are_proposed(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    command_options: tuple[str, ...],
    proposed_options: str,
) -> None:
    assert main(["config", "init", "--yes", *command_options, "--output", "mine.toml"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if "0: " in line)
    assert line.endswith(proposed_options)


def test_questions_without_a_terminal_are_refused(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal_line(capsys, "config", "init", "--output", "mine.toml")
    assert line.endswith(
        "config init: nobody can answer the questions: no terminal; expected --yes, and options\n"
    )


@pytest.mark.parametrize(
    ("command_options", "expected_message"),
    [
        (["--name", "my hand"], "--name: 'my hand'; expected letters"),
        (["--fingers", "0", "--opposed", "0"], "--fingers: no digit"),
        (["--fingers", "9"], "--fingers: 9; expected 0 to 8"),
        (["--springs", "none"], "--springs: none, and one tendon cannot open a digit"),
        (["--protocol", "cubemars", "--motor-type", "rs05"], "one of ak60-6, ak70-10"),
        (["--motor-type", "rs05"], "--motor-type: 'rs05' with mit; expected no motor type"),
        (["--first-node", "3"], "--first-node: only for an imported hand"),
        (["--links", "0.04,0.03"], "default.digit.link_length_m[0]: 4e-05"),
        (["--tension", "700"], "default.tendon.tension_max_N: 700"),
    ],
)
def test_invalid_answers_are_refused(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    command_options: list[str],
    expected_message: str,
) -> None:
    assert expected_message in refusal_line(
        capsys, "config", "init", "--yes", *command_options, "--output", "mine.toml"
    )
    assert not (work_folder / "mine.toml").exists()


def test_existing_file_is_not_overwritten_by_config_init(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (work_folder / "mine.toml").write_text("mine")
    refusal_line(capsys, "config", "init", "--yes", "--output", "mine.toml")
    assert (work_folder / "mine.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("protocol", "motor_type"),
    [("cubemars", "ak60-6"), ("robstride_mit", "rs00"), ("robstride", "rs02")],
)
def test_a_motor_type_is_taken_from_its_option_or_asked_for(
    work_folder: Path, monkeypatch: pytest.MonkeyPatch, protocol: str, motor_type: str
) -> None:
    """Reproduce a defect: `config init` did not accept `--protocol cubemars`."""
    words = ["config", "init", "--protocol", protocol, "--output"]
    assert main([*words, "option.toml", "--yes", "--motor-type", motor_type]) == 0
    questions: list[str] = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr(
        "builtins.input",
        lambda text: questions.append(text) or motor_type * ("Type of the" in text),
    )
    assert main([*words, "asked.toml"]) == 0
    assert sum("Type of the motors" in text for text in questions) == 1
    for file in ("option.toml", "asked.toml"):
        assert main(["config", "check", "--hand", file]) == 0
        motors = load_hand(file).motor
        assert {(motor.protocol, motor.options["motor_type"]) for motor in motors} == {
            (protocol, motor_type)
        }


@pytest.mark.parametrize(
    ("motor_type", "spool_radius_mm", "is_warned"),
    [
        ("ak60-6", "5", False),
        ("ak70-10", "5", True),
        ("ak70-10", "8", False),
        ("ak10-9", "8", True),
    ],
)
def test_config_check_warns_of_motors_that_cannot_rest(
    work_folder: Path,
    capsys: pytest.CaptureFixture[str],
    motor_type: str,
    spool_radius_mm: str,
    is_warned: bool,
) -> None:
    """Reproduce a defect: `config check` gave no warning for a motor whose smallest torque command is too large."""
    words = ["--protocol", "cubemars", "--motor-type", motor_type, "--spool", spool_radius_mm]
    assert main(["config", "init", "--yes", *words, "--output", "mine.toml"]) == 0
    capsys.readouterr()
    assert main(["config", "check", "--hand", "mine.toml"]) == 0
    assert (f"no torque command of {motor_type} means zero" in capsys.readouterr().out) == is_warned
