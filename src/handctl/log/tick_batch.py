"""Batches of ticks. A batch contains the data of many ticks as arrays."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import ORIGINAL_TELEMETRY_FIELD_COUNT, TELEMETRY_AXES, TELEMETRY_FIELDS
from handctl.log.header import RunHeader
from handctl.log.tick_record import (
    FRAME_RECORD_BYTES,
    TICK_HEAD_STRUCT,
    TICK_SIZES_STRUCT,
    TickRecord,
    message_layout,
    unpack_tick,
)

FRAME_DTYPE = np.dtype(
    [
        ("t_ns", "<i8"),
        ("can_id", "<u4"),
        ("flags", "<u2"),
        ("bus", "u1"),
        ("length", "u1"),
        ("data", "u1", (8,)),
    ]
)
"""Layout of a CAN frame in a Tick message, 24 bytes little-endian."""
TICK_HEAD_DTYPE = np.dtype(
    {
        "names": ["k", "t_ns", "late_ns", "state_hash", "mode", "action"],
        "formats": ["<i8", "<i8", "<i8", "V8", "u1", "u1"],
        "offsets": [0, 8, 16, 24, 32, 33],
        "itemsize": TICK_HEAD_STRUCT.size,
    }
)
"""Layout of the first part of a Tick message.

The first part of a Tick message has a constant length. The hash of the controller's state is stored
as raw bytes (V8).
"""
_MAX_CACHED_MESSAGE_TAILS = 256
"""Largest number of ends of Tick messages in the cache.

The end of a Tick message contains phase, io events, requests and events. If the ticks of one grasp
phase have no events and no requests, their messages have the same end.
"""


class FrameBatch(NamedTuple):
    """CAN frames of many ticks, in the order of the ticks.

    Attributes:
        frames: (m,) the frames, as FRAME_DTYPE.
        tick_indexes: (m,) for each frame, the index of its tick.
        long_data: payload bytes after the eighth byte, for all frames with more than eight bytes,
            in the order of the frames.
    """

    frames: NDArray[np.void]
    tick_indexes: NDArray[np.intp]
    long_data: bytes


class TickBatch(NamedTuple):
    """Data of n ticks as arrays.

    Attributes:
        messages: the Tick message of each tick.
        k: (n,) tick numbers.
        t_ns, late_ns: (n,) time since the start of the run, and lateness of each tick [ns].
        mode, action: (n,) mode and reaction to faults in each tick, as uint8.
        phases: grasp phase of each tick.
        numbers: (n, columns) telemetry of each tick, in the order of Telemetry.to_bytes.
        received, sent: CAN frames that the controller has received and sent.
        ticks_with_events: decoded record of each tick with events, requests or io events, by the
            index of the tick.
    """

    messages: list[bytes]
    k: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    late_ns: NDArray[np.int64]
    mode: NDArray[np.uint8]
    action: NDArray[np.uint8]
    phases: list[str]
    numbers: NDArray[np.float64]
    received: FrameBatch
    sent: FrameBatch
    ticks_with_events: dict[int, TickRecord]


def row_field_names(header: RunHeader, width: int) -> tuple[str, ...]:
    """Return the telemetry fields that a row of `width` columns contains.

    Logs of earlier versions of handctl do not contain the last telemetry fields.

    Args:
        header: header of the run.
        width: number of columns of a row.
    """
    earlier_fields = TELEMETRY_FIELDS[:ORIGINAL_TELEMETRY_FIELD_COUNT]
    return earlier_fields if width == column_count(header, earlier_fields) else TELEMETRY_FIELDS


def column_count(header: RunHeader, fields: tuple[str, ...]) -> int:
    """Return the number of columns that the given telemetry fields have together."""
    return sum(len(header.axis_names(TELEMETRY_AXES[name])) for name in fields)


def columns_of_fields(
    header: RunHeader, fields: tuple[str, ...] = TELEMETRY_FIELDS
) -> dict[str, slice]:
    """Return, for each telemetry field, the columns that it has in a telemetry row.

    Args:
        header: header of the run.
        fields: fields of the row, in order.
    """
    slices = {}
    start = 0
    for name in fields:
        size = len(header.axis_names(TELEMETRY_AXES[name]))
        slices[name] = slice(start, start + size)
        start += size
    return slices


@dataclass(slots=True)
class _FrameCollector:
    """Collector of CAN frames in one direction (received or sent).

    The frames are added tick by tick.

    Attributes:
        parts: frames of each tick as FRAME_DTYPE bytes.
        counts: number of frames of each tick.
        long_payload_ends: payload bytes after the eighth byte of each frame with more than eight bytes.
    """

    parts: list[bytes] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    long_payload_ends: list[bytes] = field(default_factory=list)

    def collected_frames(self) -> FrameBatch:
        """Return the collected frames of all ticks."""
        tick = np.repeat(np.arange(len(self.counts)), self.counts)
        return FrameBatch(
            np.frombuffer(b"".join(self.parts), FRAME_DTYPE), tick, b"".join(self.long_payload_ends)
        )


class TickBatcher:
    """Collector of tick records.

    The method `take_batch` returns the collected ticks as a batch.

    Attributes:
        misshapen_ticks: number of ticks whose telemetry has not the shape that the header
            describes.
        size: total length of the collected records [bytes].
    """

    def __init__(self, header: RunHeader) -> None:
        """Start with an empty batch.

        Args:
            header: header of the run, with the number of telemetry columns.
        """
        self._axis_lengths = tuple(
            len(header.axis_names(name)) for name in ("joint", "tendon", "motor", "digit")
        )
        self._width = sum(len(header.axis_names(axis)) for axis in TELEMETRY_AXES.values())
        self._phase_of_tail: dict[bytes, str] = {}
        self.misshapen_ticks = 0
        self._clear()

    def _clear(self) -> None:
        self._messages: list[bytes] = []
        self._numbers: list[bytes] = []
        self._phases: list[str] = []
        self._ticks_with_events: dict[int, TickRecord] = {}
        self._received = _FrameCollector()
        self._sent = _FrameCollector()
        self.size = 0

    def __len__(self) -> int:
        """Return the number of ticks in the batch."""
        return len(self._messages)

    def add_tick(self, body: bytes) -> int:
        """Add one tick, and return the time [ns] of the tick since the start of the run.

        If the telemetry has a wrong shape, all values of the telemetry become NaN, and the number
        `misshapen_ticks` increases by 1.

        Args:
            body: body of the record of a tick, see `handctl.log.tick_record`.
        """
        message_size, *axis_lengths = TICK_SIZES_STRUCT.unpack_from(body)
        message = body[TICK_SIZES_STRUCT.size : TICK_SIZES_STRUCT.size + message_size]
        telemetry_bytes = body[TICK_SIZES_STRUCT.size + message_size :]
        if tuple(axis_lengths) != self._axis_lengths or len(telemetry_bytes) != 8 * self._width:
            self.misshapen_ticks += 1
            telemetry_bytes = np.full(self._width, np.nan).tobytes()
        self._numbers.append(telemetry_bytes)
        self._add_frames(message)
        self._messages.append(message)
        self.size += len(body)
        return int(TICK_HEAD_STRUCT.unpack_from(message, 4)[1])

    def _add_frames(self, message: bytes) -> None:
        """Add the received and the sent frames of a Tick message, and then process the rest of the message."""
        message_slices = message_layout(message)
        for direction, frames_slice in (
            (self._received, message_slices.received),
            (self._sent, message_slices.sent),
        ):
            direction.parts.append(message[frames_slice])
            direction.counts.append((frames_slice.stop - frames_slice.start) // FRAME_RECORD_BYTES)
        if message_slices.long_data.stop > message_slices.long_data.start:
            self._add_long_payloads(message[message_slices.long_data])
        self._add_phase_and_events(message, message_slices.tail_offset)

    def _add_long_payloads(self, data: bytes) -> None:
        """Add the payload bytes after the eighth byte of each received frame and of each sent frame of a tick."""
        lengths = np.frombuffer(self._received.parts[-1], FRAME_DTYPE)["length"].astype(int)
        # In the message, the bytes of all received frames come before the bytes of all sent frames.
        received_size = int(np.maximum(lengths - 8, 0).sum())
        self._received.long_payload_ends.append(data[:received_size])
        self._sent.long_payload_ends.append(data[received_size:])

    def _add_phase_and_events(self, message: bytes, offset: int) -> None:
        """Add the grasp phase that a Tick message contains.

        If the tick has events, requests or io events, the method also decodes the whole Tick
        message and stores the result.

        Args:
            message: the Tick message.
            offset: offset of the phase in the message [bytes].
        """
        # Nearly all ticks have no events. The Tick message of a tick without events ends with the
        # phase and empty lists. The last bytes of the message are the same in all ticks of one
        # grasp phase without events. The cache `_phase_of_tail` contains the phase of last bytes
        # that have already been decoded.
        tail_bytes = message[offset:]
        phase = self._phase_of_tail.get(tail_bytes)
        if phase is None:
            tick = unpack_tick(message)
            phase = tick.phase
            if tick.events or tick.tick_in.requests or tick.tick_in.io_events:
                self._ticks_with_events[len(self._messages)] = tick
            elif len(self._phase_of_tail) < _MAX_CACHED_MESSAGE_TAILS:
                self._phase_of_tail[tail_bytes] = phase
        self._phases.append(phase)

    def take_batch(self) -> TickBatch:
        """Return all ticks that were added since the last call, as one batch, and begin a new batch."""
        # In each message, four bytes (the CDR encapsulation) come before the first part, whose
        # length is constant.
        tick_heads = np.frombuffer(
            b"".join([message[4 : 4 + TICK_HEAD_STRUCT.size] for message in self._messages]),
            TICK_HEAD_DTYPE,
        )
        numbers = np.frombuffer(b"".join(self._numbers), "<f8").reshape(
            len(tick_heads), self._width
        )
        batch = TickBatch(
            self._messages, tick_heads["k"], tick_heads["t_ns"], tick_heads["late_ns"], tick_heads["mode"],
            tick_heads["action"], self._phases,
            numbers, self._received.collected_frames(), self._sent.collected_frames(), self._ticks_with_events,
        )  # fmt: skip
        self._clear()
        return batch
