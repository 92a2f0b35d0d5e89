"""Damiao motor in position-velocity, velocity or force-position mode.

Register CTRL_MODE selects the mode. The registers of the ramps (ACC, DEC) and of the largest speed
(MAX_SPD) are written and read back before arming. MAX_SPD is read again while the motor is enabled.
The motor keeps the written ramps and the largest speed until it loses power. Source: Damiao
DM-J4310-2EC manual.

As in MIT mode, register TMAX must have its required value. The manual of the motor does not state
if TMAX limits the torque in modes other than MIT mode. Each command in force-position mode contains
a current limit.
"""

from dataclasses import dataclass

from handctl.drives.drive_modes import DriveMode, MotionLimits, constructor_arguments
from handctl.drives.frame import Frame
from handctl.drives.mit import codec
from handctl.drives.mit.drive import MitDrive
from handctl.drives.motor_description import MotorDescription
from handctl.drives.option_checks import checked_positive
from handctl.drives.signals import CyclicMessage, SignalTable
from handctl.errors import ConfigError

_CONTROL_MODES = {
    DriveMode.POSITION: codec.POSITION_MODE,
    DriveMode.VELOCITY: codec.VELOCITY_MODE,
    DriveMode.FORCE_POSITION: codec.FORCE_MODE,
}
"""Value of register CTRL_MODE for each mode."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MitModeDrive(MitDrive):
    """Damiao motor in a position mode or in velocity mode.

    The command is a position [rad] or a velocity [rad/s] at the spool.

    Attributes:
        mode: quantity that the motor controls.
        limits: largest speed and acceleration of the motor.
        fraction: current limit in force-position mode, as a fraction of the largest current of the
            motor.
    """

    mode: DriveMode
    limits: MotionLimits
    fraction: float = 1.0

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        MitDrive.__post_init__(self)
        object.__setattr__(self, "command", SignalTable(self._mode_command_message()))

    def _mode_command_message(self) -> CyclicMessage:
        """Return the signal table of the command in the drive's mode."""
        if self.mode == DriveMode.VELOCITY:
            return codec.velocity_message(
                self.node_id, self.limits.speed, self.direction, self.flags
            )
        last_fields = self.direction, self.zero, self.flags
        if self.mode == DriveMode.POSITION:
            return codec.position_message(
                self.node_id, self.ranges, self.limits.speed, *last_fields
            )
        limits = self.limits.speed, self.fraction
        return codec.force_position_message(self.node_id, self.ranges, limits, *last_fields)

    @property
    def command_limit(self) -> float:
        """Return the largest command [rad or rad/s at the spool]."""
        return self.command.message.limit

    @property
    def _mode_registers(self) -> tuple[tuple[int, float], ...]:
        """Return the registers for the control mode, as pairs (register, required value)."""
        max_acceleration = self.limits.acceleration
        ramp_registers = (
            (codec.ACCELERATION, max_acceleration),
            (codec.DECELERATION, -max_acceleration),
            (codec.MAX_SPEED, self.limits.speed),
        )
        return ((codec.CTRL_MODE, _CONTROL_MODES[self.mode]), *ramp_registers)

    @property
    def rechecked_settings(self) -> tuple[tuple[int, float], ...]:
        """Return the registers with protective settings, as pairs (register, required value).

        The host reads the registers with protective settings again while the motor is enabled.
        """
        return (
            (codec.TIMEOUT, self.timeout),
            (codec.TMAX, self.ranges.torque),
            (codec.MAX_SPEED, self.limits.speed),
        )

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return no frames, because the motor takes no torque commands in position and velocity modes."""
        return ()

    def _command_frame(self, command: float) -> Frame:
        """Return the frame of a command [rad or rad/s at the spool]."""
        message = self.command.message
        return Frame(message.can_id, self._command_payload(command), self.flags, self.bus)


def make_mode_drive(
    motor: MotorDescription, bus: int, mode: DriveMode, limits: MotionLimits
) -> MitModeDrive:
    """Create the drive object for a control mode, from a motor description.

    Raises:
        ConfigError: an option is unknown or wrong, or a limit does not fit in the command.
    """
    options = dict(motor.options)
    location = f"motor[{motor.name}].options.current_fraction"
    fraction = checked_positive(options.pop("current_fraction", 1.0), location, 1.0)
    base = MitDrive.from_motor(motor, bus, options)
    try:
        return MitModeDrive(
            **constructor_arguments(base), mode=mode, limits=limits, fraction=fraction
        )
    except ValueError as error:
        raise ConfigError(
            str(error), f"motor[{motor.name}]", "a limit that the command can carry"
        ) from None
