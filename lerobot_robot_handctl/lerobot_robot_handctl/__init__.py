"""Provide hands of handctl as robots of LeRobot, and two teleoperators.

LeRobot finds the package ``lerobot_robot_handctl`` by its name.
"""

from lerobot_robot_handctl.config_handctl import (
    HandctlKeyboardConfig,
    HandctlLogConfig,
    HandctlRobotConfig,
)
from lerobot_robot_handctl.leaders import HandctlKeyboard, HandctlLog
from lerobot_robot_handctl.robot import HandctlRobot

__all__ = [
    "HandctlKeyboard",
    "HandctlKeyboardConfig",
    "HandctlLog",
    "HandctlLogConfig",
    "HandctlRobot",
    "HandctlRobotConfig",
]
