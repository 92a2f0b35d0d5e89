"""Teleoperators that need no hardware: the keys of a terminal, and a recorded run."""

import os
import select
import sys
import termios
import time
import tty
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.teleoperators.teleoperator import Teleoperator
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_handctl.config_handctl import HandctlKeyboardConfig, HandctlLogConfig
from lerobot_robot_handctl.names import named

from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.log.export.element_names import position_names
from handctl.log.read.hand_in_log import prismatic_joints
from handctl.log.read.reader import RunLog

CLOSE, OPEN, OPEN_ALL = "qwertyuiop", "asdfghjkl;", " "
"""Keys that close the digits, and keys that open the digits, in the order of the hand file.

The key in ``OPEN_ALL`` opens all digits.
"""


class Leader(Teleoperator):
    """Base class of the teleoperators.

    A teleoperator of handctl commands the joints of a hand. A teleoperator has neither force
    feedback nor calibration.
    """

    names: tuple[str, ...]

    @cached_property
    def action_features(self) -> dict[str, Any]:
        """Return the names and types of the elements of an action: a position for each joint."""
        return dict.fromkeys(self.names, float)

    @property
    def feedback_features(self) -> dict[str, Any]:
        """Return an empty mapping, because the teleoperator takes no feedback."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Return True after ``connect`` and before ``disconnect``."""
        return self._is_open

    @property
    def is_calibrated(self) -> bool:
        """Return True, because a teleoperator has nothing to calibrate."""
        return True

    _is_open = False

    def connect(self, calibrate: bool = True) -> None:
        """Connect the teleoperator, which begins to give actions."""
        if self._is_open:
            raise DeviceAlreadyConnectedError(f"{self} is connected")
        self._is_open = True

    def calibrate(self) -> None:
        """Do nothing, because a teleoperator has nothing to calibrate."""

    def configure(self) -> None:
        """Do nothing, because a teleoperator has no settings."""

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing, because the teleoperator takes no feedback."""

    def disconnect(self) -> None:
        """Disconnect the teleoperator, which stops giving actions."""
        self._check_open()
        self._is_open = False

    def _check_open(self) -> None:
        """Raise DeviceNotConnectedError if the teleoperator is not connected."""
        if not self._is_open:
            raise DeviceNotConnectedError(f"{self} is not connected")


class HandctlKeyboard(Leader):
    """Teleoperator that reads keys from the standard input.

    Each pressed key closes or opens a digit by the angle ``step_deg``.
    """

    config_class = HandctlKeyboardConfig
    name = "handctl_keyboard"

    def __init__(self, config: HandctlKeyboardConfig) -> None:
        """Load the description of the hand."""
        super().__init__(config)
        hand = load_hand(config.hand)
        self.names = position_names(hand.joints, hand.prismatic_joints)
        self._digits = [
            (hand.digit_joints[name], hand.digit_named(name)) for name in hand.digit_names
        ]
        self._step = np.radians(config.step_deg)
        self._angles = np.zeros(len(self.names))
        self._settings: Any = None

    def connect(self, calibrate: bool = True) -> None:
        """Connect the teleoperator, and make the terminal deliver single keys.

        If the standard input is no terminal, leave it unchanged.
        """
        super().connect(calibrate)
        self._angles[:] = 0.0
        if sys.stdin.isatty():
            self._settings = termios.tcgetattr(0)
            tty.setcbreak(0)

    def get_action(self) -> dict[str, Any]:
        """Apply the keys pressed since the last call, and return the target angles of the joints [rad]."""
        self._check_open()
        for key in self._keys():
            self._press(key)
        return named(self.names, self._angles)

    def disconnect(self) -> None:
        """Disconnect the teleoperator, and restore the mode of the terminal."""
        super().disconnect()
        if self._settings is not None:
            termios.tcsetattr(0, termios.TCSADRAIN, self._settings)
            self._settings = None

    def _keys(self) -> str:
        """Return the keys that were pressed since the last call, without waiting."""
        return (
            os.read(0, 1024).decode("ascii", "ignore") if select.select([0], [], [], 0.0)[0] else ""
        )

    def _press(self, key: str) -> None:
        """Change the target angles of the digit that a key selects."""
        if key == OPEN_ALL:
            self._angles[:] = 0.0
        for keys, step in ((CLOSE, self._step), (OPEN, -self._step)):
            d = keys.find(key)
            if 0 <= d < len(self._digits):
                joints, digit = self._digits[d]
                low, high = digit.joint_limits
                moved = self._angles[joints] + step * digit.display_units.scale
                self._angles[joints] = np.clip(moved, low, high)


class HandctlLog(Leader):
    """Teleoperator that repeats the commanded angles of a recorded run with the recorded timing.

    The teleoperator uses only the part of the run in which the hand was active.
    """

    config_class = HandctlLogConfig
    name = "handctl_log"

    def __init__(self, config: HandctlLogConfig) -> None:
        """Read the commanded angles of the recorded run from its log.

        Raises:
            LogError: the file is not a log of handctl.
            ValueError: the hand was never active in the run.
        """
        super().__init__(config)
        with RunLog(Path(config.log)) as log:
            self.names = position_names(log.names("q"), prismatic_joints(log.header))
            active = log.mode == HandMode.ACTIVE
            goal = log.field("q_goal")[active]
            # The joints of a digit that was commanded to hold a tension have no commanded angles.
            # For joints without commanded angles, the teleoperator uses the estimated angles.
            self._angles = np.where(np.isnan(goal), log.field("q")[active], goal)
            self._times = log.times[active]
        if not len(self._times):
            raise ValueError(
                f"teleop.log: {config.log}: never active; expected a run that moved the hand"
            )
        self._times = self._times - self._times[0]
        self._start_s: float | None = None

    def connect(self, calibrate: bool = True) -> None:
        """Connect the teleoperator, and prepare to repeat the recorded run from its first angles.

        The repetition of the run starts at the first call of ``get_action``.
        """
        super().connect(calibrate)
        self._start_s = None

    def get_action(self) -> dict[str, Any]:
        """Return the joint angles that the recorded run commanded at the present time of the repetition [rad].

        After the end of the log, the function returns the last angles.
        """
        self._check_open()
        now = time.monotonic()
        self._start_s = now if self._start_s is None else self._start_s
        row = int(np.searchsorted(self._times, now - self._start_s, side="right")) - 1
        return named(self.names, self._angles[max(row, 0)])
