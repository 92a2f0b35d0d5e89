"""Drive modes in which the drive itself controls its position or velocity.

A drive in position mode or velocity mode is a ``contract.Drive``. The command to the drive is not a
torque, but a position [rad] or a velocity [rad/s] at the spool. The attribute ``command_limit`` of
the drive has the unit of the command. The torque limit, the watchdog and the read-back are the same
as in torque mode.
"""

import enum
import math
from dataclasses import fields
from typing import Any, NamedTuple

from handctl.errors import ConfigError


class DriveMode(enum.Enum):
    """Quantity that the drive itself controls."""

    TORQUE = "torque"
    POSITION = "position"
    VELOCITY = "velocity"
    FORCE_POSITION = "force-position"
    """The drive controls the position. Each command also contains a current limit (Damiao drives)."""

    def command_at_rest(self, position: float) -> float:
        """Return the command to the drive that causes no motion.

        In the position modes, the command at rest is the present position. In the other modes, the
        command at rest is zero.
        """
        return position if self in (DriveMode.POSITION, DriveMode.FORCE_POSITION) else 0.0


COMMAND_UNITS = {
    DriveMode.TORQUE: "N m",
    DriveMode.POSITION: "rad",
    DriveMode.VELOCITY: "rad/s",
    DriveMode.FORCE_POSITION: "rad",
}
"""Unit of the command in each mode. The unit of a command refers to the spool."""


class MotionLimits(NamedTuple):
    """Limits of a motion, which both the drive and the host enforce.

    Attributes:
        speed: largest speed [rad/s at the spool].
        acceleration: largest acceleration [rad/s2 at the spool].
    """

    speed: float
    acceleration: float


def check_limits(limits: MotionLimits) -> None:
    """Check the limits of a motion.

    Raises:
        ConfigError: a limit is not finite and positive.
    """
    for name, value in zip(limits._fields, limits, strict=True):
        if not 0.0 < value < math.inf:
            raise ConfigError(f"{value:g}", name, "more than 0")


def constructor_arguments(drive: Any) -> dict[str, Any]:
    """Return the constructor arguments of a drive, to construct the same drive in another mode."""
    return {field.name: getattr(drive, field.name) for field in fields(drive) if field.init}
