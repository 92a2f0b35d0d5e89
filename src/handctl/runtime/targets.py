"""The target socket of a running controller: streamed targets as binary datagrams, read without blocking.

Targets and requests have separate sockets. A client that sends targets too fast therefore cannot
delay a stop request of another client.

Datagram, little-endian: magic 4 bytes, process of the client u32, number of the stream u32, number
of values u32, number of the target i64, CLOCK_MONOTONIC at the sending i64 [ns], values float64.
"""

import socket
import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from handctl.errors import BusError
from handctl.programs.requests import MAX_TARGET_VALUES, target_text
from handctl.runtime.mailbox import RIGHT_FOLDER
from handctl.runtime.paths import targets_path
from handctl.runtime.peers import name_senders, receive_datagram

MAGIC = b"HCT1"
"""First bytes of a target datagram. The bytes include the version of the format."""
HEADER = struct.Struct("<4sIIIqq")
MAX_DATAGRAM_BYTES = HEADER.size + 8 * MAX_TARGET_VALUES
"""Longest datagram of a target [bytes]."""
READ_PER_TICK = 64
"""Largest number of datagrams read per tick. A client that sends ten times too fast sends fewer than this."""
MAX_TARGETS_PER_TICK = 4
"""Largest number of targets passed to a tick.

The newest targets are passed. The numbers of the targets show which are missing.
"""


def stream_name(process: int, number: int) -> str:
    """Return the name of a stream."""
    return f"{process}-{number}"


class TargetBox:
    """Receiver of streamed targets, owned by the controller.

    Attributes:
        path: path of the socket.
        socket: Unix datagram socket.
    """

    def __init__(self, name: str, run_time: Callable[[int], int]) -> None:
        """Bind the target socket of controller ``name``. The controller holds the lock of the bus.

        Args:
            name: bus of the controller.
            run_time: function from CLOCK_MONOTONIC to the run's time [ns].

        Raises:
            BusError: the socket cannot be created.
        """
        self.path = targets_path(name)
        self._run_time = run_time
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self.path.unlink(missing_ok=True)
            name_senders(self.socket)
            self.socket.bind(str(self.path))
        except OSError as error:
            self.socket.close()
            raise BusError(f"cannot receive targets: {error}", str(self.path.parent), RIGHT_FOLDER) from None
        self.socket.setblocking(False)

    def read(self) -> tuple[str, ...]:
        """Return the newest waiting targets as requests, oldest first.

        Malformed datagrams are dropped.
        """
        texts: list[str] = []
        for _ in range(READ_PER_TICK):
            try:
                data, _, ours = receive_datagram(self.socket, MAX_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                break
            if ours and (text := self._decode(data)):
                texts.append(text)
        return tuple(texts[-MAX_TARGETS_PER_TICK:])

    def _decode(self, data: bytes) -> str:
        """Return a datagram as a request, empty for a malformed datagram."""
        if len(data) < HEADER.size:
            return ""
        magic, process, number, count, index, sent_ns = HEADER.unpack_from(data)
        if magic != MAGIC or len(data) != HEADER.size + 8 * count:
            return ""
        values = struct.unpack_from(f"<{count}d", data, HEADER.size)
        return target_text(stream_name(process, number), index, self._run_time(sent_ns), values)

    def close(self) -> None:
        """Remove the socket."""
        self.socket.close()
        self.path.unlink(missing_ok=True)


class TargetSender:
    """Sender of one stream of targets, in a client."""

    def __init__(self, name: str, process: int, number: int) -> None:
        """Connect to the controller ``name``.

        Raises:
            BusError: no controller receives targets on this bus.
        """
        self._head = process, number
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.connect(str(targets_path(name)))
        except OSError:
            self._socket.close()
            raise BusError("no controller accepts targets", f"bus {name}", "a running handctl run") from None
        self._socket.setblocking(False)

    def send(self, index: int, sent_ns: int, values: NDArray[np.float64]) -> bool:
        """Send a target. Returns False if the socket is full of targets not read by the controller.

        Args:
            index: number of the target.
            sent_ns: CLOCK_MONOTONIC at the sending [ns].
            values: (V,) values of the target.

        Raises:
            OSError: the controller has ended.
        """
        process, number = self._head
        data = HEADER.pack(MAGIC, process, number, len(values), index, sent_ns) + values.astype("<f8").tobytes()
        try:
            self._socket.send(data)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
