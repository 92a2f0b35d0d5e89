"""Position and velocity control in the drive: the controlled quantity, and the drive's own limits.

A drive of these modes is a ``contract.Drive`` whose command is a position [rad] or a velocity
[rad/s] at the spool instead of a torque. ``torque_limit`` is then the largest command in that unit.
The torque limit, watchdog and read-back of the torque mode stay in force.
"""

import enum
import math
from dataclasses import fields
from typing import Any, NamedTuple

from handctl.errors import ConfigError


class DriveMode(enum.Enum):
    """Quantity that the drive controls."""

    TORQUE = "torque"
    POSITION = "position"
    VELOCITY = "velocity"
    FORCE_POSITION = "force-position"
    """Position with a current limit in each command (Damiao)."""

    def rest(self, position: float) -> float:
        """Return the command that causes no motion at a position: the position itself, or zero otherwise."""
        return position if self in (DriveMode.POSITION, DriveMode.FORCE_POSITION) else 0.0


COMMAND_UNITS = {
    DriveMode.TORQUE: "N m",
    DriveMode.POSITION: "rad",
    DriveMode.VELOCITY: "rad/s",
    DriveMode.FORCE_POSITION: "rad",
}
"""Unit of the command at the spool."""


class MotionLimits(NamedTuple):
    """Limits that the drive enforces as well as the host.

    Attributes:
        speed: largest speed [rad/s at the spool].
        acceleration: largest acceleration [rad/s2 at the spool].
    """

    speed: float
    acceleration: float


def check_limits(limits: MotionLimits) -> None:
    """Check the limits.

    Raises:
        ConfigError: a limit is not finite and positive.
    """
    for name, value in zip(limits._fields, limits, strict=True):
        if not 0.0 < value < math.inf:
            raise ConfigError(f"{value:g}", name, "more than 0")


def init_fields(drive: Any) -> dict[str, Any]:
    """Return the constructor's arguments of a drive, to build a drive of another mode from it."""
    return {field.name: getattr(drive, field.name) for field in fields(drive) if field.init}
