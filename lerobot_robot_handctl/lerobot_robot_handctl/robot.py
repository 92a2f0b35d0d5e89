"""Connect a hand of handctl to LeRobot as a robot."""

import threading
import time
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np
from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots.robot import Robot
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot_robot_handctl.config_handctl import HandctlRobotConfig
from lerobot_robot_handctl.names import TENSION, named, positions_of

import handctl
from handctl.client import HandClient, TargetStream
from handctl.hand.hand_loading import load_hand
from handctl.log.export.element_names import position_names

PAUSE_S = 0.4
"""Time without an action after which the robot closes its stream of targets and the hand comes to rest [s]."""


class HandctlRobot(Robot):
    """Robot of LeRobot whose hand follows actions.

    The robot sends the actions to the controller as a stream of targets.

    If no actions arrive for some time, a thread of the robot closes the stream. The thread never
    sends targets. If the whole program hangs, the controller gets no targets, so it holds the hand
    at first, and later relaxes the hand.
    """

    config_class = HandctlRobotConfig
    name = "handctl"

    def __init__(self, config: HandctlRobotConfig) -> None:
        """Load the description of the hand, without connecting to it."""
        super().__init__(config)
        self.config = config
        self.description = load_hand(config.hand)
        self._names = position_names(self.description.joints, self.description.prismatic_joints)
        self.cameras = make_cameras_from_configs(config.cameras)
        self._low, self._high = self.description.joint_limits
        # For the speed limit, 10 mm of a prismatic joint correspond to 1 rad of a revolute joint.
        scale = self.description.display_units.scale
        self._step = np.radians(config.speed_deg_s) * scale / config.rate_Hz
        self._hand: HandClient | None = None
        self._stream: TargetStream | None = None
        self._sent: Any = None
        self._sent_s = 0.0
        self._lock = threading.Lock()
        self._ended = threading.Event()

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """Return the names and types of the elements of an observation: joint angles, tensions and camera images."""
        tensions = {f"{tendon}{TENSION}": float for tendon in self.description.tendon_names}
        pictures = {
            name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()
        }
        return {**dict.fromkeys(self._names, float), **tensions, **pictures}

    @cached_property
    def action_features(self) -> dict[str, Any]:
        """Return the names and types of the elements of an action: a position for each joint."""
        return dict.fromkeys(self._names, float)

    @property
    def is_connected(self) -> bool:
        """Return True if the hand accepts actions."""
        return self._hand is not None

    @property
    def is_calibrated(self) -> bool:
        """Return True, because handctl commissions a hand itself."""
        return True

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the controller on the bus.

        If no controller runs on the bus, start a controller, which commissions and arms the hand.
        """
        if self._hand is not None:
            raise DeviceAlreadyConnectedError(f"{self} is connected")
        hand = handctl.connect(self.config.hand, self.config.bus, *self.config.options).open()
        try:
            if hand.description.joints != self.description.joints:
                expected_hand = f"the hand on the bus, {hand.description.name}"
                raise ValueError(f"robot.hand: {self.config.hand}; expected {expected_hand}")
            for camera in self.cameras.values():
                camera.connect()
        except BaseException:
            hand.close()
            raise
        self._hand = hand
        self._sent = None
        self._ended.clear()
        threading.Thread(target=self._close_in_pauses, daemon=True).start()

    def calibrate(self) -> None:
        """Do nothing. The command ``handctl commission`` calibrates a hand."""

    def configure(self) -> None:
        """Do nothing, because the controller gets its settings from the hand file."""

    def get_observation(self) -> dict[str, Any]:
        """Return the latest observation: joint angles [rad], tensions [N] and camera images."""
        observation = self._connected().observe()
        tendons = self.description.tendon_names
        tensions = {
            f"{name}{TENSION}": float(value)
            for name, value in zip(tendons, observation.tension_N, strict=True)
        }
        pictures = {name: camera.async_read() for name, camera in self.cameras.items()}
        return {**named(self._names, observation.q_rad), **tensions, **pictures}

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        """Limit the angles of an action to the ranges and speed limits of the joints.

        Send the limited angles to the hand, and return them.
        """
        hand = self._connected()
        expected_positions = np.clip(positions_of(self._names, action), self._low, self._high)
        with self._lock:
            if self._stream is None:
                self._sent = np.clip(hand.observe().q_rad, self._low, self._high)
                self._stream = hand.stream(self.config.rate_Hz, "joint", unit="rad")
            target = self._sent + np.clip(expected_positions - self._sent, -self._step, self._step)
            self._stream.send(target)
            self._sent = target
            self._sent_s = time.monotonic()
        return named(self._names, target)

    def disconnect(self) -> None:
        """Close the stream of targets and the client of the hand.

        If the robot has started the controller, the controller relaxes and disarms the hand after
        the client is closed.
        """
        hand = self._connected()
        self._ended.set()
        with self._lock:
            stream, self._stream = self._stream, None
            self._hand = None
        try:
            if stream is not None:
                # the run has ended, and ``close`` raises an error with the reason
                with suppress(handctl.HandctlError):
                    stream.close()
            hand.close()
        finally:
            for camera in self.cameras.values():
                camera.disconnect()

    def _connected(self) -> HandClient:
        """Return the client of the hand.

        Raises:
            DeviceNotConnectedError: the robot is not connected.
        """
        if self._hand is None:
            raise DeviceNotConnectedError(f"{self} is not connected")
        return self._hand

    def _close_in_pauses(self) -> None:
        """Close the stream of targets whenever no action has come for `PAUSE_S`.

        The method runs in a thread until the robot disconnects.
        """
        while not self._ended.wait(PAUSE_S / 4):
            with self._lock:
                if self._stream is not None and time.monotonic() - self._sent_s > PAUSE_S:
                    stream, self._stream = self._stream, None
                    with suppress(
                        handctl.HandctlError
                    ):  # the run has ended, and the next action raises an error with the reason
                        stream.close()
