"""Records that the controller writes into the pipe to the recorder.

The record of a tick is a `handctl_msgs/Tick` message, encoded as in the log, followed by the
telemetry.

All numbers are little-endian.

Record: length u32 (without these 8 bytes), kind u32, body.

Body of a tick: size of the Tick message u32, lengths of the telemetry axes joint, tendon, motor,
digit u16 each, the Tick message, the telemetry float64 in order.

Tick message:
    CDR encapsulation, 4 bytes.
    k i64, t_ns i64, late_ns i64, state hash 8 bytes, mode u8, action u8, padding 2 bytes.
    Number of received frames u32, received frames.
    Number of sent frames u32, padding 4 bytes if there are any, sent frames.
    Number of long bytes u32, long bytes, padding to 4 bytes.
    Phase, io events, requests, events.

Frame, 24 bytes: t_ns i64, can_id u32, flags u16, bus u8, length u8, data 8 bytes. The long bytes
are the bytes beyond the eighth of all frames, in order.
"""

import functools
import struct
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.types import (
    TELEMETRY_AXES,
    TELEMETRY_FIELDS,
    Event,
    IoEvent,
    Mode,
    PackedTelemetry,
    Telemetry,
    TickIn,
    TickOut,
)
from handctl.drives.records import NO_FRAMES, RECORD, SHORT_RECORD_BYTES, Frames, Records, frames_as_records
from handctl.log.cdr import ENCAPSULATION, CdrReader, CdrWriter
from handctl.safety.action import Action

FRAMING = struct.Struct("<II")
HEADER = 1
"""Kind of the record with the header of a run, from `RunHeader.dump`."""
TICK = 2
"""Kind of the record of one tick."""
END = 3
"""Kind of the record with the reason of the end, as JSON."""
SNAPSHOT = 4
"""Kind of the record with the state after a tick."""
FILE = 5
"""Kind of the record before the header: path of the log, and free space at which it ends early [bytes], as JSON."""
SNAPSHOT_HEAD = struct.Struct("<qq")
"""Layout of the start of a snapshot record: number and time [ns] of the tick.

The state after this tick follows.
"""

SIZES = struct.Struct("<IHHHH")
"""Layout of the start of a tick's body: size of the Tick message, lengths of the telemetry axes."""
FIXED = struct.Struct("<qqq8sBB2xI")
"""Layout of a Tick message's first part: k, t_ns, late_ns, state hash, mode, action, number of received frames."""
FRAME_SIZE = SHORT_RECORD_BYTES
"""Size of a frame in a Tick message [bytes]: the first part of its record, with eight data bytes."""
_BEGINNING = np.dtype(f"V{SHORT_RECORD_BYTES}")
"""numpy type of a frame as raw bytes."""
_LENGTH_AT = 15
"""Offset of the length byte in a frame."""
_DATA_AT = 16
"""Offset of the data in a frame."""
_DATA_WORD = np.dtype("<u8")
"""numpy type of a frame with the eight data bytes as one word."""
_SHORT_DATA = 8
"""Number of data bytes in a frame."""
_LONGEST = 64
"""Number of data bytes in the longest CAN FD frame."""
_MASKS = np.array([(1 << 8 * length) - 1 for length in range(_SHORT_DATA + 1)], np.uint64)
"""Mask of the data word for each payload length from 0 to 8 bytes."""
_LONG_INDEX = np.arange(_SHORT_DATA, _LONGEST)
"""Indexes of the data bytes beyond the eighth."""
_FRAMES_AT = FIXED.size + 4
"""Offset of the received frames in a message [bytes]."""
_Fixed = tuple[int, int, int, bytes, int, int, int]
"""Values of the first part of a Tick message."""
_MODES = {mode.value: mode for mode in Mode}
_ACTIONS = {action.value: action for action in Action}
"""Members of the enumeration by value.

A dictionary is four times as fast as calling the enumeration.
"""
new_tuple = tuple.__new__
"""Function that creates a named tuple without its constructor, for speed."""
_COUNT = struct.Struct("<I")
_NO_LONG_DATA = _COUNT.pack(0)
_FIELD_OF_EACH_AXIS = "q", "tension", "motor_torque", "contact"
"""One telemetry field for each axis: joint, tendon, motor, digit."""


class TickRecord(NamedTuple):
    """Tick in the log, without its telemetry.

    Attributes:
        tick_in: all inputs of the tick.
        frames: sent frames, in order.
        mode, phase, action, events, state_hash: outputs of the tick, as in TickOut.
    """

    tick_in: TickIn
    frames: Frames
    mode: Mode
    phase: str
    action: Action
    events: tuple[Event, ...]
    state_hash: bytes


def record_bytes(kind: int, body: bytes) -> bytes:
    """Return a record of the given kind."""
    return FRAMING.pack(len(body), kind) + body


def _long_mask(records: Records) -> NDArray[np.bool_]:
    """Return a mask (n, 56): True for each byte after the eighth that belongs to the payload."""
    return np.asarray(records["length"][:, np.newaxis] > _LONG_INDEX)


def _long_data(records: Records) -> bytes:
    """Return the payload bytes after the eighth of all frames."""
    return bytes(records["data"][:, _SHORT_DATA:][_long_mask(records)].tobytes())


@functools.lru_cache(maxsize=64)
def _tail_without_events(phase: str) -> bytes:
    """Return the end of a Tick message without events: the phase and three empty sequences.

    These bytes are equal at every offset divisible by four, so they are cached.
    """
    out = CdrWriter()
    out.text(phase)
    for _ in range(3):
        out.count(0)
    return bytes(out.data)


def _message_end(start: int, phase: str, tick_in: TickIn, events: tuple[Event, ...]) -> bytes:
    """Return the end of a Tick message: phase, io events, requests, events.

    Args:
        start: offset of the end in the message body, for alignment [bytes].
        phase: grasp phase.
        tick_in: inputs of the tick.
        events: events of the tick.
    """
    out = CdrWriter(start)
    out.text(phase)
    out.count(len(tick_in.io_events))
    for kind, where, number in tick_in.io_events:
        out.text(kind)
        out.text(where)
        out.put("q", number)
    out.texts(tick_in.requests)
    out.count(len(events))
    for event in events:
        for text in event:
            out.text(text)
    return bytes(out.data)


def pack_tick(tick_in: TickIn, out: TickOut) -> bytes:
    """Encode a tick as a handctl_msgs/Tick message.

    Raises:
        ValueError: state_hash is not 8 bytes long.
        struct.error: a number does not fit its field.
    """
    received = frames_as_records(tick_in.frames).records
    sent = frames_as_records(out.frames).records
    if len(out.state_hash) != 8:
        raise ValueError(f"state hash of {len(out.state_hash)} bytes; expected 8")
    fixed = FIXED.pack(
        tick_in.k,
        tick_in.t_ns,
        tick_in.late_ns,
        out.state_hash,
        out.mode,
        out.action,
        len(received),
    )
    beginnings = [records.getfield(_BEGINNING).tobytes() for records in (received, sent)]
    long_part = _NO_LONG_DATA
    # A slice with a stride reads the length bytes of all frames without decoding the frames.
    if max(b"".join([part[_LENGTH_AT::FRAME_SIZE] for part in beginnings]), default=0) > _SHORT_DATA:
        long_data = _long_data(received) + _long_data(sent)
        long_part = _COUNT.pack(len(long_data)) + long_data + bytes(-len(long_data) % 4)
    # The first member of a frame is an int64, therefore CDR aligns the frames to 8. An empty
    # sequence has no padding.
    padding = b"\0\0\0\0" if len(sent) else b""
    parts = [
        ENCAPSULATION,
        fixed,
        beginnings[0],
        _COUNT.pack(len(sent)),
        padding,
        beginnings[1],
        long_part,
    ]
    if tick_in.io_events or tick_in.requests or out.events:
        parts.append(_message_end(sum(map(len, parts)) - 4, out.phase, tick_in, out.events))
    else:
        parts.append(_tail_without_events(out.phase))
    return b"".join(parts)


def pack_tick_record(tick_in: TickIn, out: TickOut) -> bytes:
    """Encode a tick as a record for the pipe. Raises the errors of `pack_tick`."""
    message = pack_tick(tick_in, out)
    values = out.telemetry.packed()
    sizes = SIZES.pack(len(message), *_axis_lengths(out.telemetry))
    return b"".join((FRAMING.pack(12 + len(message) + len(values), TICK), sizes, message, values))


def pack_snapshot(tick_in: TickIn, data: bytes) -> bytes:
    """Encode the state after a tick as a record for the pipe."""
    return record_bytes(SNAPSHOT, SNAPSHOT_HEAD.pack(tick_in.k, tick_in.t_ns) + data)


def _axis_lengths(numbers: Telemetry | PackedTelemetry) -> list[int]:
    """Return the numbers of joints, tendons, motors and digits."""
    if isinstance(numbers, PackedTelemetry):
        return [columns.stop - columns.start for columns in map(numbers.places.__getitem__, _FIELD_OF_EACH_AXIS)]
    return [len(getattr(numbers, name)) for name in _FIELD_OF_EACH_AXIS]


class MessageLayout(NamedTuple):
    """Positions of the parts in a Tick message.

    Attributes:
        received, sent: slice of the frames.
        long_data: slice of the payload bytes after the eighth.
        tail: offset of the phase and the lists after the phase [bytes].
    """

    received: slice
    sent: slice
    long_data: slice
    tail: int


def message_layout(message: bytes) -> MessageLayout:
    """Return the positions of the parts in a Tick message, without decoding them.

    Raises:
        struct.error: the message ends early.
    """
    (received,) = _COUNT.unpack_from(message, FIXED.size)
    start = FIXED.size + 4
    end = FIXED.size + 4 + FRAME_SIZE * received
    (sent,) = _COUNT.unpack_from(message, end)
    # Padding to 8 bytes precedes the frames but not an empty sequence.
    sent_start = end + 8 if sent else end + 4
    sent_end = sent_start + FRAME_SIZE * sent
    (size,) = _COUNT.unpack_from(message, sent_end)
    long_data = slice(sent_end + 4, sent_end + 4 + size)
    # The long bytes may end at any offset. The text after them is aligned to 4 bytes.
    return MessageLayout(slice(start, end), slice(sent_start, sent_end), long_data, long_data.stop + -size % 4)


def _decode_frames(beginnings: bytes, long_data: bytes) -> tuple[Frames, bytes]:
    """Return the decoded frames, and the long bytes that belong to later frames.

    Args:
        beginnings: first parts of the frames, FRAME_SIZE bytes each.
        long_data: payload bytes after the eighth, of these frames and of later frames.

    Raises:
        ValueError: a payload is too long, or its bytes are missing.
    """
    lengths = beginnings[_LENGTH_AT::FRAME_SIZE]
    count = len(beginnings) // FRAME_SIZE
    if not count:
        return NO_FRAMES, long_data
    records = np.zeros(count, RECORD)
    records.setfield(np.frombuffer(beginnings, _BEGINNING), _BEGINNING, 0)
    longest = max(lengths)
    if longest > _LONGEST:
        raise ValueError(f"payload of {longest} bytes, expected at most {_LONGEST}")
    if lengths.count(_SHORT_DATA) < count:
        _zero_unused_bytes(records)
    if longest > _SHORT_DATA:
        long_mask = _long_mask(records)
        size = int(long_mask.sum())
        if size > len(long_data):
            raise ValueError("less data than frames")
        records["data"][:, _SHORT_DATA:][long_mask] = np.frombuffer(long_data[:size], np.uint8)
        long_data = long_data[size:]
    return Frames(records), long_data


def _zero_unused_bytes(records: Records) -> None:
    """Set the unused bytes of short payloads to zero, because a bad file may hold any bytes there."""
    words = records.getfield(_DATA_WORD, _DATA_AT)
    words &= _MASKS[np.minimum(records["length"], _SHORT_DATA)]


@functools.lru_cache(maxsize=256)
def _phase_without_events(tail: bytes) -> str | None:
    """Return the phase if the end of a message has no events, else None."""
    phase = CdrReader(ENCAPSULATION + tail).text()
    return phase if _tail_without_events(phase) == tail else None


def unpack_tick(message: bytes) -> TickRecord:
    """Decode a Tick message that `pack_tick` has encoded.

    Raises:
        ValueError: the bytes are not a Tick message.
    """
    if message[:4] != ENCAPSULATION:
        raise ValueError("not little-endian CDR")
    try:
        parts = message_layout(message)
        frames_in, rest = _decode_frames(message[parts.received], message[parts.long_data])
        frames_out, rest = _decode_frames(message[parts.sent], rest)
        if rest:
            raise ValueError("more data than frames")
        return _build_tick(FIXED.unpack_from(message, 4), frames_in, frames_out, message, parts.tail)
    except struct.error as error:
        raise ValueError(f"the message ends early: {error}") from None


def _build_tick(fixed: _Fixed, received: Frames, sent: Frames, message: bytes, tail: int) -> TickRecord:
    """Return a tick from the parts of its message.

    Args:
        fixed: values of the first part of the message.
        received: received frames.
        sent: sent frames.
        message: the whole message.
        tail: offset of the phase in the message [bytes].
    """
    phase = _phase_without_events(message[tail:])
    if phase is not None:
        return _tick_without_events(fixed, received, sent, phase)
    k, t_ns, late_ns, state_hash, mode, action, _ = fixed
    reader = CdrReader(message)
    reader.take(tail - 4)
    phase = reader.text()
    io_events = tuple(IoEvent(reader.text(), reader.text(), reader.i64()) for _ in range(reader.count()))
    requests = tuple(reader.text() for _ in range(reader.count()))
    events = tuple(Event(reader.text(), reader.text(), reader.text(), reader.text()) for _ in range(reader.count()))
    tick_in = TickIn(k, t_ns, late_ns, received, io_events, requests)
    return TickRecord(tick_in, sent, Mode(mode), phase, Action(action), events, state_hash)


def _tick_without_events(fixed: _Fixed, received: Frames, sent: Frames, phase: str) -> TickRecord:
    """Return a tick without io events, requests, and events."""
    k, t_ns, late_ns, state_hash, mode, action, _ = fixed
    tick_in = new_tuple(TickIn, (k, t_ns, late_ns, received, (), ()))
    mode_member = _MODES.get(mode) or Mode(mode)
    action_member = _ACTIONS.get(action) or Action(action)
    return new_tuple(TickRecord, (tick_in, sent, mode_member, phase, action_member, (), state_hash))


def unpack_ticks(messages: list[bytes]) -> list[TickRecord]:
    """Decode all Tick messages of a chunk. The frames of all ticks share one array.

    Raises:
        ValueError: an element is not a Tick message.
    """
    quick = _unpack_short(messages)
    return quick if quick is not None else [unpack_tick(message) for message in messages]


def _unpack_short(messages: list[bytes]) -> list[TickRecord] | None:
    """Decode Tick messages that have no payload longer than eight bytes.

    Returns:
        the ticks, or None if a message has a long payload or ends early. `unpack_tick` then decodes
        each message.
    """
    parts = list[bytes]()
    ends = [0]
    fixed = list[_Fixed]()
    tails = list[int]()
    end = 0
    for message in messages:
        if message[:4] != ENCAPSULATION:
            return None
        try:
            constant_part = FIXED.unpack_from(message, 4)
            sent_count = _FRAMES_AT + FRAME_SIZE * constant_part[6]
            (sent,) = _COUNT.unpack_from(message, sent_count)
        except struct.error:
            return None
        start = sent_count + 8 if sent else sent_count + 4
        long_count = start + FRAME_SIZE * sent
        if message[long_count : long_count + 4] != _NO_LONG_DATA:
            return None
        # The frames of all messages are joined and decoded in one call, then divided again at
        # `ends`.
        parts += message[_FRAMES_AT:sent_count], message[start:long_count]
        ends += end + constant_part[6], end + constant_part[6] + sent
        end = ends[-1]
        fixed.append(constant_part)
        tails.append(long_count + 4)
    beginnings = b"".join(parts)
    if max(beginnings[_LENGTH_AT::FRAME_SIZE], default=0) > _SHORT_DATA:
        return None
    records = _decode_frames(beginnings, b"")[0].records
    frames = [Frames(records[first:last]) for first, last in pairwise(ends)]
    return list(map(_build_tick, fixed, frames[::2], frames[1::2], messages, tails))


def unpack_tick_record(record: bytes) -> tuple[TickIn, TickOut]:
    """Decode a record of the pipe that `pack_tick_record` has encoded.

    Raises:
        ValueError: the bytes are not the record of a tick.
    """
    length, kind = FRAMING.unpack_from(record)
    if kind != TICK or length != len(record) - FRAMING.size:
        raise ValueError("not the record of a tick")
    size, *axes = SIZES.unpack_from(record, FRAMING.size)
    start = FRAMING.size + SIZES.size
    tick = unpack_tick(record[start : start + size])
    lengths = dict(zip(("joint", "tendon", "motor", "digit"), axes, strict=True))
    ends = np.cumsum([lengths[TELEMETRY_AXES[name]] for name in TELEMETRY_FIELDS])
    parts = np.split(np.frombuffer(record[start + size :], "<f8"), ends[:-1])
    telemetry = Telemetry(*parts)
    out = TickOut(tick.frames, tick.mode, tick.phase, tick.action, telemetry, tick.events, tick.state_hash)
    return tick.tick_in, out
