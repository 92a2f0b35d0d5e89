"""Which protocols there are: one line each."""

from collections.abc import Callable

from handctl.drives import cia402_discovery, mit_discovery, odrive_discovery, sensor_discovery
from handctl.drives.cia402 import Cia402Drive
from handctl.drives.contract import Drive
from handctl.drives.description import MotorDescription
from handctl.drives.discovery import Discovery
from handctl.drives.mit import MitDrive
from handctl.drives.odrive import OdriveDrive
from handctl.errors import ConfigError

PROTOCOLS: dict[str, Callable[[MotorDescription, int], Drive]] = {
    "cia402": Cia402Drive.of,
    "mit": MitDrive.of,
    "odrive": OdriveDrive.of,
}


DISCOVERIES: dict[str, Discovery] = {
    name: Discovery(module.questions, module.found, module.orders, module.foreign, module.ping, module.pong)
    for name, module in (
        ("odrive", odrive_discovery),
        ("mit", mit_discovery),
        ("cia402", cia402_discovery),
        ("sensor", sensor_discovery),
    )
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
    return PROTOCOLS[motor.protocol](motor, bus)
