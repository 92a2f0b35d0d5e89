"""Test typical mistakes in a hand file of schema 2.

For each mistake, the command prints one error line. The error line spells the wrong key exactly as
in the hand file.
"""

import json
import re
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.hand.hand_loading import hand_path

HAND_FILE_MISTAKES = {
    "a value in millimetres": (
        "link_length_m = [0.030, 0.015, 0.010]", "link_length_m = [30, 0.015, 0.010]",
        "digit_template.finger.link_length_m[0]: 30; expected 0 or a number from ",
    ),
    "a misspelt key of a default": (
        "knee_N = 200.0", "kneeN = 200.0", "default.tendon.kneeN: unknown key; expected knee_N",
    ),
    "a key of another section": (
        "watchdog_ms = 50", "watchdog_ms = 50\nknee_N = 200.0",
        "default.motor.knee_N: unknown key; expected one of name, protocol,",
    ),
    "a mode of the drive": (
        "watchdog_ms = 50", 'watchdog_ms = 50\nmode = "position"',
        "default.motor.mode: a hand commands torques; expected no mode; one drive: handctl jog --mode",
    ),
    "a key that no section has": (
        "wrap_angle_rad = 1.5708", "# wrap_angle_rad = 1.5708",
        "default.tendon.wrap_angle_rad: missing; expected a number from 0 to 20 rad, there or in each tendon",
    ),
    "a template that is not there": (
        'template = "finger"\nmount_position_m = [0.0, 0.025, 0.020]',
        'template = "fingr"\nmount_position_m = [0.0, 0.025, 0.020]',
        'digit[index].template: "fingr"; expected finger',
    ),
    "a default of an unknown section": (
        "[default.motor]", "[default.motors]", "default.motors: unknown key; expected motor",
    ),
    "a name in a default": (
        "[default.tendon]", '[default.tendon]\nname = "t"',
        "default.tendon.name: unknown key; expected name in the section itself",
    ),
    "the schema before templates": (
        "schema = 2", "schema = 1", "schema: 1; expected schema = 2 in the first line, as the file has [default]",
    ),
    "a schema of tomorrow": (
        "schema = 2", "schema = 3", "schema: 3; expected 1 or 2, versions that this handctl reads",
    ),
    "a joint that the digit does not have": (
        "moment_arm_m = { j1 = 0.003 } }   # 3 mm pulleys", "moment_arm_m = { j4 = 0.003 } }",
        'digit_template.finger.tendon.t1.moment_arm_m.j4: "index_j4" is not in this file; expected one of index_j1,',
    ),
    "a motor that the digit does not have": (
        'tendon.t1 = { motor = "m1", moment_arm_m = { j1 = 0.003 } }   #',
        'tendon.t1 = { motor = "m9", moment_arm_m = { j1 = 0.003 } }   #',
        'digit_template.finger.tendon.t1.motor: "m9" is not in this file; expected one of index_m1,',
    ),
    "a tendon that is no table": (
        'tendon.t3 = { motor = "m3", moment_arm_m = { j1 = 0.003, j2 = 0.003, j3 = 0.003 } }', "tendon.t3 = 3",
        "digit_template.finger.tendon.t3: 3; expected a table",
    ),
    "too few values": (
        "link_mass_kg = [6.384e-3, 3.192e-3, 2.128e-3]", "link_mass_kg = [6.384e-3, 3.192e-3]",
        "digit_template.finger.link_mass_kg: 2 values; expected 3, one per link_length_m",
    ),
    "limits in the wrong order": (
        "tension_max_N = 110.0", "tension_max_N = 150.0",
        "default.tendon.tension_max_N: 150; expected more than tension_floor_N = 3 N and less than tension_trip_N",
    ),
    "a drive that may pull more than the limit": (
        "torque_max_N_m = 0.8 ", "torque_max_N_m = 1.0 ",
        "default.motor.torque_max_N_m: 1; expected drive_limit_N x spool_radius_m = 0.8 N m, within 1 %",
    ),
    "one node number twice": (
        "m1.node_id = 4", "m1.node_id = 1",
        'digit[middle].motor.m1.node_id: 0x1 on bus "main" is taken; expected an identifier that is not in use',
    ),
    "an unknown protocol": (
        'protocol = "mit"', 'protocol = "morse"',
        "default.motor.protocol: 'morse'; expected one of cia402, cubemars, mit",
    ),
    "a bus that is not there": (
        'protocol = "mit"\nbus = "main"', 'protocol = "mit"\nbus = "can0"',
        'default.motor.bus: "can0" is not in this file; expected one of main',
    ),
    "springs that do not open the digit": (
        "spring_preload_rad = 0.6", "spring_preload_rad = 0.1",
        "default.digit.spring_preload_rad: the springs open j1 with 0.009 N m at joint_min_deg; expected more than the "
        "0.027 N m with which tension_floor_N closes",
    ),
    "a coupling of the wrong sign": (
        "spring_stiffness_N_m_per_rad = [0.09, 0.06, 0.03]        # 3:2:1 biases all three tendons equally",
        "spring_stiffness_N_m_per_rad = [0.09, 0.06, 0.03]\ncoupling = [[-1.0], [-1.0], [-1.0]]",
        "digit_template.finger.coupling: column 0 opens the digit; expected the opposite sign: a positive coordinate",
    ),
    "a load cell at no tendon": (
        'tendons = "all"', 'tendons = ["index_t1", "index_t9"]',
        'sensor_node.tendons[1]: "index_t9" is not in this file; expected one of index_t1,',
    ),
    "a joint that opens as far as it closes": (
        "joint_min_deg = 0.0", "joint_min_deg = 100.0",
        "default.digit.joint_max_deg: 100; expected more than joint_min_deg",
    ),
    "8 Mbit/s without CAN FD": (
        "bitrate = 1_000_000", "bitrate = 8_000_000", "bus[main].bitrate: 8000000; expected at most 1000000; the",
    ),
    "a data phase slower than the arbitration": (
        "bitrate = 1_000_000", "bitrate = 1_000_000\ndata_bitrate = 500_000",
        "bus[main].data_bitrate: 500000; expected at least bitrate = 1000000",
    ),
}  # fmt: skip
"""For each mistake: the original text in jamia11.toml, the wrong text, and the beginning of the error line."""


def write_changed_jamia11(work_folder: Path, *text_replacements: tuple[str, str]) -> None:
    """Replace each old text in the hand file of jamia11 by its new text, and write the result to mine.toml."""
    text = hand_path("jamia11").read_text("utf-8")
    for old_text, new_text in text_replacements:
        assert text.count(old_text) == 1, old_text
        text = text.replace(old_text, new_text)
    (work_folder / "mine.toml").write_text(text)


def error_lines(capsys: pytest.CaptureFixture[str], *check_options: str) -> list[str]:
    """Return the error lines of `config check` for mine.toml, without the name of the file."""
    assert main(["config", "check", "--hand", "mine.toml", *check_options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    return [line.removeprefix("handctl: ").removeprefix("mine.toml: ") for line in err.splitlines()]


@pytest.mark.parametrize("mistake_name", HAND_FILE_MISTAKES)
def test_a_mistake_is_one_line_that_names_the_key(
    work_folder: Path, capsys: pytest.CaptureFixture[str], mistake_name: str
) -> None:
    old_text, new_text, expected_start = HAND_FILE_MISTAKES[mistake_name]
    write_changed_jamia11(work_folder, (old_text, new_text))
    messages = error_lines(capsys)
    assert messages[0].startswith(expected_start)
    assert len(messages) == 1, messages
    assert all("expected" in line for line in messages)


def test_all_mistakes_are_reported_together(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cases = (
        "a misspelt key of a default",
        "a default of an unknown section",
        "a template that is not there",
    )
    write_changed_jamia11(
        work_folder,
        *[HAND_FILE_MISTAKES[case][:2] for case in cases],
        ("m2.node_id = 5", "m2.node_id = 500"),
    )
    messages = error_lines(capsys)
    starts = [HAND_FILE_MISTAKES[case][2] for case in cases] + [
        "digit[middle].motor.m2.node_id: 500"
    ]
    for start in starts:
        assert len([line for line in messages if line.startswith(start)]) == 1, start


def test_mistakes_of_the_other_files_are_reported_together(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_changed_jamia11(work_folder, ("bitrate = 1_000_000", "bitrate = 8_000_000"))
    (work_folder / "task.toml").write_text(
        'schema = 1\nname = "t"\n[[phase]]\nkind = "hold"\ntension_N = 40.0\nslip_limit_N = 30.0\n'
    )
    messages = error_lines(
        capsys, "--task", "task.toml", "--gain", "motion.force_N=-1", "--calibration", "no.toml"
    )
    starts = (
        "bus[main].bitrate: 8000000",
        "task.toml: phase[0].slip_limit_N: 30; expected at least tension_N of",
    )
    for start in (*starts, "--gain: motion.force_N", "no.toml: no such file"):
        assert len([line for line in messages if line.startswith(start)]) == 1, messages


def test_a_mistake_common_to_several_sections_is_one_line(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers = "[0.015, 0.010]"
    write_changed_jamia11(
        work_folder,
        (f"link_length_m = {numbers}", ""),
        ("m1.node_id = 10,", "m1 = { node_id = 10, direction = 0 },"),
    )
    line = error_lines(capsys)[0]
    assert line.startswith(
        "digit[thumb].link_length_m: missing; expected a list, each 0 or a number from 0.001 to 0.2 m: Distance"
    )


def test_the_message_about_an_empty_file_names_config_init(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (work_folder / "mine.toml").write_text("# nothing yet\n")
    assert error_lines(capsys) == [
        "schema: the file is empty; expected schema = 2 and the sections of a hand; "
        "handctl config init writes them from a few answers"
    ]


def test_a_missing_section_is_named_with_its_forms(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (work_folder / "mine.toml").write_text('schema = 2\nname = "mine"\n[[digit]]\nname = "left"\n')
    line_by_key = {line.partition(":")[0]: line for line in error_lines(capsys)}
    assert line_by_key["tendon"].startswith(
        "tendon: missing; expected [[tendon]] sections, or tendon.NAME in each digit: "
    )
    assert line_by_key["mount"].startswith("mount: missing; expected a section [mount]: ")
    assert "sensor_node" not in line_by_key, "a sensor node is optional"
    expected = (
        "expected a number from 0.0005 to 0.05 m: Radius of the links, whose shapes are capsules"
    )
    assert line_by_key["digit[left].link_radius_m"].endswith(expected)


def test_an_object_inside_the_hand_comes_with_the_others(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_changed_jamia11(work_folder, ("bitrate = 1_000_000", "bitrate = 8_000_000"))
    messages = error_lines(capsys, "--scene", "cylinder:900")
    assert messages[0].startswith("bus[main].bitrate: 8000000")
    assert re.match(
        r"the simulated hand: scene cylinder:900: the object is \d\d mm inside \w+_link\d of",
        messages[1],
    )
    assert messages[1].endswith("expected a smaller object, or another position_m")
    assert len(messages) == 2


def test_a_demo_refuses_such_an_object_too(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--lockstep", "--dry-run", "--scene", "cylinder:900"]) == 2
    assert "scene cylinder:900: the object is" in capsys.readouterr().err


def test_config_check_has_the_same_mistakes_in_json(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_changed_jamia11(work_folder, HAND_FILE_MISTAKES["one node number twice"][:2])
    assert main(["config", "check", "--json", "--hand", "mine.toml"]) == 2
    out, err = capsys.readouterr()
    assert [f"handctl: {line}" for line in json.loads(out)["errors"]] == err.splitlines()


@pytest.mark.parametrize(
    "mistake_name", ["springs that do not open the digit", "8 Mbit/s without CAN FD"]
)
def test_run_refuses_a_hand_file_with_mistakes(
    work_folder: Path, capsys: pytest.CaptureFixture[str], mistake_name: str
) -> None:
    write_changed_jamia11(work_folder, HAND_FILE_MISTAKES[mistake_name][:2])
    assert (
        main(
            ["run", "--hand", "mine.toml", "--bus", "local:nobody", "--task", "grasp", "--dry-run"]
        )
        == 2
    )
    assert "mine.toml: " in capsys.readouterr().err
