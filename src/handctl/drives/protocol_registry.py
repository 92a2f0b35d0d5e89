"""Registry of the drive protocols.

The registry assigns the code of a protocol to each entry of ``motor_description.PROTOCOL_TRAITS``.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from handctl.drives.canopen import discovery as canopen_discovery
from handctl.drives.cia402 import drive as cia402_drive
from handctl.drives.cia402 import modes as cia402_modes
from handctl.drives.contract import Drive
from handctl.drives.discovery import ProtocolDiscovery
from handctl.drives.drive_modes import DriveMode, MotionLimits, check_limits
from handctl.drives.mit import cubemars
from handctl.drives.mit import discovery as mit_discovery
from handctl.drives.mit import drive as mit_drive
from handctl.drives.mit import modes as mit_modes
from handctl.drives.moteus import discovery as moteus_discovery
from handctl.drives.moteus.drive import MoteusDrive
from handctl.drives.motor_description import MotorDescription
from handctl.drives.odrive import discovery as odrive_discovery
from handctl.drives.odrive import modes as odrive_modes
from handctl.drives.odrive import options as odrive_options
from handctl.drives.odrive.drive import OdriveDrive
from handctl.drives.option_checks import MotorOption
from handctl.drives.robstride import discovery as robstride_discovery
from handctl.drives.robstride import drive as robstride_drive
from handctl.drives.robstride import mit_mode
from handctl.drives.sensors import discovery as sensor_discovery
from handctl.errors import ConfigError


class ProtocolEntry(NamedTuple):
    """Constructor and discovery functions of one protocol.

    Attributes:
        make_drive: function constructing a drive from a motor description and a bus index.
        discovery: discovery functions of the protocol, None if the drives answer only commands.
        options: options of the protocol in the hand file, by the key of the option.
        make_mode: function constructing a drive in a position or velocity mode, None if the
            protocol supports only torque mode.
    """

    make_drive: Callable[[MotorDescription, int], Drive]
    discovery: ProtocolDiscovery | None
    options: Mapping[str, MotorOption]
    make_mode: Callable[[MotorDescription, int, DriveMode, MotionLimits], Drive] | None = None


PROTOCOL_ENTRIES: dict[str, ProtocolEntry] = {
    "odrive": ProtocolEntry(
        OdriveDrive.from_motor,
        odrive_discovery.DISCOVERY,
        odrive_options.OPTIONS,
        odrive_modes.make_mode_drive,
    ),
    "mit": ProtocolEntry(
        mit_drive.MitDrive.from_motor,
        mit_discovery.DISCOVERY,
        mit_drive.OPTIONS,
        mit_modes.make_mode_drive,
    ),
    "cia402": ProtocolEntry(
        cia402_drive.Cia402Drive.from_motor,
        canopen_discovery.DISCOVERY,
        cia402_drive.OPTIONS,
        cia402_modes.make_mode_drive,
    ),
    "moteus": ProtocolEntry(MoteusDrive.from_motor, moteus_discovery.DISCOVERY, {}),
    "robstride": ProtocolEntry(
        robstride_drive.RobstrideDrive.from_motor,
        robstride_discovery.DISCOVERY,
        robstride_drive.OPTIONS,
    ),
    "cubemars": ProtocolEntry(cubemars.CubemarsDrive.from_motor, None, cubemars.OPTIONS),
    "robstride_mit": ProtocolEntry(mit_mode.RobstrideMitDrive.from_motor, None, mit_mode.OPTIONS),
}
"""Code of each protocol, by the name of the protocol in the hand file."""
DISCOVERY_BY_PROTOCOL: dict[str, ProtocolDiscovery] = {
    **{name: entry.discovery for name, entry in PROTOCOL_ENTRIES.items() if entry.discovery},
    "sensor": sensor_discovery.DISCOVERY,
}
"""Discovery functions of each protocol and of the sensor node, by name."""
PROTOCOLS_WITHOUT_DISCOVERY = tuple(
    name for name, entry in PROTOCOL_ENTRIES.items() if not entry.discovery
)
"""Protocols whose drives a scan cannot discover, because the drives answer only commands."""


def missing_options(protocol: object, options: object) -> dict[str, str]:
    """Return the valid values and the meaning of each option that a protocol requires and a motor lacks.

    The keys of the result are the names of the options. The result is empty for an unknown protocol.

    Args:
        protocol: name of the protocol in the hand file.
        options: options of the motor in the hand file.
    """
    entry = PROTOCOL_ENTRIES.get(protocol) if isinstance(protocol, str) else None
    if entry is None or not isinstance(options, Mapping):
        return {}
    return {
        name: f"{option.value}: {option.meaning.rstrip('.')}"
        for name, option in entry.options.items()
        if option.is_required and name not in options
    }


def make_drive(motor: MotorDescription, bus: int) -> Drive:
    """Create the drive object for torque mode, from a motor description.

    Args:
        motor: description of the motor.
        bus: index of the bus.

    Raises:
        ConfigError: the protocol or an option of the motor is unknown.
    """
    if motor.protocol not in PROTOCOL_ENTRIES:
        location = f"motor[{motor.name}].protocol"
        raise ConfigError(
            repr(motor.protocol), location, "one of " + ", ".join(sorted(PROTOCOL_ENTRIES))
        )
    return PROTOCOL_ENTRIES[motor.protocol].make_drive(motor, bus)


def make_mode_drive(
    motor: MotorDescription, bus: int, mode: DriveMode, limits: MotionLimits
) -> Drive:
    """Create the drive object for a control mode, from a motor description.

    Args:
        motor: description of the motor.
        bus: index of the bus.
        mode: quantity that the drive controls.
        limits: largest speed and acceleration of the drive. In torque mode, the limits are not
            used.

    Raises:
        ConfigError: the protocol or an option is unknown, or handctl does not support the mode with
            the protocol.
    """
    if mode == DriveMode.TORQUE:
        return make_drive(motor, bus)
    check_limits(limits)
    mode_drive_factory = (
        PROTOCOL_ENTRIES[motor.protocol].make_mode if motor.protocol in PROTOCOL_ENTRIES else None
    )
    if mode_drive_factory is None:
        protocols_with_modes = ", ".join(
            sorted(name for name, entry in PROTOCOL_ENTRIES.items() if entry.make_mode)
        )
        raise ConfigError(
            f"mode {mode.value} of {motor.protocol}",
            "mode",
            f"torque, or one of {protocols_with_modes}",
        )
    return mode_drive_factory(motor, bus, mode, limits)
