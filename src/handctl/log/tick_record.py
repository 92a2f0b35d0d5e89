"""Records that the controller writes into the pipe to the recorder.

The record of a tick contains the telemetry and a `handctl_msgs/Tick` message. The Tick message has
the same encoding in the pipe and in the log.

All numbers are little-endian.

Record: length of the body (u32), kind (u32), body.

Body of a tick: size of the Tick message (u32), numbers of joints, tendons, motors and digits (u16
each), Tick message, telemetry. The telemetry consists of float64 numbers in the order of the
fields.

Tick message:
    CDR encapsulation, 4 bytes.
    k i64, t_ns i64, late_ns i64, state hash 8 bytes, mode u8, action u8, padding 2 bytes.
    Number of received frames u32, received frames.
    Number of sent frames u32, padding of 4 bytes if there are sent frames, sent frames.
    Number of long bytes u32, long bytes, padding to 4 bytes.
    Phase, io events, requests, events.

Frame, 24 bytes: t_ns i64, can_id u32, flags u16, bus u8, length u8, data 8 bytes. The field data
contains the first 8 bytes of the payload. The long bytes are all further payload bytes, in the
order of the frames.
"""

import functools
import struct
from enum import IntEnum
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import (
    TELEMETRY_AXES,
    TELEMETRY_FIELDS,
    HandMode,
    IoEvent,
    Telemetry,
    TickEvent,
    TickIn,
    TickOut,
)
from handctl.drives.frame import make_tuple
from handctl.drives.frame_records import (
    CLASSICAL_RECORD_BYTES,
    FRAME_RECORD_DTYPE,
    NO_FRAMES,
    Frames,
    RecordArray,
)
from handctl.log.cdr import ENCAPSULATION_HEADER, CdrReader, CdrWriter
from handctl.safety.safety_action import SafetyAction

RECORD_FRAMING_STRUCT = struct.Struct("<II")
HEADER_RECORD_KIND = 1
"""Kind of the record that contains the header of a run, as `RunHeader.dump` encodes it."""
TICK_RECORD_KIND = 2
"""Kind of the record of one tick."""
END_RECORD_KIND = 3
"""Kind of the record that contains the reason for the end of the run, as JSON."""
SNAPSHOT_RECORD_KIND = 4
"""Kind of the record that contains the controller's state after a tick."""
FILE_RECORD_KIND = 5
"""Kind of the first record.

The first record gives the path of the log, and the free disk space [bytes] at which the log ends
early, as JSON.
"""
SNAPSHOT_HEAD_STRUCT = struct.Struct("<qqI")
"""Layout of the start of a snapshot record: number and time [ns] of the tick, size of the numbers [bytes].

In the snapshot record, the numbers and the serialized decisions of the controller's state after the
tick follow this start.
"""

TICK_SIZES_STRUCT = struct.Struct("<IHHHH")
"""Layout of the start of the body of a tick's record: size of the Tick message, lengths of the telemetry axes."""
TICK_HEAD_STRUCT = struct.Struct("<qqq8sBB2xI")
"""Layout of a Tick message's first part: k, t_ns, late_ns, state hash, mode, action, number of received frames."""
FRAME_RECORD_BYTES = CLASSICAL_RECORD_BYTES
"""Size of a CAN frame in a Tick message [bytes].

The size includes eight data bytes. Further data bytes of a long frame come after the frames.
"""
_CLASSICAL_FRAME_DTYPE = np.dtype(f"V{CLASSICAL_RECORD_BYTES}")
"""numpy type of a frame in a Tick message, as raw bytes."""
_LENGTH_OFFSET = 15
"""Offset of the length byte in a frame of a Tick message."""
_DATA_OFFSET = 16
"""Offset of the data bytes in a frame of a Tick message."""
_DATA_WORD_DTYPE = np.dtype("<u8")
"""numpy type of the eight data bytes of a frame, as one word."""
SHORT_DATA_BYTES = 8
"""Number of data bytes in a frame of a Tick message."""
_MAX_DATA_BYTES = 64
"""Number of data bytes in the longest CAN FD frame."""
_DATA_MASK_BY_LENGTH = np.array(
    [(1 << 8 * length) - 1 for length in range(SHORT_DATA_BYTES + 1)], np.uint64
)
"""Mask of the used bytes in the data word, for each payload length from 0 to 8 bytes."""
_LONG_DATA_INDEXES = np.arange(SHORT_DATA_BYTES, _MAX_DATA_BYTES)
"""Indexes of the payload bytes after the eighth."""
_FRAMES_OFFSET = TICK_HEAD_STRUCT.size + 4
"""Offset of the received frames in a Tick message [bytes]."""
COUNT_STRUCT = struct.Struct("<I")
NO_LONG_DATA = COUNT_STRUCT.pack(0)
"""Encoded number of long bytes of a tick whose frames have no long bytes."""
E = TypeVar("E", bound=IntEnum)
_TickHead = tuple[int, int, int, bytes, int, int, int]
"""Values of the first part of a Tick message."""


class _MembersByValue(dict[int, E]):
    """Members of an enumeration by value.

    A dictionary finds a member four times as fast as a call of the enumeration. A value without a
    member is passed to the enumeration, which raises ValueError.
    """

    def __init__(self, enumeration: type[E]) -> None:
        """Store all members of an enumeration whose values are integers."""
        super().__init__({member.value: member for member in enumeration})
        self._enumeration = enumeration

    def __missing__(self, value: int) -> E:
        """Raise the error of the enumeration for a value without a member."""
        return self._enumeration(value)


_MODE_BY_VALUE = _MembersByValue(HandMode)
_ACTION_BY_VALUE = _MembersByValue(SafetyAction)


class TickRecord(NamedTuple):
    """Tick that was read from a log, without telemetry.

    Attributes:
        tick_in: all inputs of the tick.
        frames: frames sent in the tick, in order.
        mode, phase, action, events, state_hash: outputs of the tick, as in TickOut.
    """

    tick_in: TickIn
    frames: Frames
    mode: HandMode
    phase: str
    action: SafetyAction
    events: tuple[TickEvent, ...]
    state_hash: bytes


def long_data_mask(records: RecordArray) -> NDArray[np.bool_]:
    """Return the mask (n, 56) of the used payload bytes after the eighth byte, for n frames.

    The mask is True for bytes that belong to the payload of the frame, and False beyond the end of
    the payload.
    """
    return np.asarray(records["length"][:, np.newaxis] > _LONG_DATA_INDEXES)


@functools.lru_cache(maxsize=64)
def eventless_message_tail(phase: str) -> bytes:
    """Return the last bytes of a Tick message without events: the phase and three empty sequences.

    The last bytes depend only on the phase if they begin at a multiple of four bytes in the
    message. The cache of the function contains one result for each phase.
    """
    writer = CdrWriter()
    writer.put_string(phase)
    for _ in range(3):
        writer.put_length(0)
    return bytes(writer.data)


class MessageLayout(NamedTuple):
    """Positions of the parts of a Tick message.

    Attributes:
        received, sent: slices of the received frames and of the sent frames.
        long_data: slice of the payload bytes after the eighth byte of all frames.
        tail_offset: offset of the phase in the message [bytes]. The lists of events and requests
            follow the phase.
    """

    received: slice
    sent: slice
    long_data: slice
    tail_offset: int


def message_layout(message: bytes) -> MessageLayout:
    """Return the byte positions of the parts of an encoded Tick message.

    Raises:
        struct.error: the message ends early.
    """
    (received_count,) = COUNT_STRUCT.unpack_from(message, TICK_HEAD_STRUCT.size)
    start = TICK_HEAD_STRUCT.size + 4
    end = TICK_HEAD_STRUCT.size + 4 + FRAME_RECORD_BYTES * received_count
    (sent_count,) = COUNT_STRUCT.unpack_from(message, end)
    # Before the sent frames, the message is padded to 8 bytes. Without sent frames, the message has
    # no padding to 8 bytes.
    sent_frames_start = end + 8 if sent_count else end + 4
    sent_frames_end = sent_frames_start + FRAME_RECORD_BYTES * sent_count
    (size,) = COUNT_STRUCT.unpack_from(message, sent_frames_end)
    long_data = slice(sent_frames_end + 4, sent_frames_end + 4 + size)
    # The payload bytes after the eighth byte can end at any offset. The text that follows the
    # payload bytes is aligned to 4 bytes.
    return MessageLayout(
        slice(start, end),
        slice(sent_frames_start, sent_frames_end),
        long_data,
        long_data.stop + -size % 4,
    )


def _decode_frames(frame_starts: bytes, long_data: bytes) -> tuple[Frames, bytes]:
    """Return the decoded frames, and the bytes of `long_data` that these frames do not use.

    The returned bytes of `long_data` belong to frames that come later in the record.

    Args:
        frame_starts: first FRAME_RECORD_BYTES bytes of each frame.
        long_data: payload bytes after the eighth byte of these frames, followed by those of later
            frames.

    Raises:
        ValueError: a payload is too long, or bytes of a payload are missing.
    """
    lengths = frame_starts[_LENGTH_OFFSET::FRAME_RECORD_BYTES]
    count = len(frame_starts) // FRAME_RECORD_BYTES
    if not count:
        return NO_FRAMES, long_data
    records = np.zeros(count, FRAME_RECORD_DTYPE)
    records.setfield(np.frombuffer(frame_starts, _CLASSICAL_FRAME_DTYPE), _CLASSICAL_FRAME_DTYPE, 0)
    max_length = max(lengths)
    if max_length > _MAX_DATA_BYTES:
        raise ValueError(f"payload of {max_length} bytes, expected at most {_MAX_DATA_BYTES}")
    if lengths.count(SHORT_DATA_BYTES) < count:
        _zero_unused_bytes(records)
    if max_length > SHORT_DATA_BYTES:
        long_payload_mask = long_data_mask(records)
        size = int(long_payload_mask.sum())
        if size > len(long_data):
            raise ValueError("less data than frames")
        records["data"][:, SHORT_DATA_BYTES:][long_payload_mask] = np.frombuffer(
            long_data[:size], np.uint8
        )
        long_data = long_data[size:]
    return Frames.from_records(records), long_data


def _zero_unused_bytes(records: RecordArray) -> None:
    """Set the unused data bytes of short payloads to zero.

    In a damaged file, the unused data bytes can have any value.
    """
    words = records.getfield(_DATA_WORD_DTYPE, _DATA_OFFSET)
    words &= _DATA_MASK_BY_LENGTH[np.minimum(records["length"], SHORT_DATA_BYTES)]


@functools.lru_cache(maxsize=256)
def _phase_of_eventless_tail(message_tail: bytes) -> str | None:
    """Return the phase at the end of a Tick message without events, or None if the message has events."""
    phase = CdrReader(ENCAPSULATION_HEADER + message_tail).read_string()
    return phase if eventless_message_tail(phase) == message_tail else None


def unpack_tick(message: bytes) -> TickRecord:
    """Decode a Tick message that `pack_tick` has encoded.

    Raises:
        ValueError: the bytes are not a Tick message.
    """
    if message[:4] != ENCAPSULATION_HEADER:
        raise ValueError("not little-endian CDR")
    try:
        message_slices = message_layout(message)
        frames_in, remaining_bytes = _decode_frames(
            message[message_slices.received], message[message_slices.long_data]
        )
        frames_out, remaining_bytes = _decode_frames(message[message_slices.sent], remaining_bytes)
        if remaining_bytes:
            raise ValueError("more data than frames")
        return _build_tick(
            TICK_HEAD_STRUCT.unpack_from(message, 4),
            frames_in,
            frames_out,
            message,
            message_slices.tail_offset,
        )
    except struct.error as error:
        raise ValueError(f"the message ends early: {error}") from None


def _build_tick(
    tick_head: _TickHead,
    received_frames: Frames,
    sent_frames: Frames,
    message: bytes,
    tail_offset: int,
) -> TickRecord:
    """Build a tick from the parts of a Tick message.

    Args:
        tick_head: values of the first part of the message.
        received_frames: frames received in the tick.
        sent_frames: frames sent in the tick.
        message: the whole Tick message.
        tail_offset: offset of the phase in the message [bytes].
    """
    k, t_ns, lateness_ns, state_hash, mode, action, _ = tick_head
    io_events: tuple[IoEvent, ...] = ()
    requests: tuple[str, ...] = ()
    events: tuple[TickEvent, ...] = ()
    phase = _phase_of_eventless_tail(message[tail_offset:])
    if phase is None:
        phase, io_events, requests, events = _decode_message_end(message, tail_offset)
    tick_input = make_tuple(TickIn, (k, t_ns, lateness_ns, received_frames, io_events, requests))
    return make_tuple(TickRecord, (
        tick_input, sent_frames, _MODE_BY_VALUE[mode], phase, _ACTION_BY_VALUE[action], events,
        state_hash,
    ))  # fmt: skip


def _decode_message_end(
    message: bytes, tail_offset: int
) -> tuple[str, tuple[IoEvent, ...], tuple[str, ...], tuple[TickEvent, ...]]:
    """Decode the phase, the io events, the requests and the events at the end of a Tick message."""
    reader = CdrReader(message)
    reader.read_bytes(tail_offset - 4)
    phase = reader.read_string()
    io_events = tuple(
        IoEvent(reader.read_string(), reader.read_string(), reader.read_int64())
        for _ in range(reader.read_length())
    )
    requests = tuple(reader.read_string() for _ in range(reader.read_length()))
    events = tuple(
        TickEvent(
            reader.read_string(), reader.read_string(), reader.read_string(), reader.read_string()
        )
        for _ in range(reader.read_length())
    )
    return phase, io_events, requests, events


def unpack_ticks(messages: list[bytes]) -> list[TickRecord]:
    """Decode all Tick messages of a chunk.

    If all payloads are short, the CAN frames of all ticks are decoded at once, which is faster.

    Raises:
        ValueError: an element is not a Tick message.
    """
    short_ticks = _unpack_ticks_with_short_frames(messages)
    return (
        short_ticks if short_ticks is not None else [unpack_tick(message) for message in messages]
    )


def _unpack_ticks_with_short_frames(messages: list[bytes]) -> list[TickRecord] | None:
    """Decode Tick messages in which no payload is longer than eight bytes.

    Returns:
        the ticks. None if a message has a payload of more than eight bytes or ends early. If the
        result is None, the caller decodes each message with `unpack_tick`.
    """
    frame_parts = list[bytes]()
    end_indices = [0]
    tick_heads = list[_TickHead]()
    tail_offsets = list[int]()
    end = 0
    for message in messages:
        if message[:4] != ENCAPSULATION_HEADER:
            return None
        try:
            tick_head = TICK_HEAD_STRUCT.unpack_from(message, 4)
            sent_count_offset = _FRAMES_OFFSET + FRAME_RECORD_BYTES * tick_head[6]
            (frame_count_sent,) = COUNT_STRUCT.unpack_from(message, sent_count_offset)
        except struct.error:
            return None
        start = sent_count_offset + 8 if frame_count_sent else sent_count_offset + 4
        long_size_offset = start + FRAME_RECORD_BYTES * frame_count_sent
        if message[long_size_offset : long_size_offset + 4] != NO_LONG_DATA:
            return None
        # The frames of all messages are joined and decoded in one call. After the decoding, the
        # frames are divided among the messages again at `end_indices`.
        frame_parts += (
            message[_FRAMES_OFFSET:sent_count_offset],
            message[start:long_size_offset],
        )
        end_indices += end + tick_head[6], end + tick_head[6] + frame_count_sent
        end = end_indices[-1]
        tick_heads.append(tick_head)
        tail_offsets.append(long_size_offset + 4)
    joined_frames = b"".join(frame_parts)
    if max(joined_frames[_LENGTH_OFFSET::FRAME_RECORD_BYTES], default=0) > SHORT_DATA_BYTES:
        return None
    rows = _decode_frames(joined_frames, b"")[0].rows
    frames = [
        Frames(rows[first_frame:end_frame]) for first_frame, end_frame in pairwise(end_indices)
    ]
    return list(map(_build_tick, tick_heads, frames[::2], frames[1::2], messages, tail_offsets))


def unpack_tick_record(record: bytes) -> tuple[TickIn, TickOut]:
    """Decode a record that `pack_tick_record` has encoded for the pipe.

    Raises:
        ValueError: the bytes are not the record of a tick.
    """
    length, kind = RECORD_FRAMING_STRUCT.unpack_from(record)
    if kind != TICK_RECORD_KIND or length != len(record) - RECORD_FRAMING_STRUCT.size:
        raise ValueError("not the record of a tick")
    message_size, *axis_lengths = TICK_SIZES_STRUCT.unpack_from(record, RECORD_FRAMING_STRUCT.size)
    start = RECORD_FRAMING_STRUCT.size + TICK_SIZES_STRUCT.size
    tick = unpack_tick(record[start : start + message_size])
    lengths = dict(zip(("joint", "tendon", "motor", "digit"), axis_lengths, strict=True))
    end_indices = np.cumsum([lengths[TELEMETRY_AXES[name]] for name in TELEMETRY_FIELDS])
    field_values = np.split(np.frombuffer(record[start + message_size :], "<f8"), end_indices[:-1])
    telemetry = Telemetry(*field_values)
    tick_output = TickOut(
        tick.frames, tick.mode, tick.phase, tick.action, telemetry, tick.events, tick.state_hash
    )
    return tick.tick_in, tick_output
