"""How the simulator hangs on a bus: one port a bus, whatever the bus is made of."""

import socket
from collections.abc import Callable, Collection
from typing import Protocol

from firmware_sim.bus.frame import Frame
from firmware_sim.bus.local import HubPort, JoinedPort
from firmware_sim.bus.socketcan import SocketCanPort
from firmware_sim.description import SimulatorError


class Port(Protocol):
    """One bus of the hand; nothing here blocks.

    Attributes:
        lost: frames that could not be sent or read.
        due_ns: when it has to be looked at even if no socket is ready [ns]; ``medium.NEVER`` if only sockets count.
    """

    @property
    def lost(self) -> int: ...
    @property
    def due_ns(self) -> int: ...

    def readers(self) -> list[socket.socket]:
        """Return the sockets to wait on for reading."""
        ...

    def writers(self) -> list[socket.socket]:
        """Return the sockets to wait on for writing."""
        ...

    def receive(self, ready: Collection[socket.socket]) -> list[Frame]:
        """Return what has arrived on sockets that are ready; to be called until nothing comes."""
        ...

    def send(self, frames: list[Frame]) -> None:
        """Send in this order; what does not fit is lost and counted."""
        ...

    def close(self) -> None:
        """Leave the bus."""
        ...


def open_port(spec: str, bus: int, wired: Callable[[str, int], Port] | None = None) -> Port:
    """Open a bus.

    Args:
        spec: ``local:NAME`` (serve the bus), ``join:NAME`` (another process serves it), ``socketcan:INTERFACE``.
        bus: index in the hand's list.
        wired: makes the port of a local bus whose frames take their time.

    Raises:
        SimulatorError: an unknown kind of bus, or it cannot be opened.
    """
    kind, _, name = spec.partition(":")
    if wired and kind != "local":
        raise SimulatorError(f"bus {spec!r}: only a bus that is served here, local:NAME, can have a simulated wire")
    if kind == "local":
        return wired(name, bus) if wired else HubPort(name, bus)
    if kind == "join":
        return JoinedPort(name, bus)
    if kind == "socketcan" and name:
        return SocketCanPort(name, bus)
    raise SimulatorError(f"bus {spec!r}: expected local:NAME, join:NAME or socketcan:INTERFACE")


def assign(specs: list[str], buses: list[str]) -> list[str]:
    """Return the spec of each bus of a hand.

    Args:
        specs: ``BUS=SPEC``, or just ``SPEC`` for a hand with one bus.
        buses: the hand's buses.

    Raises:
        SimulatorError: a bus is missing, unknown or given twice.
    """
    chosen: dict[str, str] = {}
    for text in specs:
        name, equals, spec = text.partition("=")
        if not equals:
            if len(buses) > 1:
                raise SimulatorError(f"bus {text}: this hand has {len(buses)}; expected {buses[0]}={text}")
            name, spec = buses[0], text
        if name not in buses or name in chosen:
            problem = "given twice" if name in chosen else "unknown"
            raise SimulatorError(f"bus {name}: {problem}; this hand has {', '.join(buses)}")
        chosen[name] = spec
    if missing := [name for name in buses if name not in chosen]:
        raise SimulatorError(f"no --bus for {', '.join(missing)}")
    return [chosen[name] for name in buses]
