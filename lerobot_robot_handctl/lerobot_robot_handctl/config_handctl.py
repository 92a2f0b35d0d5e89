"""Configurations of the LeRobot robot and teleoperators that use a hand of handctl.

LeRobot finds the class of a robot or teleoperator in this way: It removes ``Config`` from the name
of the configuration class.
"""

from dataclasses import dataclass, field

from lerobot.cameras import CameraConfig
from lerobot.robots.config import RobotConfig
from lerobot.teleoperators.config import TeleoperatorConfig


@RobotConfig.register_subclass("handctl")
@dataclass(kw_only=True)
class HandctlRobotConfig(RobotConfig):
    """Settings of a hand that LeRobot uses as a robot.

    Attributes:
        hand: name of a packaged hand, or path of a hand file.
        bus: bus of the hand, as for ``handctl run --bus``.
        rate_Hz: expected rate of the actions, measured with the clock of the hand.
        speed_deg_s: largest rate at which the target of a joint changes [deg/s].
        options: further options of ``handctl run``.
        cameras: camera configurations of LeRobot, by the name of the camera.
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
    """Settings of the keyboard as a teleoperator.

    Attributes:
        hand: name of a packaged hand, or path of a hand file.
        step_deg: angle by which a digit moves when one of its keys is pressed [deg].
    """

    hand: str = "jamia"
    step_deg: float = 2.0


@TeleoperatorConfig.register_subclass("handctl_log")
@dataclass(kw_only=True)
class HandctlLogConfig(TeleoperatorConfig):
    """Settings of a recorded run as a teleoperator.

    Attributes:
        log: path of the log of the run.
    """

    log: str = ""
