"""CiA 402 drive in cyclic synchronous position mode or velocity mode.

RPDO1 carries the target position (0x607A) or the target velocity (0x60FF). The maximum speed
(0x6080) is read back before arming, and again while the drive is enabled. The host also reads back
the objects of torque mode before arming. In position mode the
drive supervises the following error (0x6065, 0x6066), so that a drive with a blocked shaft goes
into fault.

The unit of object 0x60FF differs between manufacturers. The option ``velocity_unit`` has the value
rev_min (the default, as on EPOS4) or count_s. The unit of object 0x6080 is 1/min. Source: CiA
402-2.
"""

import math
from dataclasses import dataclass

from handctl.drives.canopen import setup
from handctl.drives.cia402 import codec, settings
from handctl.drives.cia402.drive import Cia402Drive
from handctl.drives.contract import DriveState
from handctl.drives.drive_modes import DriveMode, MotionLimits, constructor_arguments
from handctl.drives.frame import Frame
from handctl.drives.motor_description import MotorDescription
from handctl.drives.signals import SignalTable
from handctl.errors import ConfigError

_OPERATION_MODES = {
    DriveMode.POSITION: settings.POSITION_MODE,
    DriveMode.VELOCITY: settings.VELOCITY_MODE,
}
"""Value of object 0x6060 (mode of operation) for each drive mode."""
VELOCITY_UNITS = ("rev_min", "count_s")
"""Values of the option ``velocity_unit`` in the hand file, the default first."""
INTERPOLATION_PERIOD_MS = 5
"""Interpolation period of the target position [ms]. The commands on a test bench have the same period."""
FOLLOWING_ERROR_RAD = 0.5
"""Largest following error that the drive tolerates for any length of time [rad at the spool]."""
FOLLOWING_ERROR_MS = 200
"""Time after which the drive reports a fault if the following error exceeds ``FOLLOWING_ERROR_RAD`` [ms]."""
RAD_S_PER_RPM = math.tau / 60.0
"""Speed of one revolution per minute [rad/s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cia402ModeDrive(Cia402Drive):
    """CiA 402 drive in position mode or velocity mode.

    The command to the drive is a position [rad] or a velocity [rad/s] at the spool. The attribute
    ``command_limit`` has the same unit as the command.

    Attributes:
        mode: quantity that the drive controls.
        velocity_unit: value of one count of object 0x60FF [rad/s at the spool], negative if a
            positive count unwinds the tendon.
    """

    mode: DriveMode
    velocity_unit: float

    def __post_init__(self) -> None:
        """Build the signal tables of the cyclic frames."""
        Cia402Drive.__post_init__(self)
        if self.mode == DriveMode.VELOCITY:
            message = codec.velocity_message(self.node_id, self.velocity_unit, self.command_limit)
        else:
            message = codec.position_message(
                self.node_id, self.counts, self.ratio, self.zero, self.command_limit
            )
        object.__setattr__(self, "command", SignalTable(message))

    @property
    def frames_per_tick(self) -> tuple[tuple[int, bool], ...]:
        """Return the frames of the drive in a tick: RPDO, TPDO, and SYNC if the option ``sync`` is set."""
        return ((6, False), (8, False), *(((0, False),) if self.sync else ()))

    def _command_at_rest(self, state: DriveState) -> float:
        """Return the command to the drive that causes no motion.

        In position mode, the command at rest is the present position. In velocity mode, the command
        at rest is zero.
        """
        return self.mode.command_at_rest(state.position)

    def torque_frames(self, torque: float) -> tuple[Frame, ...]:
        """Return no frames, because the RPDO contains no torque in position mode and velocity mode."""
        return ()


def make_mode_drive(
    motor: MotorDescription, bus: int, mode: DriveMode, limits: MotionLimits
) -> Cia402ModeDrive:
    """Create the drive object for a control mode, from a motor description.

    Raises:
        ConfigError: an option is unknown or wrong, the mode is not supported, or a limit does not
            fit into the object of the drive.
    """
    if mode not in _OPERATION_MODES:
        raise ConfigError(mode.value, "mode", "position, velocity or torque for a CiA 402 drive")
    options = dict(motor.options)
    unit = options.pop("velocity_unit", VELOCITY_UNITS[0])
    location = f"motor[{motor.name}]"
    if unit not in VELOCITY_UNITS:
        raise ConfigError(
            repr(unit), f"{location}.options.velocity_unit", " or ".join(VELOCITY_UNITS)
        )
    fields = constructor_arguments(
        Cia402Drive.from_motor(motor, bus, options, _OPERATION_MODES[mode])
    )
    ratio = abs(fields["ratio"])
    speed = math.ceil(limits.speed * ratio / RAD_S_PER_RPM)
    window = math.ceil(FOLLOWING_ERROR_RAD * ratio / math.tau * fields["counts"])
    fields["setup_steps"] = (*_motion_steps(mode, speed, window), *fields["setup_steps"])
    fields["command_limit"] = (
        limits.speed if mode == DriveMode.VELOCITY else motor.position_range_rad
    )
    rad_s_per_unit = (RAD_S_PER_RPM if unit == "rev_min" else math.tau / fields["counts"]) / fields[
        "ratio"
    ]
    try:
        return Cia402ModeDrive(**fields, mode=mode, velocity_unit=rad_s_per_unit)
    except ValueError as error:
        raise ConfigError(str(error), location, "a smaller limit or range") from None


def _motion_steps(mode: DriveMode, speed: int, window: int) -> tuple[setup.SetupStep, ...]:
    """Return the set-up steps that a drive mode requires in addition to the set-up steps of torque mode.

    Args:
        mode: quantity that the drive controls.
        speed: maximum speed [1/min].
        window: largest following error that the drive tolerates for any length of time [count].
    """
    write = setup.ObjectCheck.WRITE
    maximum = setup.SetupStep(write, 0x6080, 0, speed, 4)
    if mode == DriveMode.VELOCITY:
        return (maximum,)
    return (
        maximum,
        setup.SetupStep(write, 0x6065, 0, window, 4),
        setup.SetupStep(write, 0x6066, 0, FOLLOWING_ERROR_MS, 2),
        # The interpolation time is value x 10^index seconds. The index 0xFD means -3, so the
        # interpolation time is in milliseconds.
        setup.SetupStep(write, 0x60C2, 1, INTERPOLATION_PERIOD_MS, 1),
        setup.SetupStep(write, 0x60C2, 2, 0xFD, 1),
    )
