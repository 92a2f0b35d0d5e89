"""One tick as one record for the pipe: a ``handctl_msgs/Tick`` ready for the log, then the telemetry.

A record is ``u32 length, u32 kind`` and length bytes. The body of a tick is ``u32 size of the Tick message``, four
``u16`` sizes of the telemetry's axes, the message, and the float64 of the telemetry in order.
"""

import functools
import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from handctl.core.types import TELEMETRY_AXES, TELEMETRY_FIELDS, Event, IoEvent, Mode, Telemetry, TickIn, TickOut
from handctl.drives.frame import Frame
from handctl.log.cdr import ENCAPSULATION, CdrReader, CdrWriter
from handctl.safety.action import Action

FRAMING = struct.Struct("<II")
HEADER, TICK, END, SNAPSHOT = 1, 2, 3, 4
"""Kinds of records."""
SNAPSHOT_HEAD = struct.Struct("<qq")
"""Number and time [ns] of the tick whose state it is."""

SIZES = struct.Struct("<IHHHH")
FIXED = struct.Struct("<qqq8sBB2xI")
"""Constant part of the Tick message: k, t_ns, late_ns, state hash, mode, action, number of frames received."""
FRAME = struct.Struct("<qIHBB8s")
_MODES, _ACTIONS = {mode.value: mode for mode in Mode}, {action.value: action for action in Action}
"""Looked up in a quarter of the time that an enumeration takes."""
make = tuple.__new__
"""A named tuple without its constructor."""
_COUNT = struct.Struct("<I")


class TickRecord(NamedTuple):
    """What the log keeps of a tick besides its telemetry.

    Attributes:
        tick_in: exactly what the tick knew.
        frames: frames sent, in order.
        mode, phase, action, events, state_hash: as in TickOut.
    """

    tick_in: TickIn
    frames: tuple[Frame, ...]
    mode: Mode
    phase: str
    action: Action
    events: tuple[Event, ...]
    state_hash: bytes


def framed(kind: int, body: bytes) -> bytes:
    """A record of this kind."""
    return FRAMING.pack(len(body), kind) + body


def _frames(frames: Iterable[Frame]) -> bytes:
    pack = FRAME.pack
    return b"".join([pack(t_ns, i, flags, bus, len(data), data) for i, data, flags, bus, t_ns in frames])


def _long_data(frames: Iterable[Frame]) -> bytes:
    return b"".join([frame.data[8:] for frame in frames if len(frame.data) > 8])


@functools.lru_cache(maxsize=64)
def _quiet_tail(phase: str) -> bytes:
    """Phase and three empty sequences: the same bytes at every offset that is a multiple of four."""
    out = CdrWriter()
    out.text(phase)
    for _ in range(3):
        out.count(0)
    return bytes(out.data)


def _tail(start: int, phase: str, tick_in: TickIn, events: tuple[Event, ...]) -> bytes:
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
    """The handctl_msgs/Tick message.

    Raises:
        ValueError: state_hash is not 8 bytes long.
        struct.error: a number does not fit its field.
    """
    received, sent = tick_in.frames, out.frames
    if len(out.state_hash) != 8:
        raise ValueError(f"state hash of {len(out.state_hash)} bytes; expected 8")
    fixed = FIXED.pack(tick_in.k, tick_in.t_ns, tick_in.late_ns, out.state_hash, out.mode, out.action, len(received))
    long_data = _long_data((*received, *sent))
    padding = b"\0\0\0\0" if sent else b""
    long_part = _COUNT.pack(len(long_data)) + long_data + bytes(-len(long_data) % 4)
    parts = [ENCAPSULATION, fixed, _frames(received), _COUNT.pack(len(sent)), padding, _frames(sent), long_part]
    if tick_in.io_events or tick_in.requests or out.events:
        parts.append(_tail(sum(map(len, parts)) - 4, out.phase, tick_in, out.events))
    else:
        parts.append(_quiet_tail(out.phase))
    return b"".join(parts)


def pack(tick_in: TickIn, out: TickOut) -> bytes:
    """One tick as a record; raises as ``pack_tick``."""
    message, numbers = pack_tick(tick_in, out), out.telemetry
    values = numbers.packed()
    sizes = SIZES.pack(
        len(message), len(numbers.q), len(numbers.tension), len(numbers.motor_torque), len(numbers.contact)
    )
    return b"".join((FRAMING.pack(12 + len(message) + len(values), TICK), sizes, message, values))


def pack_snapshot(tick_in: TickIn, data: bytes) -> bytes:
    """The state after a tick as a record."""
    return framed(SNAPSHOT, SNAPSHOT_HEAD.pack(tick_in.k, tick_in.t_ns) + data)


class Layout(NamedTuple):
    """Where the parts of a Tick message are.

    Attributes:
        received, sent: slice of the frames.
        long_data: slice of the bytes beyond the eighth.
        tail: start of the phase and all after it.
    """

    received: slice
    sent: slice
    long_data: slice
    tail: int


def layout(message: bytes) -> Layout:
    """Find the parts without decoding them.

    Raises:
        struct.error: the message ends early.
    """
    (received,) = _COUNT.unpack_from(message, FIXED.size)
    start, end = FIXED.size + 4, FIXED.size + 4 + FRAME.size * received
    (sent,) = _COUNT.unpack_from(message, end)
    sent_start = end + 8 if sent else end + 4
    sent_end = sent_start + FRAME.size * sent
    (size,) = _COUNT.unpack_from(message, sent_end)
    long_data = slice(sent_end + 4, sent_end + 4 + size)
    return Layout(slice(start, end), slice(sent_start, sent_end), long_data, long_data.stop + -size % 4)


def _whole_frames(
    parts: Iterable[tuple[int, int, int, int, int, bytes]], long_data: bytes
) -> tuple[list[Frame], bytes]:
    rows = list(parts)
    if not long_data and True not in [row[4] > 8 for row in rows]:  # nearly always
        return [make(Frame, (i, data[:size], flags, bus, t_ns)) for t_ns, i, flags, bus, size, data in rows], b""
    frames = []
    for t_ns, can_id, flags, bus, length, data in rows:
        if length <= 8:
            frames.append(Frame(can_id, data[:length], flags, bus, t_ns))
            continue
        if length - 8 > len(long_data):
            raise ValueError("less data than frames")
        frames.append(Frame(can_id, data + long_data[: length - 8], flags, bus, t_ns))
        long_data = long_data[length - 8 :]
    return frames, long_data


@functools.lru_cache(maxsize=256)
def _quiet_phase(tail: bytes) -> str | None:
    """The phase, if it is all that there is to tell."""
    phase = CdrReader(ENCAPSULATION + tail).text()
    return phase if _quiet_tail(phase) == tail else None


def unpack_tick(message: bytes) -> TickRecord:
    """Inverse of ``pack_tick``.

    Raises:
        ValueError: not a Tick message.
    """
    if message[:4] != ENCAPSULATION:
        raise ValueError("not little-endian CDR")
    try:
        k, t_ns, late_ns, state_hash, mode, action, _ = FIXED.unpack_from(message, 4)
        places = layout(message)
        received = FRAME.iter_unpack(message[places.received])
        frames_in, rest = _whole_frames(received, message[places.long_data])
        frames_out, rest = _whole_frames(FRAME.iter_unpack(message[places.sent]), rest)
    except struct.error as error:
        raise ValueError(f"the message ends early: {error}") from None
    if rest:
        raise ValueError("more data than frames")
    phase = _quiet_phase(message[places.tail :])
    if phase is not None:
        tick_in = TickIn(k, t_ns, late_ns, tuple(frames_in))
        known_mode, known_action = _MODES.get(mode) or Mode(mode), _ACTIONS.get(action) or Action(action)
        return TickRecord(tick_in, tuple(frames_out), known_mode, phase, known_action, (), state_hash)
    reader = CdrReader(message)
    reader.take(places.tail - 4)
    phase = reader.text()
    io_events = tuple(IoEvent(reader.text(), reader.text(), reader.i64()) for _ in range(reader.count()))
    requests = tuple(reader.text() for _ in range(reader.count()))
    events = tuple(Event(reader.text(), reader.text(), reader.text(), reader.text()) for _ in range(reader.count()))
    tick_in = TickIn(k, t_ns, late_ns, tuple(frames_in), io_events, requests)
    return TickRecord(tick_in, tuple(frames_out), Mode(mode), phase, Action(action), events, state_hash)


def unpack(record: bytes) -> tuple[TickIn, TickOut]:
    """Inverse of ``pack``.

    Raises:
        ValueError: not a record of a tick.
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
