"""Properties of the CAN adapter behind a network interface, as Linux reports them: driver, USB speed, serial number.

Source: Linux ABI documentation, ``sysfs-bus-usb`` (speed in Mbit/s) and ``sysfs-class-net``.
"""

from pathlib import Path
from typing import NamedTuple

SYSFS_NETWORK_FOLDER = Path("/sys/class/net")
"""Folder in which Linux lists the network interfaces."""
FULL_SPEED_MBIT_S = 12
"""Data rate of USB full speed [Mbit/s].

USB full speed has one USB frame per millisecond. USB high speed has one micro-frame per 125 us.
"""


class UsbAdapter(NamedTuple):
    """CAN adapter of a network interface.

    Attributes:
        driver: name of the adapter's Linux driver, or an empty text if it is unknown.
        usb_speed_mbit_s: speed of the USB device [Mbit/s], or 0 for an adapter without USB.
        serial: serial number of the USB device, or an empty text if the device has no serial
            number.
    """

    driver: str = ""
    usb_speed_mbit_s: float = 0.0
    serial: str = ""

    @property
    def is_full_speed(self) -> bool:
        """Return True if the adapter runs at USB full speed.

        At USB full speed, an adapter exchanges CAN frames only once per millisecond.
        """
        return 0.0 < self.usb_speed_mbit_s <= FULL_SPEED_MBIT_S


def read_adapter(name: str, network_folder: Path = SYSFS_NETWORK_FOLDER) -> UsbAdapter | None:
    """Return the adapter of a network interface, or None if the interface is virtual or missing.

    Args:
        name: name of the interface.
        network_folder: folder in which Linux lists the network interfaces.
    """
    device = network_folder / name / "device"
    if not device.exists():
        return None
    driver = device / "driver"
    # For a USB adapter, the path ``device`` leads to the USB interface, and the parent folder is
    # the USB device.
    usb_device = device.resolve().parent
    speed = _read_text(usb_device / "speed")
    return UsbAdapter(
        driver=driver.resolve().name if driver.exists() else "",
        usb_speed_mbit_s=float(speed) if speed.replace(".", "", 1).isdigit() else 0.0,
        serial=_read_text(usb_device / "serial") if speed else "",
    )


def _read_text(path: Path) -> str:
    """Return the content of a text file without its line end.

    If the file cannot be read, the returned text is empty.
    """
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
