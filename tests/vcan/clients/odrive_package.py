"""Test the vendor's package ``odrive`` with two simulated drives on vcan0.

The package ``odrive`` finds drives on SocketCAN by their serial numbers. The package
``odrive`` connects only to drives with firmware 0.6.11 or later. The protocol with which ``odrive``
connects to a drive is not published. The simulated drives have firmware 0.6.10. The package
``odrive`` refuses the firmware 0.6.10 with a message that names the version.
"""

import asyncio
from typing import Any

import odrive  # type: ignore[import-not-found,unused-ignore]
from odrive.device_manager import (  # type: ignore[import-not-found,unused-ignore]
    DeviceManagerDelegate,
    FilterSpec,
    get_device_manager,
)

from tests.vcan.clients.check_list import CheckList

INTERFACES = ["can:vcan0"]
NODE_NUMBERS = {"0D5A11000000": 0, "0D5A11000001": 1}
"""Dictionary from the serial number of each simulated drive to its node number."""
FIND_TIMEOUT_S = 20.0


class FoundDevices(DeviceManagerDelegate):  # type: ignore[misc,unused-ignore]
    """Devices that the package ``odrive`` has found. ``nodes`` maps each serial number to a node number."""

    def __init__(self) -> None:
        self.nodes: dict[str, int] = {}

    def on_found_device(self, device: Any) -> bool:
        self.nodes[device.info.serial_number] = device.info.node_id
        return True


async def find_devices() -> dict[str, int]:
    """Return a dictionary from the serial number of each device on the bus to its node number."""
    manager = get_device_manager()
    found_devices = FoundDevices()
    subscription = manager.subscribe(
        FilterSpec(interfaces=INTERFACES), found_devices, debug_name="test"
    )
    try:
        for _ in range(round(FIND_TIMEOUT_S / 0.1)):
            await asyncio.sleep(0.1)
            if len(found_devices.nodes) == len(NODE_NUMBERS):
                break
    finally:
        manager.unsubscribe(subscription)
    return found_devices.nodes


async def connect(serial_number: str) -> str:
    """Return the message with which the package ``odrive`` refuses to connect to a drive."""
    try:
        await asyncio.wait_for(
            odrive.find_async(serial_number, interfaces=INTERFACES), FIND_TIMEOUT_S
        )
    except Exception as error:  # noqa: BLE001 - the package has errors of its own
        return str(error)
    return "connected"


async def main() -> None:
    checks = CheckList()
    nodes = await find_devices()
    for serial_number, node in NODE_NUMBERS.items():
        checks.check(
            f"drive {serial_number} is found as node {node}",
            nodes.get(serial_number) == node,
            nodes,
        )
        text = await connect(serial_number)
        checks.check(
            f"the firmware of drive {serial_number} is recognized as too old",
            "does not support fully featured CAN-based connection" in text,
            text,
        )
    checks.end()


if __name__ == "__main__":
    asyncio.run(main())
