"""Which protocols there are: one line each."""

from collections.abc import Callable
from typing import NamedTuple

from handctl.drives.cia402 import discovery as cia402_discovery
from handctl.drives.cia402.drive import Cia402Drive
from handctl.drives.contract import Drive
from handctl.drives.description import MotorDescription
from handctl.drives.discovery import Discovery
from handctl.drives.mit import discovery as mit_discovery
from handctl.drives.mit.cubemars import CubemarsDrive
from handctl.drives.mit.drive import MitDrive
from handctl.drives.odrive import discovery as odrive_discovery
from handctl.drives.odrive.drive import OdriveDrive
from handctl.drives.sensors import discovery as sensor_discovery
from handctl.errors import ConfigError


class Spoken(NamedTuple):
    """A protocol.

    Attributes:
        make: the drive of a motor description on a bus.
        discovery: how it is looked for; None where nothing can be asked that is no order.
    """

    make: Callable[[MotorDescription, int], Drive]
    discovery: Discovery | None


PROTOCOLS: dict[str, Spoken] = {
    "odrive": Spoken(OdriveDrive.of, odrive_discovery.DISCOVERY),
    "mit": Spoken(MitDrive.of, mit_discovery.DISCOVERY),
    "cia402": Spoken(Cia402Drive.of, cia402_discovery.DISCOVERY),
    "cubemars": Spoken(CubemarsDrive.of, None),
}
DISCOVERIES: dict[str, Discovery] = {
    **{name: spoken.discovery for name, spoken in PROTOCOLS.items() if spoken.discovery},
    "sensor": sensor_discovery.DISCOVERY,
}
"""How each protocol, and the sensor node, is looked for on a bus."""


def make_drive(motor: MotorDescription, bus: int) -> Drive:
    """The drive of a motor.

    Args:
        motor: its description.
        bus: index of its bus.

    Raises:
        ConfigError: no such protocol, or an option that it does not have.
    """
    if motor.protocol not in PROTOCOLS:
        where = f"motor[{motor.name}].protocol"
        raise ConfigError(repr(motor.protocol), where, "one of " + ", ".join(sorted(PROTOCOLS)))
    return PROTOCOLS[motor.protocol].make(motor, bus)
