"""Test the controller programs that handctl makes from episodes of a LeRobot dataset.

A hand follows an episode in lockstep. The tests check that handctl refuses an episode that the hand
cannot perform.
"""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from handctl.cli.main import main
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.errors import ConfigError
from handctl.hand.hand_loading import load_hand
from handctl.log.export.lerobot import export_lerobot
from handctl.log.read.reader import RunLog
from handctl.programs.playback import PlaybackProgram
from handctl.replay.dataset_episode import find_episode
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller

GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"
PERIOD_S = 0.002
JAMIA_HAND = load_hand("jamia")


@pytest.fixture
def exported_dataset(tmp_path: Path) -> Path:
    """Export a dataset with two episodes (a run with a fault, and a grasp), and return its folder."""
    with (
        RunLog(GOLDEN_FOLDER / "jamia-fault.mcap") as log,
        RunLog(GOLDEN_FOLDER / "jamia-grasp.mcap") as two,
    ):
        export_lerobot([log, two], tmp_path / "data")
    return tmp_path / "data"


def episode_actions(exported_dataset: Path, episode_index: int) -> np.ndarray:
    """Return the joint angles in the actions of an episode, with the shape (frames, joints) [rad]."""
    table = pq.read_table(exported_dataset / "data" / "chunk-000" / "file-000.parquet").to_pylist()
    return np.array(
        [
            row["action"][: len(JAMIA_HAND.joints)]
            for row in table
            if row["episode_index"] == episode_index
        ]
    )


def change_action(
    exported_dataset: Path, frame_index: int, joint_index: int, joint_angle: float
) -> None:
    """Change one joint angle in the action of one frame of a dataset."""
    path = exported_dataset / "data" / "chunk-000" / "file-000.parquet"
    table = pq.read_table(path)
    rows = table["action"].to_pylist()
    rows[frame_index][joint_index] = joint_angle
    at = table.column_names.index("action")
    pq.write_table(
        table.set_column(at, "action", pa.array(rows, pa.list_(pa.float32(), len(rows[0])))), path
    )


def sine_dataset(exported_dataset: Path) -> np.ndarray:
    """Replace the actions of the first episode by a smooth motion.

    Return the joint angles of the smooth motion, with the shape (frames, joints) [rad].
    """
    path = exported_dataset / "data" / "chunk-000" / "file-000.parquet"
    table = pq.read_table(path)
    rows = np.array(table["action"].to_pylist())
    frames = table["episode_index"].to_pylist().count(0)
    joints = len(JAMIA_HAND.joints)
    rows[:frames, :joints] = np.radians(30.0 - 20.0 * np.cos(np.arange(frames) / 200.0 * np.pi))[
        :, None
    ]
    at = table.column_names.index("action")
    pq.write_table(
        table.set_column(
            at, "action", pa.array(rows.tolist(), pa.list_(pa.float32(), rows.shape[1]))
        ),
        path,
    )
    return rows[:frames, :joints]


def test_the_curve_passes_through_the_actions(exported_dataset: Path) -> None:
    expected = sine_dataset(exported_dataset)
    recording = find_episode(exported_dataset, 0, JAMIA_HAND, PERIOD_S)
    rows = np.rint(np.arange(len(expected)) / 200.0 / PERIOD_S).astype(int)
    exact_value = np.abs(rows * PERIOD_S - np.arange(len(expected)) / 200.0) < 1e-9
    np.testing.assert_allclose(recording.q[rows[exact_value]], expected[exact_value], atol=1e-6)
    np.testing.assert_allclose(recording.dq[0], 0.0, atol=1e-9)
    slope = np.diff(recording.q, axis=0) / PERIOD_S
    np.testing.assert_allclose(
        slope[:-10], recording.dq[1:-10], atol=0.3
    )  # near the end of the episode, the motion stops


def test_a_hand_follows_an_episode_in_lockstep(exported_dataset: Path) -> None:
    jamia = HandModel.from_hand(JAMIA_HAND, Gains(), 1.0 / PERIOD_S)
    program = PlaybackProgram(find_episode(exported_dataset, 1, JAMIA_HAND, jamia.period, 200.0))
    controller = homed_controller(jamia, program)
    errors, faults = [], set()
    with SimulatorSettings("jamia", homed=True).begin_run(controller) as run:
        for _, out in run.run_ticks(40.0):
            faults |= {event.text for event in out.events if event.name == "fault"}
            if out.phase == "playback":
                true_angles = run.simulated_hand.world.plant.engine.q
                errors.append(
                    np.degrees(true_angles[:9] - out.telemetry.q_goal[:9])
                    .reshape(3, 3)
                    .mean(axis=1)
                )
        assert run.last_output is not None
        assert run.last_output.mode == HandMode.DONE
    assert faults == set()
    assert run.state.progress.finished
    assert len(errors) * jamia.period == pytest.approx(
        len(episode_actions(exported_dataset, 1)) / 200.0, abs=0.1
    )
    assert np.sqrt(np.mean(np.square(errors))) < 1.0


@pytest.mark.parametrize(
    ("joint_angle", "expected_message"),
    [
        (2.5, "143.239 deg for index_j1 in frame 7; expected 0 to 100 deg"),
        (float("nan"), "nan deg for index_j1 in frame 7"),
        (float("inf"), "inf deg for index_j1 in frame 7"),
        (1.5, "index_j1 with .* deg/s after .* s; expected at most 700 deg/s"),
    ],
)
def test_an_angle_or_a_speed_out_of_range_is_refused(
    exported_dataset: Path, joint_angle: float, expected_message: str
) -> None:
    sine_dataset(exported_dataset)
    change_action(exported_dataset, 7, 0, joint_angle)
    with pytest.raises(ConfigError, match=expected_message):
        find_episode(exported_dataset, 0, JAMIA_HAND, PERIOD_S)


def test_an_estimate_just_beyond_the_range_is_clipped(exported_dataset: Path) -> None:
    sine_dataset(exported_dataset)
    change_action(exported_dataset, 0, 0, -0.01)
    assert find_episode(exported_dataset, 0, JAMIA_HAND, PERIOD_S, 100.0).q[0, 0] == 0.0


def test_jumps_become_ramps_by_a_speed(exported_dataset: Path) -> None:
    with pytest.raises(ConfigError, match="at most 700 deg/s, or a limit by --speed"):
        find_episode(exported_dataset, 1, JAMIA_HAND, PERIOD_S)
    slow = np.degrees(find_episode(exported_dataset, 1, JAMIA_HAND, PERIOD_S, 100.0).dq)
    assert 90.0 < np.abs(slow).max() < 140.0, "a spline rounds the corners"
    with pytest.raises(ConfigError, match="--speed: 900 deg/s; expected above 0, at most 700"):
        find_episode(exported_dataset, 1, JAMIA_HAND, PERIOD_S, 900.0)


def edit_dataset_info(exported_dataset: Path, **changed_fields: object) -> None:
    """Change fields in the file that describes a dataset."""
    path = exported_dataset / "meta" / "info.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changed_fields))


@pytest.mark.parametrize(
    ("changed_fields", "expected_message"),
    [
        ({"codebase_version": "v2.1"}, r"version 'v2.1'; expected a LeRobot dataset \(3.0\)"),
        ({"fps": 0}, "fps: 0; expected 1 to 1000 Hz"),
        ({"fps": "50"}, "fps: '50'; expected 1 to 1000 Hz"),
        ({"features": {}}, "features.action.names: no names"),
        ({"features": {"action": {"names": ["a"]}}}, "1 names for 15 values"),
        ({"data_path": "../{x}.parquet"}, "data_path"),
        ({"data_path": None}, "cannot be read"),
    ],
)
def test_a_wrong_description_is_refused(
    exported_dataset: Path, changed_fields: dict[str, object], expected_message: str
) -> None:
    edit_dataset_info(exported_dataset, **changed_fields)
    with pytest.raises(ConfigError, match=expected_message):
        find_episode(exported_dataset, 0, JAMIA_HAND, PERIOD_S)


def test_a_damaged_dataset_is_refused(exported_dataset: Path) -> None:
    with pytest.raises(ConfigError, match="no episode 2; expected 0 to 1"):
        find_episode(exported_dataset, 2, JAMIA_HAND, PERIOD_S)
    with pytest.raises(
        ConfigError, match=r"no thumb_j1.pos_rad|no .*pos_rad; expected an angle for each joint of"
    ):
        find_episode(exported_dataset, 0, load_hand("t42"), PERIOD_S)
    data = exported_dataset / "data" / "chunk-000" / "file-000.parquet"
    whole_content = data.read_bytes()
    for content in (b"", whole_content[:-100], b"PAR1" + whole_content[4:100] + b"PAR1"):
        data.write_bytes(content)
        with pytest.raises(ConfigError, match=r"file-000.parquet: cannot be read"):
            find_episode(exported_dataset, 0, JAMIA_HAND, PERIOD_S)
    (exported_dataset / "meta" / "info.json").write_text("{")
    with pytest.raises(ConfigError, match=r"info.json: is no JSON"):
        find_episode(exported_dataset, 0, JAMIA_HAND, PERIOD_S)
    with pytest.raises(ConfigError, match="No such file or directory"):
        find_episode(exported_dataset / "x", 0, JAMIA_HAND, PERIOD_S)


def test_run_checks_the_dataset_before_it_opens_a_bus(
    exported_dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "--hand", "jamia", "--bus", "local:no", "--dry-run"]
    assert (
        main([*words, "--dataset", str(exported_dataset), "--episode", "1", "--speed", "200"]) == 0
    )
    assert main([*words, "--episode", "1"]) == 2
    assert "only with --dataset" in capsys.readouterr().err
    assert main([*words, "--dataset", str(exported_dataset), "--episode", "5"]) == 2
    assert "no episode 5; expected 0 to 1" in capsys.readouterr().err
