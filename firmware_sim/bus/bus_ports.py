"""Ports: connections of the simulator to its buses.

Each bus has a port, and the ports of all types of buses have the same methods.
"""

import socket
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Protocol

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.local_ports import HubClientPort, HubPort
from firmware_sim.bus.socketcan import SocketCanPort
from firmware_sim.description.hand_description import SimulatorError

VIRTUAL_INTERFACES = Path("/sys/devices/virtual/net")
"""Folder in which Linux lists the network interfaces without hardware, such as vcan0.

Source: Linux sysfs.
"""


class BusPort(Protocol):
    """The connection of the simulator to one bus of the hand. All methods return without waiting.

    Attributes:
        lost_frame_count: number of frames that could not be sent or read.
        due_ns: time when the port must be served even if no socket is ready [ns]. The time is
            ``simulated_wire.NEVER_NS`` if the port must be served only when a socket is ready.
    """

    @property
    def lost_frame_count(self) -> int:
        """Return the number of frames that could not be sent or read."""
        ...

    @property
    def due_ns(self) -> int:
        """Return the time when the port must be served even if no socket is ready [ns]."""
        ...

    def read_sockets(self) -> list[socket.socket]:
        """Return the sockets to poll for reading."""
        ...

    def write_sockets(self) -> list[socket.socket]:
        """Return the sockets to poll for writing."""
        ...

    def receive(self, ready_sockets: Collection[socket.socket]) -> list[Frame]:
        """Receive frames from the sockets that are ready.

        The caller must call ``receive`` again until the result is empty.
        """
        ...

    def send(self, frames: list[Frame]) -> None:
        """Send frames in the given order.

        A frame that the bus cannot accept is lost, and the port counts the lost frame.
        """
        ...

    def close(self) -> None:
        """Leave the bus."""
        ...


def open_port(
    spec: str, bus: int, timed_port: Callable[[str, int], BusPort] | None = None
) -> BusPort:
    """Open the port of one bus.

    Args:
        spec: ``local:NAME`` (this process serves the bus), ``join:NAME`` (another process serves
            the bus) or ``socketcan:INTERFACE``.
        bus: index of the bus in the list of the hand's buses.
        timed_port: function that opens the port of a local bus with simulated transmission times.
            If the function is None, the transmission of a frame takes no time.

    Raises:
        SimulatorError: the type of the bus is unknown, or the bus cannot be opened.
    """
    kind, _, name = spec.partition(":")
    if timed_port and kind != "local":
        raise SimulatorError(
            f"bus {spec!r}: --wire needs a bus that this process serves, local:NAME"
        )
    if kind == "local":
        return timed_port(name, bus) if timed_port else HubPort(name, bus)
    if kind == "join":
        return HubClientPort(name, bus)
    if kind == "socketcan" and name:
        return SocketCanPort(name, bus)
    raise SimulatorError(f"bus {spec!r}: expected local:NAME, join:NAME or socketcan:INTERFACE")


def is_local_bus(spec: str) -> bool:
    """Return True if all frames of a bus stay on this machine.

    The clock of a local bus is allowed to pause, because no other machine sends or receives frames
    of this bus.
    """
    kind, _, name = spec.partition(":")
    return kind == "local" or (kind == "socketcan" and (VIRTUAL_INTERFACES / name).exists())


def assign_buses(specs: list[str], buses: list[str]) -> list[str]:
    """Assign a specification, such as ``local:NAME``, to each bus of a hand.

    Args:
        specs: one text ``BUS=SPEC`` for each bus, or only ``SPEC`` for a hand with one bus.
        buses: names of the hand's buses.

    Returns:
        The specifications in the order of the hand's buses.

    Raises:
        SimulatorError: a bus has no specification, does not belong to the hand, or is given twice.
    """
    specs_by_bus: dict[str, str] = {}
    for text in specs:
        name, equals, spec = text.partition("=")
        if not equals:
            if len(buses) > 1:
                raise SimulatorError(
                    f"bus {text}: this hand has {len(buses)} buses; expected {buses[0]}={text}"
                )
            name = buses[0]
            spec = text
        if name not in buses or name in specs_by_bus:
            problem = "given twice" if name in specs_by_bus else "unknown"
            raise SimulatorError(f"bus {name}: {problem}; this hand has {', '.join(buses)}")
        specs_by_bus[name] = spec
    if missing_names := [name for name in buses if name not in specs_by_bus]:
        raise SimulatorError(f"no --bus for {', '.join(missing_names)}")
    return [specs_by_bus[name] for name in buses]
