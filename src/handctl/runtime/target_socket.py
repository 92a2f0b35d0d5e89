"""The target socket of a running controller, at which streamed targets arrive.

Clients send the targets as binary datagrams.

The controller reads the socket without blocking. Requests arrive at a different socket than
targets, so that a client that sends targets too fast cannot delay a stop request from another
client.

A datagram with a target is little-endian, and contains the following fields.

    magic 4 bytes | process number of the client u32 | number of the stream u32 | number of values u32
    | number of the target i64 | sending time on CLOCK_MONOTONIC i64 [ns] | values float64
"""

import socket
import struct
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import StreamTarget
from handctl.errors import BusError
from handctl.programs.requests import MAX_VALUES_PER_TARGET
from handctl.runtime.mailbox import RUN_FOLDER_ADVICE
from handctl.runtime.socket_paths import targets_path
from handctl.runtime.socket_peers import receive_datagram, request_sender_credentials

TARGET_MAGIC = b"HCT1"
"""First bytes of every datagram with a target. The first bytes include the version of the format."""
HEADER_STRUCT = struct.Struct("<4sIIIqq")
MAX_DATAGRAM_BYTES = HEADER_STRUCT.size + 8 * MAX_VALUES_PER_TARGET
"""Largest size of a datagram with a target [bytes]."""
MAX_DATAGRAMS_PER_TICK = 64
"""Largest number of datagrams that are read in a tick.

Even a client that sends ten targets in each tick stays below this limit.
"""
MAX_TARGETS_PER_TICK = 4
"""Largest number of targets that a tick gets.

If more targets are waiting, the tick gets the newest targets. The gap in the numbers of the targets
shows that targets are missing.
"""


def stream_name(process_id: int, stream_number: int) -> str:
    """Return the name of a stream of targets, from the client's process number and the stream's number."""
    return f"{process_id}-{stream_number}"


class TargetReceiver:
    """Receiver of the targets that clients stream, owned by the controller.

    Attributes:
        path: path of the socket.
        socket: Unix datagram socket.
    """

    def __init__(self, name: str, run_time: Callable[[int], int]) -> None:
        """Bind the target socket of the controller on the bus ``name``.

        Before the socket is bound, the controller must lock the bus.

        Args:
            name: bus of the controller.
            run_time: function that converts a CLOCK_MONOTONIC time [ns] to the time of the run
                [ns].

        Raises:
            BusError: the socket cannot be created.
        """
        self.path = targets_path(name)
        self._run_time = run_time
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self.path.unlink(missing_ok=True)
            request_sender_credentials(self.socket)
            self.socket.bind(str(self.path))
        except OSError as error:
            self.socket.close()
            raise BusError(
                f"cannot receive targets: {error}", str(self.path.parent), RUN_FOLDER_ADVICE
            ) from None
        self.socket.setblocking(False)

    def read_targets(self) -> tuple[StreamTarget, ...]:
        """Return the latest received targets, at most ``MAX_TARGETS_PER_TICK``, in the order of arrival.

        A datagram with a wrong form is dropped.
        """
        targets: list[StreamTarget] = []
        for _ in range(MAX_DATAGRAMS_PER_TICK):
            try:
                data, _, is_own_user = receive_datagram(self.socket, MAX_DATAGRAM_BYTES + 1)
            except BlockingIOError:
                break
            if is_own_user and (target := self._decode_datagram(data)) is not None:
                targets.append(target)
        return tuple(targets[-MAX_TARGETS_PER_TICK:])

    def _decode_datagram(self, datagram: bytes) -> StreamTarget | None:
        """Return the target in a datagram, or None if the datagram is malformed."""
        if len(datagram) < HEADER_STRUCT.size:
            return None
        magic, process_id, stream_number, count, target_number, sent_ns = HEADER_STRUCT.unpack_from(
            datagram
        )
        if magic != TARGET_MAGIC or len(datagram) != HEADER_STRUCT.size + 8 * count:
            return None
        values = struct.unpack_from(f"<{count}d", datagram, HEADER_STRUCT.size)
        return StreamTarget(
            stream_name(process_id, stream_number), target_number, self._run_time(sent_ns), values
        )

    def close(self) -> None:
        """Remove the socket."""
        self.socket.close()
        self.path.unlink(missing_ok=True)


class TargetSender:
    """Sender of one stream of targets, in a client."""

    def __init__(self, name: str, process_id: int, stream_number: int) -> None:
        """Connect to the target socket of the controller on the bus ``name``.

        Raises:
            BusError: no controller receives targets for this bus.
        """
        self._head = process_id, stream_number
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            self._socket.connect(str(targets_path(name)))
        except OSError:
            self._socket.close()
            raise BusError(
                "no controller accepts targets", f"bus {name}", "a running handctl run"
            ) from None
        self._socket.setblocking(False)

    def send(self, target_number: int, sent_ns: int, values: NDArray[np.float64]) -> bool:
        """Send a target.

        If the socket is full of targets that the controller has not read yet, return False.

        Args:
            target_number: number of the target in the stream.
            sent_ns: reading of CLOCK_MONOTONIC when the target is sent [ns].
            values: (V,) values of the target.

        Raises:
            OSError: the controller no longer receives targets, because its run has ended.
        """
        process_id, stream_number = self._head
        data = (
            HEADER_STRUCT.pack(
                TARGET_MAGIC, process_id, stream_number, len(values), target_number, sent_ns
            )
            + values.astype("<f8").tobytes()
        )
        try:
            self._socket.send(data)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
