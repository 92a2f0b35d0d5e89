"""CAN adapter behind an interface, as Linux reports it: driver, USB speed, serial number.

Source: Linux ABI documentation, ``sysfs-bus-usb`` (speed in Mbit/s) and ``sysfs-class-net``.
"""

from pathlib import Path
from typing import NamedTuple

NETWORK = Path("/sys/class/net")
"""Folder of the interfaces."""
FULL_SPEED = 12
"""USB full speed [Mbit/s]: one USB frame each millisecond. High speed has one each 125 us."""


class Adapter(NamedTuple):
    """Adapter of an interface.

    Attributes:
        driver: name of the kernel's driver, empty if unknown.
        usb_speed: speed of the USB device [Mbit/s], 0 without USB.
        serial: serial number of the USB device, empty without one.
    """

    driver: str = ""
    usb_speed: float = 0.0
    serial: str = ""

    @property
    def is_full_speed(self) -> bool:
        """Return True if the adapter exchanges frames once a millisecond."""
        return 0.0 < self.usb_speed <= FULL_SPEED


def read_adapter(name: str, network: Path = NETWORK) -> Adapter | None:
    """Read the adapter of an interface. None for a virtual interface or a missing one.

    Args:
        name: name of the interface.
        network: folder of the interfaces.
    """
    device = network / name / "device"
    if not device.exists():
        return None
    driver = device / "driver"
    # The interface of a USB device is a folder in the folder of the device.
    usb = device.resolve().parent
    speed = _text(usb / "speed")
    return Adapter(
        driver=driver.resolve().name if driver.exists() else "",
        usb_speed=float(speed) if speed.replace(".", "", 1).isdigit() else 0.0,
        serial=_text(usb / "serial") if speed else "",
    )


def _text(path: Path) -> str:
    """Return the text of a file without line end, empty if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
