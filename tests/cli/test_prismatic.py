"""Test commands with hands that have prismatic joints: grasps, re-execution, mistakes, export and import."""

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq  # type: ignore[import-untyped]
import pytest

from firmware_sim.description.hand_description import load_hand as simulated_hand
from firmware_sim.plant.plant import Plant
from firmware_sim.scene.scene import load_scene
from firmware_sim.truth_file import truth_columns
from handctl.cli.main import main
from handctl.cli.tuning.tune_search import _designed_gains
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand, read_toml, validate_content
from handctl.replay.dataset_episode import find_episode
from handctl.report.truth_record import read_truth
from handctl.tune.loops.gain_design import design_gains, linear_factors
from tests.cli.command_refusals import refusal_line
from tests.conftest import NIGHTLY

HAND_FILE_FOLDER = Path(__file__).parents[1] / "hand"
PARALLEL_GRIPPER_FILE, MIXED_GRIPPER_FILE = "parallel_gripper.toml", "mixed_gripper.toml"
SIMULATOR_SEEDS = range(5)
MAX_SLIP_MM = 6.0


@pytest.fixture
def gripper_hand_files(work_folder: Path) -> Path:
    """Copy the hand files of the two grippers into the current folder."""
    for name in (PARALLEL_GRIPPER_FILE, MIXED_GRIPPER_FILE):
        shutil.copy(HAND_FILE_FOLDER / name, work_folder)
    return work_folder


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("hand_file", [PARALLEL_GRIPPER_FILE, MIXED_GRIPPER_FILE])
def test_a_gripper_grasps_holds_releases_and_is_re_executed(
    gripper_hand_files: Path, capsys: pytest.CaptureFixture[str], hand_file: str, seed: int
) -> None:
    words = ["--hand", hand_file, "--log", "run.mcap", "--seed", str(seed), "--json"]
    code = main(["demo", "--lockstep", *words])
    out, err = capsys.readouterr()
    assert code == 0, err
    result = json.loads(out)
    assert result["table_sunk_mm"] > 50.0
    assert result["object_motion_mm"] < MAX_SLIP_MM
    jaw_result = next(iter(result["joint_angles"].values()))
    assert jaw_result["unit"] == "mm"
    assert 0.0 <= jaw_result["error_deg"] < 0.2
    truth = read_truth(gripper_hand_files / "run.truth")
    forces = [name for name in truth.columns if name.startswith("contact_force/")]
    assert abs(truth.interpolated_columns(forces, truth.t_ns[-1:])).max() == 0.0, (
        "the hand has released"
    )
    final_joint_positions = truth.interpolated_columns(
        [f"q/{joint}" for joint in load_hand(hand_file).joints], truth.t_ns[-1:]
    )
    assert np.abs(final_joint_positions).max() < 0.06
    assert main(["replay", "execute", "run.mcap", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["differing"] == 0


@pytest.mark.parametrize("hand_file", [PARALLEL_GRIPPER_FILE, MIXED_GRIPPER_FILE])
def test_exports_have_the_units_of_prismatic_joints(
    gripper_hand_files: Path, capsys: pytest.CaptureFixture[str], hand_file: str
) -> None:
    """Reproduce a defect: all exports stated the unit rad for positions in m, and the unit N m for forces in N.

    The documentation states the unit of every exported value.
    """
    assert main(["demo", "--lockstep", "--hand", hand_file, "--log", "run.mcap"]) == 0
    for form in ("--csv", "--parquet", "--lerobot"):
        assert main(["log", "export", "run.mcap", form]) == 0
    capsys.readouterr()
    hand = load_hand(hand_file)
    titles = Path("run.csv").read_text().partition("\n")[0].split(",")
    schema = pq.read_schema("run.parquet")
    info = json.loads(Path("run.lerobot/meta/info.json").read_text())
    elements = info["features"]["action"]["names"][: len(hand.joints)]
    sigmas = info["features"]["observation.sigma"]["names"][: len(hand.joints)]
    for j, (joint, slides) in enumerate(zip(hand.joints, hand.is_prismatic.tolist(), strict=True)):
        position, effort = ("m", "N") if slides else ("rad", "N m")
        units = {
            "q": position, "q_sigma": position, "q_goal": position, "joint_encoder": position,
            "dq": f"{position}/s", "dq_goal": f"{position}/s", "joint_torque": effort,
        }  # fmt: skip
        for field, unit in units.items():
            assert f"{field}/{joint} [{unit}]" in titles
            assert schema.field(f"{field}/{joint}").metadata == {b"unit": unit.encode()}
        assert elements[j] == f"{joint}.pos_{position}"
        assert sigmas[j] == f"{joint}.pos_sigma_{position}"
    for title in titles:
        assert title.endswith("]") is (
            title not in ("k", "t_ns", "late_ns", "mode", "phase", "action")
        )
    goals = find_episode(Path("run.lerobot"), 0, hand, 0.002, 300.0)
    low, high = hand.joint_limits
    assert (goals.q.max(axis=0) > low + 0.2 * (high - low)).any()
    assert ((goals.q >= low - 1e-6) & (goals.q <= high + 1e-6)).all()


JOINT_TYPE_LINE = 'joint_type = ["prismatic"]'
HAND_FILE_MISTAKES = {
    "a type that no joint has": (
        JOINT_TYPE_LINE, 'joint_type = ["linear"]', 'joint_type[0]: "linear"; expected "revolute" or "prismatic"',
    ),
    "too many types": (
        JOINT_TYPE_LINE, 'joint_type = ["prismatic", "prismatic"]',
        "joint_type: 2 values; expected 1, one per link_length_m",
    ),
    "a range in millimetres": ("joint_max_m = 0.028", "joint_max_m = 28", "joint_max_m: 28; expected a number from"),
    "a range in degrees": (
        "joint_max_m = 0.028", "joint_max_m = 0.028\njoint_max_deg = [28.0]",
        "joint_max_deg: 1 values; expected no such key, as all joints are prismatic",
    ),
    "no range": ("joint_max_m = 0.028\n", "", "joint_max_m: missing; expected 1, one per prismatic joint"),
    "no damping": (
        "joint_damping_N_s_per_m = 2.0\n", "", "joint_damping_N_s_per_m: missing; expected 1, one per prismatic joint",
    ),
    "no armature": (
        "joint_armature_kg = 0.005\n", "", "joint_armature_kg: missing; expected 1, one per prismatic joint",
    ),
    "limits in the wrong order": (
        "joint_min_m = 0.0", "joint_min_m = 0.05", "joint_max_m: 0.028; expected more than joint_min_m[0] = 0.05",
    ),
    "too many values": ("joint_min_m = 0.0", "joint_min_m = [0.0, 0.0]", "joint_min_m: 2 values; expected 1, one per"),
    "no types": (JOINT_TYPE_LINE + "\n", "", "joint_min_deg: missing"),
    "revolute joints": (JOINT_TYPE_LINE, 'joint_type = ["revolute"]', "joint_min_deg: missing"),
    "a moment arm": (
        "excursion_ratio = { j1 = 1.0 }", "moment_arm_m = { j1 = 0.01 }",
        "moment_arm_m.j1: left_j1 is prismatic; expected excursion_ratio.left_j1, in metres of tendon per metre",
    ),
    "a ratio in millimetres": ("{ j1 = 1.0 }", "{ j1 = 1000.0 }", "excursion_ratio.j1: 1000.0; expected a number"),
    "a ratio of a moment arm": ("{ j1 = 1.0 }", "{ j1 = 0.01 }", "excursion_ratio.j1: 0.01; expected 0.05 to 5 m/m"),
    "a ratio that is a table": (
        "{ j1 = 1.0 }", "{ j1 = { polynomial_m = [1.0] } }", "excursion_ratio.j1: ",
    ),
    "a joint that the digit does not have": (
        "{ j1 = 1.0 }", "{ j2 = 1.0 }", 'excursion_ratio.j2: "left_j2" is not in this file; expected one',
    ),
    "a misspelt key": ("excursion_ratio", "excursion_ratios", "unknown key; expected excursion_ratio"),
    "springs that do not open": (
        "spring_preload_m = 0.03", "spring_preload_m = 0.01",
        "spring_preload_m: the springs open j1 with 1.5 N at joint_min_m; expected more than the 2 N",
    ),
    "a stiffness in N/mm": (
        "spring_stiffness_N_per_m = 150.0", "spring_stiffness_N_per_m = 0.15",
        "spring_preload_m: the springs open j1 with 0.0045 N",
    ),
    "a rated torque": (
        "joint_rated_force_N = 500.0", "joint_rated_torque_N_m = [5.0]",
        "joint_rated_torque_N_m: 1 values; expected no such key, as all joints are prismatic",
    ),
    "a noise in millimetres": ("joint_noise_m = 2e-5", "joint_noise_m = 0.02", "joint_noise_m: 0.02; expected"),
}  # fmt: skip
"""For each mistake: a text in the gripper's hand file, a wrong text that replaces it, and a part of the error line."""


@pytest.mark.parametrize("mistake_name", HAND_FILE_MISTAKES)
def test_a_mistake_is_one_line(
    gripper_hand_files: Path, capsys: pytest.CaptureFixture[str], mistake_name: str
) -> None:
    good, bad, line = HAND_FILE_MISTAKES[mistake_name]
    text = Path(PARALLEL_GRIPPER_FILE).read_text()
    assert good in text
    Path("bad.toml").write_text(text.replace(good, bad, 1))
    assert main(["config", "check", "--hand", "bad.toml"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert any(line in error_line for error_line in lines), lines
    # A missing key for a joint type and an unnecessary key for a joint type are separate mistakes.
    assert len(lines) <= 1 or mistake_name in ("no types", "revolute joints", "a misspelt key"), (
        lines
    )


def test_a_coordinate_moves_joints_of_one_type(
    gripper_hand_files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (
        Path(MIXED_GRIPPER_FILE)
        .read_text()
        .replace("joint_axis = [[", "coupling = [[1.0], [10.0]]\njoint_axis = [[")
    )
    Path("bad.toml").write_text(text)
    assert (
        "coupling: column 0 moves revolute and prismatic joints; expected joints of one type"
        in refusal_line(capsys, "config", "check", "--hand", "bad.toml")
    )


@pytest.mark.parametrize("hand_file", [PARALLEL_GRIPPER_FILE, MIXED_GRIPPER_FILE])
@pytest.mark.parametrize("format_option", ["--urdf", "--mjcf"])
def test_an_exported_hand_has_the_same_joints_after_its_import(
    gripper_hand_files: Path, capsys: pytest.CaptureFixture[str], hand_file: str, format_option: str
) -> None:
    assert (
        main(["config", "export", format_option, "--hand", hand_file, "--output", "out.xml"]) == 0
    )
    words = ("--springs", "none", "--tendons", "each", "--output", "mine.toml")
    assert main(["config", "init", "--yes", format_option, "out.xml", *words]) == 0
    capsys.readouterr()
    text = Path("mine.toml").read_text()
    hand = load_hand(hand_file)
    for digit in hand.digit:
        assert f'name = "{digit.name}"' in text
    assert text.count('"prismatic"') == hand.is_prismatic.sum()
    for key in ("joint_min_m", "joint_max_m", "excursion_ratio"):
        assert key in text
    limits = [digit.joint_max_m for digit in hand.digit]
    for limit in limits:
        assert f"joint_max_m = [{limit[0]}]" in text


@pytest.mark.parametrize(
    ("angle_text", "expected_message"),
    [
        ("left = 40", "40 mm for left; expected 0 to 28 mm"),
        ("left_j1 = 29", "29 mm for left_j1; expected 0 to 28 mm"),
    ],
)
def test_positions_of_a_task_are_in_mm(
    gripper_hand_files: Path,
    capsys: pytest.CaptureFixture[str],
    angle_text: str,
    expected_message: str,
) -> None:
    Path("task.toml").write_text(
        f'schema = 1\nname = "t"\n[[phase]]\nkind = "move"\nangle_deg = {{ {angle_text} }}\nduration_s = 1.0\n'
    )
    words = (
        "demo",
        "--lockstep",
        "--dry-run",
        "--hand",
        PARALLEL_GRIPPER_FILE,
        "--task",
        "task.toml",
    )
    assert expected_message in refusal_line(capsys, *words)


def test_a_fast_move_of_a_prismatic_joint_is_refused_in_mm(
    gripper_hand_files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("task.toml").write_text(
        'schema = 1\nname = "t"\n[[phase]]\nkind = "move"\nangle_deg = { left = 28 }\nduration_s = 0.2\n'
    )
    words = (
        "demo",
        "--lockstep",
        "--dry-run",
        "--hand",
        PARALLEL_GRIPPER_FILE,
        "--task",
        "task.toml",
    )
    assert "left may have 28 mm to go, at 122.2 mm/s" in refusal_line(capsys, *words)


def test_identification_refuses_prismatic_joints(
    gripper_hand_files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refusal_line(
        capsys, "identify", "--hand", PARALLEL_GRIPPER_FILE, "--lockstep", "--dry-run"
    )
    assert "digit left: a prismatic joint, which is not identified yet; expected load cells" in line


def test_the_schema_2_file_and_its_content_are_the_same_hand(gripper_hand_files: Path) -> None:
    for name in (PARALLEL_GRIPPER_FILE, MIXED_GRIPPER_FILE):
        hand = load_hand(name)
        Path("whole.toml").write_text(hand.to_toml())
        reloaded_hand = load_hand("whole.toml")
        assert reloaded_hand.identity == hand.identity
        for digit, other_digit in zip(
            DigitModel.digit_models_of_hand(hand),
            DigitModel.digit_models_of_hand(reloaded_hand),
            strict=True,
        ):
            np.testing.assert_array_equal(digit.table, other_digit.table)


def test_encoders_of_prismatic_joints_alone_need_no_angle_noise() -> None:
    """Reproduce a defect: `joint_noise_rad` was required although only prismatic joints had encoders."""
    content = copy.deepcopy(read_toml(HAND_FILE_FOLDER / PARALLEL_GRIPPER_FILE))
    content["sensor_node"] |= {"joints": "all", "joint_decimation": 1, "joint_noise_m": 1e-5}
    content["sensor_node"].pop("joint_noise_rad", None)
    assert validate_content(content)[1] == []
    content = copy.deepcopy(read_toml(HAND_FILE_FOLDER / MIXED_GRIPPER_FILE))
    content["sensor_node"] |= {"joints": "all", "joint_decimation": 1, "joint_noise_m": 1e-5}
    content["sensor_node"].pop("joint_noise_rad", None)
    assert [mistake.where for mistake in validate_content(content)[1]] == [
        "sensor_node.joint_noise_rad"
    ]


def test_the_truth_file_names_the_unit_of_each_joint() -> None:
    """Reproduce a defect: the unit of a prismatic joint was rad."""
    hand = simulated_hand(HAND_FILE_FOLDER / MIXED_GRIPPER_FILE)
    units = dict(truth_columns(Plant(hand, load_scene("none"))))
    assert (units["q/jaw_j1"], units["dq/jaw_j1"]) == ("m", "m/s")
    assert (units["q/finger_j2"], units["dq/finger_j2"]) == ("rad", "rad/s")


def test_a_design_out_of_bounds_is_no_start_of_a_search() -> None:
    """Reproduce a defect: `tune search` crashed, because a designed force was out of its bounds."""
    hand = load_hand(HAND_FILE_FOLDER / MIXED_GRIPPER_FILE)
    gains = Gains.model_validate({"filter": {"encoder_noise_counts": 3.0}})
    model = HandModel.from_hand(hand, gains, 500.0)
    with pytest.raises(ValueError, match="motion_force_N"):
        design_gains(model, (linear_factors({}),)).as_weights()
    assert _designed_gains(hand, gains, 500.0, ({},)) == ()


@pytest.mark.parametrize("seed", range(5) if NIGHTLY else [0])
def test_fingers_of_unlike_actuation_grasp_in_their_first_demo(
    work_folder: Path, capsys: pytest.CaptureFixture[str], seed: int
) -> None:
    """Reproduce a defect: with one force for all digits, the fingers that antagonists open oscillated (N14b).

    A slide, a finger with an extensor, and a finger of four joints without load cells oppose each
    other. A new user wrote the hand file.
    """
    hand_file = HAND_FILE_FOLDER / "unlike_fingers.toml"
    words = ["--hand", str(hand_file), "--seed", str(seed), "--json"]
    assert main(["demo", "--lockstep", *words]) == 0
    output = capsys.readouterr()
    # One notice names the reduced forces, and one names a finger for which no force is small enough.
    assert "anta_flex" in output.err
    assert "leave long_base a gain margin" in output.err
    result = json.loads(output.out)
    assert result["table_sunk_mm"] > 50.0
    assert result["object_slid_mm"] < MAX_SLIP_MM
