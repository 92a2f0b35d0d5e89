"""Ports on a local bus: as the owner of its hub, or as a client of a hub that runs elsewhere."""

import socket
from collections.abc import Collection

from firmware_sim.bus.frame import RECORD_SIZE, Frame, pack_record, unpack_record
from firmware_sim.bus.hub import Hub, Link
from firmware_sim.description import SimulatorError
from firmware_sim.places import bus_path
from firmware_sim.wire.medium import NEVER


class HubPort:
    """Serves the bus and hangs on it; see ``ports.Port``."""

    due_ns = NEVER

    def __init__(self, name: str, bus: int) -> None:
        """Args: name of the bus; its index in the hand. Raises SimulatorError if it is served already."""
        self._hub = Hub(name)
        self._bus = bus
        self._unreadable = 0

    @property
    def lost(self) -> int:
        """Frames dropped for slow clients, and records that were no frames."""
        return self._hub.dropped + self._unreadable

    def readers(self) -> list[socket.socket]:
        """See ``ports.Port``."""
        return self._hub.readers()

    def writers(self) -> list[socket.socket]:
        """See ``ports.Port``."""
        return self._hub.writers()

    def receive(self, ready: Collection[socket.socket]) -> list[Frame]:
        """See ``ports.Port``."""
        frames, unreadable = split(self._hub.serve(ready), self._bus)
        self._unreadable += unreadable
        return frames

    def send(self, frames: list[Frame]) -> None:
        """See ``ports.Port``."""
        self._hub.send(b"".join(map(pack_record, frames)))

    def close(self) -> None:
        """See ``ports.Port``."""
        self._hub.close()


class JoinedPort:
    """A client of a hub; see ``ports.Port``."""

    due_ns = NEVER

    def __init__(self, name: str, bus: int) -> None:
        """Args: name of the bus; its index in the hand. Raises SimulatorError if nobody serves it."""
        self._link = Link(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        self._name, self._bus = name, bus
        self._unreadable = 0
        try:
            self._link.socket.connect(str(bus_path(name)))
        except OSError as error:
            self._link.socket.close()
            wanted = f"expected a hub: python -m firmware_sim bus {name}"
            raise SimulatorError(f"join:{name}: {error.strerror}; {wanted}") from error

    @property
    def lost(self) -> int:
        """Frames that the hub did not take, and records that were no frames."""
        return self._link.dropped + self._unreadable

    def readers(self) -> list[socket.socket]:
        """See ``ports.Port``."""
        return [self._link.socket]

    def writers(self) -> list[socket.socket]:
        """See ``ports.Port``."""
        return [self._link.socket] if self._link.unsent else []

    def receive(self, ready: Collection[socket.socket]) -> list[Frame]:
        """See ``ports.Port``; raises SimulatorError when the hub has gone."""
        self._link.flush()
        records = self._link.receive() if self._link.socket in ready else b""
        if self._link.gone:
            raise SimulatorError(f"join:{self._name}: the hub has gone")
        frames, unreadable = split(records, self._bus)
        self._unreadable += unreadable
        return frames

    def send(self, frames: list[Frame]) -> None:
        """See ``ports.Port``."""
        self._link.deliver(b"".join(map(pack_record, frames)))

    def close(self) -> None:
        """See ``ports.Port``."""
        self._link.socket.close()


def split(records: bytes, bus: int) -> tuple[list[Frame], int]:
    """Return the frames in whole records, and how many records were none."""
    starts = range(0, len(records), RECORD_SIZE)
    read = [unpack_record(records[start : start + RECORD_SIZE], bus) for start in starts]
    frames = [frame for frame in read if frame is not None]
    return frames, len(read) - len(frames)
