"""The local bus ``local:NAME``: a Unix stream socket to the hub.

The hub is the part of the simulator that serves the bus. Each CAN frame is one record on the socket
of the bus. A batch of frames is sent or read with a single system call.

    can_id 32 | length 8 | flags 8 | dropped 16 | data 64 x 8

A record has 72 bytes, in the layout of ``struct canfd_frame`` of Linux. The two reserved bytes of a
record count, modulo 65536, how many frames the hub has dropped that should have reached the
receiver of the record. A Unix socket reports no times of reception. Therefore each frame on the
local bus gets the time at which the host read it.
"""

import socket
import struct
import time
from collections.abc import Sequence

from handctl.drives.frame import ERROR_FLAG, Frame
from handctl.drives.frame_records import NO_FRAMES, Frames, concatenate_frames
from handctl.errors import BusError, NoSimulatorError
from handctl.runtime.buses.bus_events import BusEvent, BusEvents
from handctl.runtime.buses.canfd_structs import (
    CANFD_FRAME_BYTES,
    FrameStructs,
    data_and_error_frames,
)
from handctl.runtime.buses.contract import TimeConversion, check_payload_size
from handctl.runtime.socket_paths import local_bus_path
from handctl.runtime.socket_peers import is_served_by_same_user

FRAME_RECORD_STRUCT = struct.Struct("<IBBH64s")
"""One record: identifier with flag bits, length, flags, number of dropped frames modulo 65536, payload."""
SOCKET_BUFFER_BYTES = 1 << 20
"""Size of the socket buffer requested for each direction [bytes]."""
MAX_RECORDS_PER_READ = 4096
"""Largest number of records that one read returns."""
INITIAL_SEND_CAPACITY_RECORDS = 64
"""Initial size of the send buffer [records]. The buffer grows for larger batches."""
QUEUE_REPORT_ID = 0xE0000000
"""Identifier of a queue report.

With a queue report, the hub informs a client about the client's transmit queue on a simulated wire.
A hub that simulates no wire sends no queue report, and limits no transmit queue.
"""
QUEUE_REPORT_STRUCT = struct.Struct("<II")
"""Payload of a queue report: number of a client's frames that have left the queue (modulo 2**32), queue capacity."""
MAX_READS_PER_DRAIN = 4
"""Largest number of reads in one ``drain``.

Because of the limit, a flood of frames cannot delay a tick.
"""
CONNECT_TIMEOUT_S = 2.0
"""Longest wait for the hub to accept the connection [s]."""


def connect_to_hub(name: str) -> socket.socket:
    """Connect to the hub that serves ``local:NAME``, and return the socket.

    Raises:
        NoSimulatorError: no process serves the bus ``local:NAME``.
        BusError: the hub belongs to another user.
    """
    path = local_bus_path(name)
    link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        link.setsockopt(socket.SOL_SOCKET, option, SOCKET_BUFFER_BYTES)
    link.settimeout(CONNECT_TIMEOUT_S)
    try:
        link.connect(str(path))
    except OSError as error:
        link.close()
        raise NoSimulatorError(f"local:{name}", error.strerror or str(error)) from None
    if not is_served_by_same_user(link):
        link.close()
        raise BusError("another user serves this bus", f"local:{name}", "a simulator of your own")
    link.setblocking(False)
    return link


class LocalBus:
    """Client of a local bus. The interface ``contract.Bus`` describes the methods of the class.

    Attributes:
        name: specification of the bus.
        early_frames: frames read during a ``send``. The next ``drain`` returns these frames before
            all others.
    """

    def __init__(
        self,
        channel: str,
        index: int,
        convert_time: TimeConversion,
        max_records: int = MAX_RECORDS_PER_READ,
    ) -> None:
        """Connect to the hub of the bus.

        Args:
            channel: name of the bus.
            index: index of the bus in the list of the hand's buses.
            convert_time: function that converts a CLOCK_MONOTONIC time to the time of the run [ns].
            max_records: largest number of records per read. If ``max_records`` is 1, the socket
                stays readable as long as a frame waits to be read.

        Raises:
            BusError: no process serves a bus of this name.
        """
        self._socket = connect_to_hub(channel)
        self.name = f"local:{channel}"
        self._index = index
        self._convert_time = convert_time
        self._events = BusEvents(self.name)
        memory = bytearray(max_records * CANFD_FRAME_BYTES)
        self._buffer = memoryview(memory)
        self._structs = FrameStructs(memory)
        self._allocate_send_buffer(INITIAL_SEND_CAPACITY_RECORDS)
        self._reads = min(MAX_READS_PER_DRAIN, max_records)
        self._partial_record_bytes = 0
        self._unsent_bytes = b""
        self._dropped = 0
        self.early_frames = NO_FRAMES
        self._sent_count = self._transmitted_count = self._queue_frames = 0
        self._closed = False

    def _allocate_send_buffer(self, count: int) -> None:
        """Allocate a send buffer for ``count`` records."""
        memory = bytearray(count * CANFD_FRAME_BYTES)
        self._out = memoryview(memory)
        self._out_structs = FrameStructs(memory)

    def drain(self) -> Frames:
        """Return all received frames, see ``contract.Bus``."""
        frame_batches = []
        if self.early_frames is not NO_FRAMES:
            frame_batches.append(self.early_frames)
            self.early_frames = NO_FRAMES
        for _ in range(self._reads):
            partial_size = self._partial_record_bytes
            size = self._read(self._buffer[partial_size:] if partial_size else self._buffer)
            if size:
                frame_batches.append(self._frames_of_complete_records(partial_size + size))
            if size < len(self._buffer) - partial_size:
                break
        return concatenate_frames(frame_batches)

    def _read(self, buffer: memoryview) -> int:
        """Read from the socket into a buffer.

        Return the number of bytes, or 0 if no data have arrived.
        """
        if self._closed:
            return 0
        try:
            size = self._socket.recv_into(buffer)
        except BlockingIOError:
            return 0
        except OSError:
            size = 0
        if size == 0:  # the stream has ended, because the hub has closed the connection
            self._report_lost_hub()
        return size

    def _report_lost_hub(self) -> None:
        """Begin the lasting state ``enodev``. From now on, each call of ``take_events`` reports the end of the hub."""
        self._closed = True
        self._events.set_persistent_event("enodev", True)

    def _frames_of_complete_records(self, filled_bytes: int) -> Frames:
        """Return the frames in the complete records of the first ``filled_bytes`` bytes of the buffer.

        If the last record is incomplete, its beginning stays in the buffer for the next read.
        """
        count, self._partial_record_bytes = divmod(filled_bytes, CANFD_FRAME_BYTES)
        if not count:
            return NO_FRAMES
        structs = self._structs
        frames, has_error_frames = structs.read(
            count, self._convert_time(time.monotonic_ns()), self._index
        )
        if has_error_frames:
            frames, errors = data_and_error_frames(frames)
            for frame in errors:
                self._take_control(frame.can_id, frame.data)
        self._count_dropped_frames(structs.reserved_bits(count - 1))
        if self._partial_record_bytes:
            self._buffer[: self._partial_record_bytes] = self._buffer[
                filled_bytes - self._partial_record_bytes : filled_bytes
            ]
        return frames

    def receive_one(self) -> Frame | None:
        """Return the next frame as an object, or None if no frame has arrived.

        The method ``receive_one`` is for programs that process one frame at a time.
        """
        if self.early_frames:
            frame = self.early_frames[0]
            self.early_frames = self.early_frames[1:]
            return frame
        filled_size = self._partial_record_bytes + self._read(
            self._buffer[self._partial_record_bytes : CANFD_FRAME_BYTES]
        )
        self._partial_record_bytes = filled_size % CANFD_FRAME_BYTES
        if filled_size < CANFD_FRAME_BYTES:
            return None
        can_id, length, flags, lost_count, data = FRAME_RECORD_STRUCT.unpack_from(self._buffer)
        self._count_dropped_frames(lost_count)
        if can_id & ERROR_FLAG:
            self._take_control(can_id, data[:length])
            return None
        return Frame(
            can_id, data[:length], flags, self._index, self._convert_time(time.monotonic_ns())
        )

    def _count_dropped_frames(self, hub_drop_count: int) -> None:
        """Count the frames that the hub has dropped since the last record.

        The argument ``hub_drop_count`` is the hub's counter of dropped frames, modulo 65536.
        """
        if hub_drop_count != self._dropped:
            self._events.add_event("dropped", (hub_drop_count - self._dropped) & 0xFFFF)
            self._dropped = hub_drop_count

    def _take_control(self, can_id: int, data: bytes) -> None:
        """Process a control frame: either an error frame, or a report of the hub about the transmit queue."""
        if can_id == QUEUE_REPORT_ID:
            self._transmitted_count, self._queue_frames = QUEUE_REPORT_STRUCT.unpack(data)
        else:
            self._events.add_error_frame(can_id, data)

    def _frames_fitting_queue(self, frames: Sequence[Frame]) -> Sequence[Frame]:
        """Return the first frames of a batch, as many as the transmit queue has room for.

        The frames that do not fit into the transmit queue count as refused.
        """
        if len(frames) > self._free_queue_places():
            # The hub may have reported a change of the transmit queue since the last read.
            self.early_frames = self.drain()
        free_queue_places = self._free_queue_places()
        if len(frames) > free_queue_places:
            self._events.add_event("enobufs", len(frames) - free_queue_places)
        return frames[:free_queue_places]

    def _free_queue_places(self) -> int:
        """Return the number of frames for which the queue of the simulated wire still has room."""
        unsent_size = (
            self._sent_count - self._transmitted_count & 0xFFFFFFFF
        )  # the hub counts frames modulo 2**32
        return max(0, self._queue_frames - unsent_size)

    def send(self, frames: Sequence[Frame]) -> int:
        """Send a batch of frames, and return the number of accepted frames, see ``contract.Bus``."""
        if self._queue_frames:
            frames = self._frames_fitting_queue(frames)
        records = self._pack_records(frames)
        unsent_records = self._unsent_bytes + records if self._unsent_bytes else records
        if self._closed or not unsent_records:
            return 0
        try:
            sent_size = self._socket.send(unsent_records)
        except BlockingIOError:
            sent_size = 0
        except OSError:
            self._report_lost_hub()
            return 0
        if sent_size == len(unsent_records):
            self._unsent_bytes = b""
            accepted = len(frames)
        else:
            accepted = self._keep_partial_record(unsent_records, sent_size, len(frames))
        self._sent_count += accepted
        return accepted

    def _pack_records(self, frames: Sequence[Frame]) -> bytes | memoryview:
        """Convert frames to the records that are sent to the hub, and return the records."""
        if not isinstance(frames, Frames):
            for frame in frames:
                check_payload_size(frame)
            return b"".join(
                [
                    FRAME_RECORD_STRUCT.pack(can_id, len(data), flags, 0, data)
                    for can_id, data, flags, _, _ in frames
                ]
            )
        count = len(frames.rows)
        if count > self._out_structs.count:
            self._allocate_send_buffer(2 * count)
        self._out_structs.write(frames)
        return self._out[: CANFD_FRAME_BYTES * count]

    def _keep_partial_record(
        self, unsent_bytes: bytes | memoryview, sent_size: int, frames: int
    ) -> int:
        """Store the unsent rest of a partly sent record, so that the next call sends the rest.

        All records after the partly sent record are dropped.

        Args:
            unsent_bytes: unsent part of the previous batch, followed by this batch.
            sent_size: number of bytes of ``unsent_bytes`` accepted by the socket.
            frames: number of frames in this batch.

        Returns:
            the number of accepted frames. A partly sent frame counts as accepted.
        """
        unsent_size_before = len(self._unsent_bytes)
        # Division of two integers, rounded up.
        accepted = max(0, -((unsent_size_before - sent_size) // CANFD_FRAME_BYTES))
        self._unsent_bytes = bytes(
            unsent_bytes[sent_size : unsent_size_before + accepted * CANFD_FRAME_BYTES]
        )
        if frames > accepted:
            self._events.add_event("enobufs", frames - accepted)
        return accepted

    def take_events(self) -> list[BusEvent]:
        """Return the events since the last call, see ``contract.Bus``."""
        return self._events.take_events()

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._closed = True
        self._socket.close()
