"""Registry of the drive protocols: the code of each protocol of ``motor_description.PROTOCOLS``."""

from collections.abc import Callable
from typing import NamedTuple

from handctl.drives.cia402 import discovery as cia402_discovery
from handctl.drives.cia402.drive import Cia402Drive
from handctl.drives.contract import Drive
from handctl.drives.discovery import Discovery
from handctl.drives.mit import discovery as mit_discovery
from handctl.drives.mit.cubemars import CubemarsDrive
from handctl.drives.mit.drive import MitDrive
from handctl.drives.moteus import discovery as moteus_discovery
from handctl.drives.moteus.drive import MoteusDrive
from handctl.drives.motor_description import MotorDescription
from handctl.drives.odrive import discovery as odrive_discovery
from handctl.drives.odrive.drive import OdriveDrive
from handctl.drives.robstride import discovery as robstride_discovery
from handctl.drives.robstride.drive import RobstrideDrive
from handctl.drives.robstride.mit import RobstrideMitDrive
from handctl.drives.sensors import discovery as sensor_discovery
from handctl.errors import ConfigError


class ProtocolEntry(NamedTuple):
    """Constructor and discovery functions of one protocol.

    Attributes:
        make: constructor of a drive from a motor description and a bus index.
        discovery: discovery functions of the protocol, None if its drives answer only commands.
    """

    make: Callable[[MotorDescription, int], Drive]
    discovery: Discovery | None


PROTOCOLS: dict[str, ProtocolEntry] = {
    "odrive": ProtocolEntry(OdriveDrive.of, odrive_discovery.DISCOVERY),
    "mit": ProtocolEntry(MitDrive.of, mit_discovery.DISCOVERY),
    "cia402": ProtocolEntry(Cia402Drive.of, cia402_discovery.DISCOVERY),
    "moteus": ProtocolEntry(MoteusDrive.of, moteus_discovery.DISCOVERY),
    "robstride": ProtocolEntry(RobstrideDrive.of, robstride_discovery.DISCOVERY),
    "cubemars": ProtocolEntry(CubemarsDrive.of, None),
    "robstride_mit": ProtocolEntry(RobstrideMitDrive.of, None),
}
"""Protocols by their name in the hand file."""
DISCOVERIES: dict[str, Discovery] = {
    **{name: entry.discovery for name, entry in PROTOCOLS.items() if entry.discovery},
    "sensor": sensor_discovery.DISCOVERY,
}
"""Discovery of each protocol and of the sensor node."""
UNDISCOVERED = tuple(name for name, entry in PROTOCOLS.items() if not entry.discovery)
"""Protocols whose drives a scan cannot find, because they answer only commands."""


def make_drive(motor: MotorDescription, bus: int) -> Drive:
    """Return the drive of a motor.

    Args:
        motor: description of the motor.
        bus: index of the bus.

    Raises:
        ConfigError: an unknown protocol, or an unknown option.
    """
    if motor.protocol not in PROTOCOLS:
        where = f"motor[{motor.name}].protocol"
        raise ConfigError(repr(motor.protocol), where, "one of " + ", ".join(sorted(PROTOCOLS)))
    return PROTOCOLS[motor.protocol].make(motor, bus)
