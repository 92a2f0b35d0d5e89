"""Configurations. LeRobot derives the class of a device from the name of its configuration, without ``Config``."""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig


@RobotConfig.register_subclass("handctl")
@dataclass(kw_only=True)
class HandctlRobotConfig(RobotConfig):
    """Settings of a hand.

    Attributes:
        hand: packaged name or file of the hand.
        bus: bus, as ``handctl run --bus``.
        rate_Hz: expected rate of the actions, measured with the clock of the hand.
        speed_deg_s: largest rate of a joint's target.
        options: further options of ``handctl run``.
        cameras: cameras of LeRobot.
    """

    hand: str = "jamia"
    bus: str = "local:lab"
    rate_Hz: float = 50.0
    speed_deg_s: float = 120.0
    options: list[str] = field(default_factory=list)
    cameras: dict[str, CameraConfig] = field(default_factory=dict)


@TeleoperatorConfig.register_subclass("handctl_keyboard")
@dataclass(kw_only=True)
class HandctlKeyboardConfig(TeleoperatorConfig):
    """Settings of the keyboard.

    Attributes:
        hand: packaged name or file of the hand.
        step_deg: motion for each key.
    """

    hand: str = "jamia"
    step_deg: float = 2.0


@TeleoperatorConfig.register_subclass("handctl_log")
@dataclass(kw_only=True)
class HandctlLogConfig(TeleoperatorConfig):
    """Settings of a recorded run as leader.

    Attributes:
        log: log of the run.
    """

    log: str = ""
