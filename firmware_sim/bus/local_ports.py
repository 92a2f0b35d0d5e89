"""Ports on a local bus: the owner of a hub, or a client of a hub in another process."""

import socket
from collections.abc import Collection

from firmware_sim.bus.frame import RECORD_SIZE, Frame, pack_record, unpack_record
from firmware_sim.bus.hub import BusHub, HubConnection
from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.socket_paths import bus_path
from firmware_sim.wire.simulated_wire import NEVER_NS


class HubPort:
    """Port on a local bus, for the process that has opened the hub of the bus.

    The class ``bus_ports.BusPort`` describes the methods.
    """

    due_ns = NEVER_NS

    def __init__(self, name: str, bus: int) -> None:
        """Open the hub.

        Args:
            name: name of the bus.
            bus: index of the bus in the list of the hand's buses.

        Raises:
            SimulatorError: another process already serves the bus.
        """
        self._hub = BusHub(name)
        self._bus = bus
        self._unreadable = 0

    @property
    def lost_frame_count(self) -> int:
        """Return the number of frames that were dropped for slow clients, plus the number of invalid records."""
        return self._hub.dropped_record_count + self._unreadable

    def read_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.read_sockets``."""
        return self._hub.read_sockets()

    def write_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.write_sockets``."""
        return self._hub.write_sockets()

    def receive(self, ready_sockets: Collection[socket.socket]) -> list[Frame]:
        """See ``bus_ports.BusPort.receive``."""
        frames, unreadable = split_records(self._hub.serve(ready_sockets), self._bus)
        self._unreadable += unreadable
        return frames

    def send(self, frames: list[Frame]) -> None:
        """See ``bus_ports.BusPort.send``."""
        self._hub.send(b"".join(map(pack_record, frames)))

    def close(self) -> None:
        """See ``bus_ports.BusPort.close``."""
        self._hub.close()


class HubClientPort:
    """Port on a local bus, for a client of a hub in another process.

    The class ``bus_ports.BusPort`` describes the methods.
    """

    due_ns = NEVER_NS

    def __init__(self, name: str, bus: int) -> None:
        """Connect to the hub of the bus.

        Args:
            name: name of the bus.
            bus: index of the bus in the list of the hand's buses.

        Raises:
            SimulatorError: no process serves the bus.
        """
        self._link = HubConnection(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        self._name = name
        self._bus = bus
        self._unreadable = 0
        try:
            self._link.socket.connect(str(bus_path(name)))
        except OSError as error:
            self._link.socket.close()
            expected = f"expected a hub: python -m firmware_sim bus {name}"
            raise SimulatorError(f"join:{name}: {error.strerror}; {expected}") from error

    @property
    def lost_frame_count(self) -> int:
        """Return the number of frames that the hub did not accept, plus the number of invalid records."""
        return self._link.dropped_record_count + self._unreadable

    def read_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.read_sockets``."""
        return [self._link.socket]

    def write_sockets(self) -> list[socket.socket]:
        """See ``bus_ports.BusPort.write_sockets``."""
        return [self._link.socket] if self._link.unsent else []

    def receive(self, ready_sockets: Collection[socket.socket]) -> list[Frame]:
        """See ``bus_ports.BusPort.receive``.

        Raises:
            SimulatorError: the hub has closed the connection.
        """
        self._link.flush()
        records = self._link.receive() if self._link.socket in ready_sockets else b""
        if self._link.closed:
            raise SimulatorError(f"join:{self._name}: the hub has closed the connection")
        frames, unreadable = split_records(records, self._bus)
        self._unreadable += unreadable
        return frames

    def send(self, frames: list[Frame]) -> None:
        """See ``bus_ports.BusPort.send``."""
        self._link.deliver(b"".join(map(pack_record, frames)))

    def close(self) -> None:
        """See ``bus_ports.BusPort.close``."""
        self._link.socket.close()


def split_records(records: bytes, bus: int) -> tuple[list[Frame], int]:
    """Split whole records into frames.

    Args:
        records: whole records, one after the other.
        bus: index of the bus to set in the returned frames.

    Returns:
        The frames, and the number of records that contain no valid frame.
    """
    start_indices = range(0, len(records), RECORD_SIZE)
    unpacked_records = [
        unpack_record(records[start : start + RECORD_SIZE], bus) for start in start_indices
    ]
    frames = [frame for frame in unpacked_records if frame is not None]
    return frames, len(unpacked_records) - len(frames)
