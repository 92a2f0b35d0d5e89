"""Test handctl's plug-in for LeRobot with LeRobot's own registry, base classes and script.

The tests are skipped if LeRobot is not installed.
"""

import os
import subprocess
import sys
import time
import tomllib
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from handctl.cli.main import main
from handctl.core.tick_types import HandMode
from handctl.log.read.reader import RunLog
from tests.lerobot.conftest import TIME_SCALE
from tests.runtime.processes import HOMED_HAND_OPTIONS, LOCAL_BUS

PLUGIN_FOLDER = Path(__file__).parents[2] / "lerobot_robot_handctl"
SKIP_REASON = (
    "needs lerobot and lerobot_robot_handctl in an environment of its own, "
    "see lerobot_robot_handctl/README.md"
)
NEEDS_LEROBOT = pytest.mark.skipif(find_spec("lerobot") is None, reason=SKIP_REASON)


def test_the_distribution_has_the_name_and_version_that_lerobot_and_users_look_for() -> None:
    project_table = tomllib.loads((PLUGIN_FOLDER / "pyproject.toml").read_text("utf-8"))["project"]
    assert project_table["name"] == "lerobot_robot_handctl"
    assert project_table["version"] == version("handctl")
    assert (PLUGIN_FOLDER / project_table["name"] / "__init__.py").is_file()
    assert HOMED_HAND_OPTIONS[0] == "--homed"


@NEEDS_LEROBOT
def test_lerobot_finds_robot_and_teleoperators() -> None:
    from lerobot.robots.config import RobotConfig
    from lerobot.robots.utils import make_robot_from_config
    from lerobot.teleoperators.config import TeleoperatorConfig
    from lerobot.utils.import_utils import register_third_party_plugins

    register_third_party_plugins()
    robot = make_robot_from_config(RobotConfig.get_choice_class("handctl")())
    assert len(robot.action_features) == 11
    assert set(robot.action_features) < set(robot.observation_features)
    assert "index_tendon.tension_N" in robot.observation_features
    assert {"handctl_keyboard", "handctl_log"} <= TeleoperatorConfig.get_known_choices().keys()


@NEEDS_LEROBOT
@pytest.mark.realtime
def test_a_robot_observes_follows_limits_and_rests_in_pauses(robot_options) -> None:
    from lerobot.utils.errors import DeviceNotConnectedError
    from lerobot_robot_handctl import HandctlRobot, HandctlRobotConfig

    robot = HandctlRobot(HandctlRobotConfig(bus=LOCAL_BUS, options=robot_options))
    with pytest.raises(DeviceNotConnectedError):
        robot.get_observation()
    robot.connect()
    try:
        observation = robot.get_observation()
        assert observation.keys() == robot.observation_features.keys()
        goal = dict.fromkeys(robot.action_features, 9.0)  # beyond the limits of all joints
        sent_action = robot.send_action({**goal, "index_tendon.tension_N": 5.0})
        assert sent_action.keys() == robot.action_features.keys()
        assert max(sent_action.values()) < np.radians(4.0), "at most 120 deg/s at 50 Hz"
        goal = {name: np.radians(20.0) for name in goal}
        for _ in range(40):
            robot.send_action(goal)
            time.sleep(0.02 / TIME_SCALE)
        time.sleep(1.5 / TIME_SCALE)  # the hand relaxes because the client sends no new targets
        observation = robot.get_observation()
        assert np.degrees([observation[name] for name in goal]).mean() == pytest.approx(
            20.0, abs=2.0
        )
        robot.send_action(goal)
        with pytest.raises(ValueError, match=r"no thumb_j2.pos_rad"):
            robot.send_action({name: 0.0 for name in goal if name != "thumb_j2.pos_rad"})
    finally:
        robot.disconnect()
    assert not robot.is_connected
    with RunLog(Path("run.mcap")) as log:
        assert not [row for row in log.events if row.event.text.startswith("I11b")]
        assert HandMode.RELAX in log.mode


@NEEDS_LEROBOT
def test_keys_close_and_open_digits() -> None:
    from lerobot_robot_handctl import HandctlKeyboard, HandctlKeyboardConfig

    reading, writing = os.pipe()
    stdin_copy = os.dup(0)
    os.dup2(reading, 0)
    try:
        keyboard = HandctlKeyboard(HandctlKeyboardConfig())
        keyboard.connect()
        os.write(writing, b"qqqwa!")
        action = keyboard.get_action()
        assert keyboard.get_action() == action
        angles = np.degrees(list(action.values()))
        np.testing.assert_allclose(angles, [4, 4, 4, 2, 2, 2, 0, 0, 0, 0, 0], atol=1e-9)
        os.write(writing, b" ")
        assert set(keyboard.get_action().values()) == {0.0}
        keyboard.disconnect()
    finally:
        os.dup2(stdin_copy, 0)
        for descriptor in (reading, writing, stdin_copy):
            os.close(descriptor)


@NEEDS_LEROBOT
@pytest.mark.realtime
def test_the_script_of_lerobot_teleoperates_the_hand_by_a_log(robot_options, work_folder) -> None:
    assert main(["-q", "demo", "--lockstep", "--log", "leader.mcap"]) == 0
    teleop_time_s = 6.0
    words = [
        "--robot.type=handctl", f"--robot.bus={LOCAL_BUS}", f"--robot.options={list(robot_options)}".replace("'", '"'),
        "--teleop.type=handctl_log", "--teleop.log=leader.mcap", f"--fps={round(50 * TIME_SCALE)}",
        f"--teleop_time_s={teleop_time_s}",
    ]  # fmt: skip
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_teleoperate", *words]
    result = subprocess.run(command, capture_output=True, text=True, timeout=280, check=False)
    assert result.returncode == 0, result.stderr[-2000:]
    with RunLog(Path("run.mcap")) as log, RunLog(Path("leader.mcap")) as leader_log:
        # The test ignores warnings. A busy machine causes, for example, warnings about late frames
        # and late actions.
        assert not [
            row.event.text
            for row in log.events
            if row.event.name == "fault" and row.event.level == "error"
        ]
        goal = np.degrees(np.nanmax(log.field("q_goal")[:, :9]))
        # In this test, the leader hand closes its fingers on an object. All coupled joints of a
        # finger of the follower hand get the same angle. The common angle of coupled joints is the
        # angle nearest to their angles in the leader hand.
        assert 20.0 < goal < np.degrees(leader_log.field("q").max()) + 1.0
