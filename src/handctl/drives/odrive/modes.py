"""ODrive in position control or velocity control, with the input mode passthrough.

The host sends the commands of a ramp, so the drive needs no trajectory generator. The message
Set_Limits contains the largest speed. The drive does not confirm mode and limits, so the host sends
both before each enable command. As in torque control, the host reads back the endpoints of watchdog
and torque limit.
"""

import math
from dataclasses import dataclass

from handctl.drives.contract import DriveState
from handctl.drives.drive_modes import DriveMode, MotionLimits, constructor_arguments
from handctl.drives.frame import Frame
from handctl.drives.motor_description import MotorDescription
from handctl.drives.odrive import codec
from handctl.drives.odrive.drive import OdriveDrive
from handctl.drives.signals import SignalTable
from handctl.errors import ConfigError

_CONTROL_MODES = {DriveMode.POSITION: codec.POSITION_MODE, DriveMode.VELOCITY: codec.VELOCITY_MODE}
"""Value of the control mode in Set_Controller_Mode for each mode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OdriveModeDrive(OdriveDrive):
    """ODrive in position control or velocity control.

    The command is a position [rad] or a velocity [rad/s] at the spool. The attribute
    ``command_limit`` has the same unit as the command.

    Attributes:
        mode: quantity that the drive controls.
    """

    mode: DriveMode

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        OdriveDrive.__post_init__(self)
        if self.mode == DriveMode.VELOCITY:
            message = codec.velocity_message(self.node_id, self.ratio, self.command_limit)
        else:
            message = codec.position_message(
                self.node_id, self.ratio, self.zero, self.command_limit
            )
        object.__setattr__(self, "command", SignalTable(message))

    @property
    def _control_mode(self) -> int:
        """Return the control mode in the message Set_Controller_Mode."""
        return _CONTROL_MODES[self.mode]

    def _command_at_rest(self, state: DriveState) -> float:
        """Return the command to the drive that causes no motion.

        In position control, the command at rest is the present position. In velocity control, the
        command at rest is zero.
        """
        return self.mode.command_at_rest(state.position)

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return no frames, because in position and velocity control, a torque is only a feedforward value."""
        return ()


def make_mode_drive(
    motor: MotorDescription, bus: int, mode: DriveMode, limits: MotionLimits
) -> OdriveModeDrive:
    """Create the drive object for a control mode, from a motor description.

    Raises:
        ConfigError: an option is unknown or wrong, or an ODrive does not have the mode.
    """
    if mode not in _CONTROL_MODES:
        raise ConfigError(mode.value, "mode", "position, velocity or torque for an ODrive")
    fields = constructor_arguments(OdriveDrive.from_motor(motor, bus))
    _, current = codec.decode_float_pair(fields["limits"]) or (0.0, 0.0)
    fields["limits"] = codec.encode_floats(limits.speed * abs(fields["ratio"]) / math.tau, current)
    fields["command_limit"] = (
        limits.speed if mode == DriveMode.VELOCITY else motor.position_range_rad
    )
    return OdriveModeDrive(**fields, mode=mode)
