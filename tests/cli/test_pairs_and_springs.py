"""Test a hand with three different fingers.

The hand has spool pairs, an abduction joint, and fingers with springs: one finger with a load cell,
and one finger without a load cell. A new user wrote the hand file of this hand, and read only the
page *Describe a hand*. Most tests of this module reproduce a defect that the new user found.
"""

import copy
import json
from pathlib import Path

import pytest

from handctl.cli.main import main
from handctl.controller.bus_load import bus_warnings
from handctl.core.gains.gains import load_gains_file
from handctl.hand.hand_loading import hand_from_content, load_hand
from handctl.hand.readiness_checks import doubtful_values
from handctl.log.read.reader import RunLog
from handctl.programs.default_task import grasp_warnings
from handctl.tune.identify.identify import identify_tendons
from tests.conftest import NIGHTLY

HAND_FILE = Path(__file__).parents[1] / "hand" / "pairs_and_springs.toml"
OTHER_DIRECTIONS = ("9.81, 0.0, 0.0", "0.0, 0.0, 9.81", "5.6, -5.6, -5.6")
"""Gravity in the palm frame [m/s2] with which the object fell beside the hand, because the table was at -z."""
ALL_DIRECTIONS = (
    *OTHER_DIRECTIONS,
    "-9.81, 0.0, 0.0",
    "0.0, 9.81, 0.0",
    "0.0, -9.81, 0.0",
    "6.9, 6.9, 0.0",
    "-6.9, 0.0, 6.9",
)
SHORT_MOUNT = "mount_position_m = [0.0, 0.035, -0.022]\nmount_rpy_deg = [180.0, 0.0, 0.0]"
HAND_FILE_MISTAKES = {
    "a tendon that opens like the springs": (
        "moment_arm_m = { j1 = 0.008, j2 = 0.006 }, tension_floor_N",
        "moment_arm_m = { j1 = -0.008, j2 = -0.006 }, tension_floor_N",
        "digit[short].tendon: no tendon closes the joints, which the springs open; expected a tendon with",
    ),
    "a position range below the travel": (
        "position_range_rad = 12.5",
        "position_range_rad = 1.0",
        "default.motor.position_range_rad: 1; expected at least 2.9 rad, the spool angle of opposer_flex",
    ),
    "two fingers at one place": (
        "mount_position_m = [0.0, 0.035, -0.022]",
        "mount_position_m = [0.0, 0.035, 0.022]",
        "digit[short].mount_position_m: the position of long; expected another position",
    ),
    "a watchdog of one tick": (
        "watchdog_ms = 20",
        "watchdog_ms = 1",
        "default.motor.watchdog_ms: 1 ms, and bus can0 with 1000000 bit/s and 4 motors allows a control rate "
        "of only 500 Hz; expected at least 4 ms, or a faster bus",
    ),
    "a slow bus": (
        "bitrate = 1000000",
        "bitrate = 50000",
        "default.motor.watchdog_ms: 20 ms, and bus can0 with 50000 bit/s and 4 motors allows a control rate "
        "of only 20 Hz; expected at least 100 ms, or a faster bus",
    ),
    "no schema": (
        "schema = 2\n",
        "",
        "schema: missing; expected schema = 2 in the first line, as the file has [default]",
    ),
    "a digit in single brackets": (
        '[[digit]]\nname = "short"',
        '[digit]\nname = "short"',
        "line 89: [digit]; expected [[digit]]",
    ),
    "a missing radius": (
        "link_radius_m = 0.007\n",
        "",
        "default.digit.link_radius_m: missing; expected a number from 0.0005 to 0.05 m, there or in each digit",
    ),
    "a missing list": (
        "link_mass_kg = [0.020, 0.012]\n",
        "",
        "digit[short].link_mass_kg: missing; expected a list, each a number from 1e-05 to 0.5 kg",
    ),
    "a missing position": (
        "mount_position_m = [0.0, 0.035, -0.022]\n",
        "",
        "digit[short].mount_position_m: missing; expected a list of 3 entries, each a number from -0.5 to 0.5 m",
    ),
    "limits in rad of joints that also open": (
        "joint_min_deg = 0.0\njoint_max_deg = 90.0",
        "joint_min_deg = -20.0\njoint_max_deg = 1.57",
        "digit[long, short].coupling: column 0 opens the digit; expected the opposite sign: "
        "a positive coordinate flexes, or joint_max_deg in degrees",
    ),
}
"""Mistakes in the hand file: the text to replace, the wrong text, and the beginning of the refusal."""
VALUES_WITH_WARNING = {
    "an unusual bit rate": (
        "bitrate = 1000000",
        "bitrate = 987654",
        "bus[can0].bitrate: 987654 is not usual",
    ),
    "no gravity": ("-9.81]", "0.0]", "mount.gravity_m_s2: a gravity of 0 m/s2"),
    "gravity in g": ("-9.81]", "-1.0]", "mount.gravity_m_s2: a gravity of 1 m/s2"),
    "a long watchdog": (
        "watchdog_ms = 20",
        "watchdog_ms = 5000",
        "opposer_abd, opposer_flex and 2 more: watchdog_ms: the drive keeps its torque for 5000 ms",
    ),
    "limits in rad": (
        "joint_max_deg = 90.0",
        "joint_max_deg = 1.57",
        "long_j1, long_j2 and 3 more: joint_max_deg: the joint can turn by only 1.57 deg",
    ),
    "a thousandth of an inertia": (
        "link_inertia_kg_m2 = [3.0e-6, 8e-7]",
        "link_inertia_kg_m2 = [3.0e-9, 8e-7]",
        "digit[short].link_inertia_kg_m2[0]: a radius of gyration of ",
    ),
    "a torque constant in N m per 32 A": (
        "torque_constant_N_m_per_A = 0.5",
        "torque_constant_N_m_per_A = 16.0",
        "opposer_abd, opposer_flex and 2 more: torque_constant_N_m_per_A: torque_peak_N_m needs ",
    ),
    "an axis along the link": (
        "[[0, 1, 0], [0, 0, 1], [0, 0, 1]]",
        "[[0, 1, 0], [1, 0, 0], [0, 0, 1]]",
        "opposer_j2: joint_axis: the joint turns its link about the link's own x axis",
    ),
    "an unused bus": (
        "[sensor_node]",
        '[[bus]]\nname = "can1"\nbitrate = 1000000\n\n[sensor_node]',
        "bus[can1]: no motor and no sensor uses this bus",
    ),
    "an unused data bit rate": (
        "bitrate = 1000000",
        "bitrate = 1000000\ndata_bitrate = 5000000",
        "bus[can0].data_bitrate: no motor on this bus sends CAN FD frames",
    ),
    "a digit far away": (
        "mount_position_m = [0.0, -0.035, 0.0]",
        "mount_position_m = [0.0, -0.35, 0.0]",
        "digit[opposer].mount_position_m: 0.386 m from the nearest digit, more than two digit lengths",
    ),
    "a wrap angle of two turns": (
        "wrap_angle_rad = 1.0",
        "wrap_angle_rad = 12.6",
        "opposer_abd, opposer_flex and 2 more: friction_coefficient and wrap_angle_rad: only 36 % of the tension",
    ),
    "a spring that the weight overcomes": (
        "0.0, 0.0, -9.81",
        "0.0, -9.81, 0.0",
        "long_j1: with this gravity, weight and tension_floor_N close the joint with 0.0327 N m, and its spring",
    ),
    "a finger that flexes away": (
        SHORT_MOUNT,
        SHORT_MOUNT.replace("180.0", "0.0"),
        "short: flexes away from the other digits",
    ),
    "a mount angle in rad": (
        SHORT_MOUNT,
        SHORT_MOUNT.replace("180.0", "3.1416"),
        "short: flexes away from the other digits",
    ),
}
"""Values that are hardly intended: the text to replace, the new text, and the beginning of the warning."""


def write_hand(old_text: str = "", new_text: str = "") -> None:
    """Write the hand file mine.toml, in which a new text replaces an old text."""
    text = HAND_FILE.read_text()
    assert old_text in text
    Path("mine.toml").write_text(text.replace(old_text, new_text, 1))


def check_grasp(capsys: pytest.CaptureFixture[str], seed: int) -> None:
    """Run ``handctl demo`` with mine.toml, and check that the hand holds the object while the table sinks."""
    assert main(["demo", "--lockstep", "--hand", "mine.toml", "--seed", str(seed), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["table_sunk_mm"] > 50.0
    assert result["object_slid_mm"] < 10.0


@pytest.mark.parametrize("mistake_name", HAND_FILE_MISTAKES)
def test_a_mistake_is_one_line(
    work_folder: Path, capsys: pytest.CaptureFixture[str], mistake_name: str
) -> None:
    """Reproduce defects: `config check` accepted mistakes in ``HAND_FILE_MISTAKES``, or blamed a correct key."""
    old_text, new_text, expected_start = HAND_FILE_MISTAKES[mistake_name]
    write_hand(old_text, new_text)
    assert main(["config", "check", "--hand", "mine.toml"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"handctl: mine.toml: {expected_start}")


@pytest.mark.parametrize("case", VALUES_WITH_WARNING)
def test_a_doubtful_value_is_a_warning(
    work_folder: Path, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    """Reproduce defects: `config check` printed no warning about the values in ``VALUES_WITH_WARNING``."""
    old_text, new_text, expected_start = VALUES_WITH_WARNING[case]
    write_hand(old_text, new_text)
    assert main(["config", "check", "--hand", "mine.toml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len([line for line in lines if line.startswith(f"# warning: {expected_start}")]) == 1


def test_closed_stops_in_rad_are_a_warning_for_joints_without_coupling() -> None:
    content = copy.deepcopy(load_hand("n_plus_1").content)
    digit = content["digit"][0]
    digit["joint_min_deg"] = [-20.0] * len(digit["joint_max_deg"])
    digit["joint_max_deg"] = [1.57] * len(digit["joint_max_deg"])
    (line,) = doubtful_values(hand_from_content(content, "mine.toml"))
    assert "joint_max_deg: no joint of the digit closes beyond 1.57 deg" in line


def test_a_usual_hand_has_no_such_warning(work_folder: Path) -> None:
    hand = load_hand(HAND_FILE)
    assert (*doubtful_values(hand), *bus_warnings(hand), *grasp_warnings(hand)) == ()


def test_all_missing_keys_of_the_sensor_node_come_at_once(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reproduce a defect: missing sensor-node keys were reported only after all other mistakes were gone."""
    write_hand("sync_id = 0x80\nbase_id = 0x200\n", "")
    text = Path("mine.toml").read_text().replace("link_radius_m = 0.007\n", "")
    text = text.replace("joint_decimation = 1\njoint_noise_rad = 0.001\n", "")
    Path("mine.toml").write_text(text)
    assert main(["config", "check", "--hand", "mine.toml"]) == 2
    lines = capsys.readouterr().err.splitlines()
    keys = ["default.digit.link_radius_m", "sensor_node.sync_id", "sensor_node.base_id"]
    assert len(lines) == len(keys), "a node without joint encoders needs no keys about them"
    for key in keys:
        assert any(f"{key}: missing; expected a" in line for line in lines)


@pytest.mark.parametrize(
    ("gravity", "seed"),
    [
        (gravity, seed)
        for gravity in (ALL_DIRECTIONS if NIGHTLY else OTHER_DIRECTIONS[-1:])
        for seed in range(3 if NIGHTLY else 1)
    ],
)
def test_the_first_demo_grasps_in_every_direction_of_gravity(
    work_folder: Path, capsys: pytest.CaptureFixture[str], gravity: str, seed: int
) -> None:
    """Reproduce two defects: the hand oscillated with the default gains, and the object fell beside the table."""
    write_hand("0.0, 0.0, -9.81", gravity)
    check_grasp(capsys, seed)


def test_a_run_that_a_fault_holds_prints_json(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reproduce a defect: with ``--json``, a command printed nothing if the hold timeout ended its run.

    The hold timeout ends a run in which a fault stops the motion for too long.
    """
    write_hand()
    words = ["identify", "--lockstep", "--hand", "mine.toml", "--digits", "opposer", "--json"]
    assert main([*words, "--gain", "motion.force_N=13"]) == 1
    out, err = capsys.readouterr()
    result = json.loads(out)
    assert result["exit_code"] == 1
    assert f"handctl: {result['error']}" in err


@pytest.mark.parametrize("seed", range(20 if NIGHTLY else 1))
def test_identified_spool_pairs_are_those_of_the_plant(
    work_folder: Path, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    """Reproduce a defect: the identified friction and inertia of a spool pair were wrong if the joints had no encoders.

    The defect had two causes. The identification used the wrap angle of the last pulley, and
    assumed that the joint angles begin at zero.
    """
    write_hand()
    words = ["identify", "--lockstep", "--hand", "mine.toml", "--digits", "opposer"]
    assert main([*words, "--seed", str(seed), "--log", "run.mcap"]) == 0
    hand = load_hand("mine.toml")
    with RunLog(Path("run.mcap")) as log:
        results = identify_tendons(log, hand)
    assert set(results) == {"opposer_abd", "opposer_flex"}
    for name, result in results.items():
        motor = hand.motor_of_tendon(name)
        true_values = {
            "motor_inertia": motor.inertia_kg_m2,
            "motor_coulomb": motor.coulomb_N_m,
            "motor_viscous": motor.viscous_N_m_s_per_rad,
        }
        assert "motor_coulomb" in result.identified_names
        for parameter in true_values.keys() & set(result.identified_names):
            error = result.fit.parameter_values[parameter] - true_values[parameter]
            assert abs(error) < 1.5 * result.fit.half_widths[parameter], (name, parameter)
    assert "noise of the motor force" in capsys.readouterr().out


def test_a_rollback_to_the_default_gains_keeps_the_gain_margin(work_folder: Path) -> None:
    """The command ``gains rollback --to 0`` restores the default force weight of this hand.

    With the force weight of the packaged gains, this hand would oscillate.
    """
    write_hand()
    Path("gains.toml").write_text("schema = 1\n\n[motion]\nforce_N = 0.5\n")
    assert main(["gains", "apply", "gains.toml", "--hand", "mine.toml"]) == 0
    assert load_gains_file(Path("tri.gains.toml")).gains.motion.force_N == 0.5
    assert main(["gains", "rollback", "--to", "0", "--hand", "mine.toml"]) == 0
    gains = load_gains_file(Path("tri.gains.toml")).gains
    assert gains.force_weights_of_tendon("short_flexor")[0] == gains.motion.force_N == 1.1
    assert gains.force_weights_of_tendon("long_flexor")[0] == 0.95


def test_missing_options_of_drives_come_with_the_other_mistakes(
    work_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Reproduce a defect: `config check` reported one missing option at a time, after all other mistakes were gone."""
    write_hand('protocol = "mit"', 'protocol = "cia402"')
    text = Path("mine.toml").read_text()
    for position_range in ("", "position_range_rad = 12.5"):
        Path("mine.toml").write_text(text.replace("position_range_rad = 12.5", position_range))
        assert main(["config", "check", "--hand", "mine.toml"]) == 2
        places = [line.split(": ")[2] for line in capsys.readouterr().err.splitlines()]
        assert any(place.endswith(".options.rated_torque_N_m") for place in places)
        assert any(place.endswith(".options.counts_per_turn") for place in places)
        assert ("default.motor.position_range_rad" in places) == (not position_range)


@pytest.mark.parametrize("plant_count", range(1, 9) if NIGHTLY else [2])
def test_gains_are_designed_for_spool_pairs_and_springs(
    work_folder: Path, capsys: pytest.CaptureFixture[str], plant_count: int
) -> None:
    """Reproduce two defects: the design found no gains, or it never ended, because a fault held the simulated hand.

    The stability margins that the design required of the tension loops permitted gains with which a
    spool pair oscillated.
    """
    write_hand()
    words = ["--hand", "mine.toml", "--plants", str(plant_count), "--output", "designed.toml"]
    assert main(["tune", "design", *words]) == 0
    assert load_gains_file(Path("designed.toml")).tension.force_N < 10.0
    assert main(["demo", "--lockstep", "--hand", "mine.toml", "--gains", "designed.toml"]) == 0
