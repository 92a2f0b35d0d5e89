"""Test handctl's plug-in for LeRobot with LeRobot's own scripts and dataset loader.

The tests are skipped if LeRobot is not installed.
"""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.core.tick_types import HandMode
from handctl.log.export.lerobot import export_lerobot
from handctl.log.read.reader import RunLog
from tests.lerobot.conftest import TIME_SCALE
from tests.runtime.processes import LOCAL_BUS, run_handctl

pytestmark = pytest.mark.skipif(
    find_spec("lerobot") is None, reason="needs LeRobot, see tests/lerobot/test_environment.py"
)
GOLDEN_FOLDER = Path(__file__).parents[2] / "logs" / "golden"
DATASET_FRAMES_PER_S = round(50 * TIME_SCALE)
EPISODE_S = 4.0
EPISODE_COUNT = 2


def run_script(script_name: str, *script_arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run a script of LeRobot, and return its exit code and output."""
    command = [sys.executable, "-m", f"lerobot.scripts.lerobot_{script_name}", *script_arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=400, check=False)
    assert result.returncode == 0, result.stderr[-3000:]
    return result


def fault_texts(run_log: RunLog) -> list[str]:
    """Return the texts of those faults in a log that made the hand relax.

    The function ignores faults whose reaction is less severe than relaxing. Such faults also occur
    on a busy machine, because frames and actions are late there.
    """
    return [
        row.event.text
        for row in run_log.events
        if row.event.name == "fault" and row.event.level == "error"
    ]


@pytest.mark.realtime
def test_recorded_episodes_can_be_loaded_replayed_and_run(robot_options, work_folder) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    assert main(["-q", "demo", "--lockstep", "--log", "leader.mcap"]) == 0
    robot = ["--robot.type=handctl", f"--robot.bus={LOCAL_BUS}"]
    robot_options_argument = "--robot.options=" + json.dumps(robot_options)
    data = ["--dataset.repo_id=me/hand", "--dataset.root=data"]
    run_script(
        "record", *robot, robot_options_argument, "--teleop.type=handctl_log", "--teleop.log=leader.mcap", *data,
        "--dataset.single_task=close the hand", f"--dataset.num_episodes={EPISODE_COUNT}",
        f"--dataset.fps={DATASET_FRAMES_PER_S}",
        f"--dataset.episode_time_s={EPISODE_S}", "--dataset.reset_time_s=1", "--dataset.video=false",
        "--dataset.push_to_hub=false", "--play_sounds=false",
    )  # fmt: skip
    with RunLog(Path("run.mcap")) as log:
        assert not fault_texts(log)
    dataset = LeRobotDataset("me/hand", root=work_folder / "data")
    assert (dataset.num_episodes, dataset.fps) == (EPISODE_COUNT, DATASET_FRAMES_PER_S)
    assert dataset.num_frames > 0.8 * EPISODE_COUNT * EPISODE_S * DATASET_FRAMES_PER_S
    assert dataset.features["action"]["names"][0] == "index_j1.pos_rad"
    frame = dataset[0]
    assert frame["task"] == "close the hand"
    assert frame["observation.state"].shape == (15,)
    actions = np.array([dataset[i]["action"].numpy() for i in range(dataset.num_frames)])
    assert np.ptp(np.degrees(actions[:, 0])) > 10.0

    replay_options = json.dumps([word.replace("run.mcap", "replay.mcap") for word in robot_options])
    run_script(
        "replay",
        *robot,
        f"--robot.options={replay_options}",
        *data,
        "--dataset.episode=0",
        "--play_sounds=false",
    )
    with RunLog(Path("replay.mcap")) as log:
        assert not fault_texts(log)
        is_active = log.mode == HandMode.ACTIVE
        max_angle_goal_deg = np.degrees(
            np.nanmax(log.field("q_goal")[is_active][:, :3].mean(axis=1))
        )
    first_actions = actions[: int(dataset.meta.episodes[0]["length"])]
    # The joints of a finger are coupled, so all of them get the same angle. The common angle of
    # coupled joints is the angle nearest to the recorded angles.
    expected = np.degrees(first_actions[:, :3].mean(axis=1).max())
    assert max_angle_goal_deg == pytest.approx(expected, abs=2.0)

    words = [word.replace("run.mcap", "again.mcap") for word in robot_options]
    result = run_handctl(
        "run", "--hand", "jamia", "--bus", LOCAL_BUS, "--dataset", "data", "--speed", "200", *words
    )
    assert result.returncode == 0, result.stderr
    with RunLog(Path("again.mcap")) as log:
        assert not fault_texts(log)
        phase_names = np.array([change.name for change in log.phases])
        assert "playback" in phase_names
        replayed_angles_deg = np.degrees(
            np.nanmax(log.field("q")[log.mode == HandMode.ACTIVE][:, :3].mean(axis=1))
        )
    assert replayed_angles_deg == pytest.approx(expected, abs=4.0)


def test_the_loader_reads_exported_episodes_with_statistics(tmp_path) -> None:
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    with (
        RunLog(GOLDEN_FOLDER / "jamia-fault.mcap") as log,
        RunLog(GOLDEN_FOLDER / "jamia-grasp.mcap") as two,
    ):
        frames = export_lerobot([log, two, log], tmp_path / "data")
    dataset = LeRobotDataset("me/exported", root=tmp_path / "data")
    assert (dataset.num_frames, dataset.num_episodes, dataset.fps) == (frames, 3, 200)
    for i in (0, frames // 2, frames - 1):
        frame = dataset[i]
        assert torch.isfinite(frame["observation.state"]).all()
        assert frame["action"].shape == (15,)
        assert int(frame["index"]) == i
        assert frame["task"]
    assert bool(dataset[frames - 1]["next.done"])
    action_statistics = dataset.meta.stats["action"]
    all_actions = np.array(dataset.hf_dataset["action"])
    np.testing.assert_allclose(action_statistics["mean"], all_actions.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(action_statistics["std"], all_actions.std(axis=0), atol=1e-4)


def test_the_loader_takes_a_part_and_windows_of_time(tmp_path) -> None:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    with (
        RunLog(GOLDEN_FOLDER / "jamia-fault.mcap") as log,
        RunLog(GOLDEN_FOLDER / "jamia-grasp.mcap") as two,
    ):
        export_lerobot([log, two], tmp_path / "data")
    steps = [0.0, 0.005, 0.01]
    dataset = LeRobotDataset(
        "me/exported", root=tmp_path / "data", episodes=[1], delta_timestamps={"action": steps}
    )
    assert dataset.num_episodes == 1
    assert {int(dataset[i]["episode_index"]) for i in (0, len(dataset) - 1)} == {1}
    assert dataset[0]["action"].shape == (3, 15)


def test_episodes_split_by_lerobot(tmp_path) -> None:
    from lerobot.datasets.dataset_tools import split_dataset
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    with (
        RunLog(GOLDEN_FOLDER / "jamia-fault.mcap") as log,
        RunLog(GOLDEN_FOLDER / "jamia-grasp.mcap") as two,
    ):
        export_lerobot([log, two], tmp_path / "data")
    dataset = LeRobotDataset("me/exported", root=tmp_path / "data")
    dataset_by_split = split_dataset(
        dataset, {"train": [0], "val": [1]}, output_dir=tmp_path / "parts"
    )
    assert {
        name: dataset_of_split.num_episodes for name, dataset_of_split in dataset_by_split.items()
    } == {"train": 1, "val": 1}
    episode = dataset.meta.episodes[1]
    actions_of_episode = np.array(dataset.hf_dataset["action"])[
        episode["dataset_from_index"] : episode["dataset_to_index"]
    ]
    np.testing.assert_allclose(
        dataset_by_split["val"].meta.stats["action"]["mean"],
        actions_of_episode.mean(axis=0),
        atol=1e-4,
    )
