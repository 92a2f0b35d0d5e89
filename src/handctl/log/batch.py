"""Records of many ticks, turned into arrays at once."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.types import TELEMETRY_AXES, TELEMETRY_FIELDS, TELEMETRY_FIRST
from handctl.log.header import RunHeader
from handctl.log.record import FIXED, FRAME_SIZE, SIZES, TickRecord, layout, unpack_tick

FRAME_DTYPE = np.dtype(
    [("t_ns", "<i8"), ("can_id", "<u4"), ("flags", "<u2"), ("bus", "u1"), ("length", "u1"), ("data", "u1", (8,))]
)
FIXED_DTYPE = np.dtype(
    {
        "names": ["k", "t_ns", "late_ns", "state_hash", "mode", "action"],
        "formats": ["<i8", "<i8", "<i8", "V8", "u1", "u1"],
        "offsets": [0, 8, 16, 24, 32, 33],
        "itemsize": FIXED.size,
    }
)
_QUIET_LIMIT = 256


class Frames(NamedTuple):
    """Frames of many ticks, in order.

    Attributes:
        frames: (m,) FRAME_DTYPE.
        tick: (m,) index of the tick each belongs to.
        long_data: bytes beyond the eighth of each longer frame, in order.
    """

    frames: NDArray[np.void]
    tick: NDArray[np.intp]
    long_data: bytes


class Batch(NamedTuple):
    """n ticks as arrays.

    Attributes:
        messages: the Tick message of each.
        k, t_ns, late_ns: (n,) int64.
        mode, action: (n,) uint8.
        phases: grasp phase of each.
        numbers: (n, columns) telemetry in the order of Telemetry.packed.
        received, sent: the frames.
        notable: index -> decoded record of each tick with events, requests or io events.
    """

    messages: list[bytes]
    k: NDArray[np.int64]
    t_ns: NDArray[np.int64]
    late_ns: NDArray[np.int64]
    mode: NDArray[np.uint8]
    action: NDArray[np.uint8]
    phases: list[str]
    numbers: NDArray[np.float64]
    received: Frames
    sent: Frames
    notable: dict[int, TickRecord]


def layout_of(header: RunHeader, width: int) -> tuple[str, ...]:
    """Return the fields of a telemetry row of so many columns: logs of earlier versions lack the last ones.

    Args:
        header: of the run.
        width: columns of a row.
    """
    earlier = TELEMETRY_FIELDS[:TELEMETRY_FIRST]
    return earlier if width == columns_of(header, earlier) else TELEMETRY_FIELDS


def columns_of(header: RunHeader, fields: tuple[str, ...]) -> int:
    """Return how many columns these fields take."""
    return sum(len(header.axis(TELEMETRY_AXES[name])) for name in fields)


def columns(header: RunHeader, fields: tuple[str, ...] = TELEMETRY_FIELDS) -> dict[str, slice]:
    """Return where each field of the telemetry is in a row.

    Args:
        header: of the run.
        fields: of the row, in order.
    """
    places, at = {}, 0
    for name in fields:
        size = len(header.axis(TELEMETRY_AXES[name]))
        places[name] = slice(at, at + size)
        at += size
    return places


@dataclass(slots=True)
class _Direction:
    parts: list[bytes] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)
    long_parts: list[bytes] = field(default_factory=list)

    def frames(self) -> Frames:
        tick = np.repeat(np.arange(len(self.counts)), self.counts)
        return Frames(np.frombuffer(b"".join(self.parts), FRAME_DTYPE), tick, b"".join(self.long_parts))


class Batcher:
    """Collects bodies of tick records until they are taken as a batch.

    Args:
        header: gives the number of columns of the telemetry.
    """

    def __init__(self, header: RunHeader) -> None:
        self._sizes = tuple(len(header.axis(name)) for name in ("joint", "tendon", "motor", "digit"))
        self._width = sum(len(header.axis(axis)) for axis in TELEMETRY_AXES.values())
        self._quiet: dict[bytes, str] = {}
        self.misshapen = 0
        self._clear()

    def _clear(self) -> None:
        self._messages: list[bytes] = []
        self._numbers: list[bytes] = []
        self._phases: list[str] = []
        self._notable: dict[int, TickRecord] = {}
        self._received, self._sent = _Direction(), _Direction()
        self.size = 0

    def __len__(self) -> int:
        return len(self._messages)

    def add(self, body: bytes) -> int:
        """Take in one tick and return its t_ns; telemetry of a wrong shape becomes NaN and is counted."""
        size, *sizes = SIZES.unpack_from(body)
        message, numbers = body[SIZES.size : SIZES.size + size], body[SIZES.size + size :]
        if tuple(sizes) != self._sizes or len(numbers) != 8 * self._width:
            self.misshapen += 1
            numbers = np.full(self._width, np.nan).tobytes()
        self._numbers.append(numbers)
        self._add_frames(message)
        self._messages.append(message)
        self.size += len(body)
        return int(FIXED.unpack_from(message, 4)[1])

    def _add_frames(self, message: bytes) -> None:
        places = layout(message)
        for direction, place in ((self._received, places.received), (self._sent, places.sent)):
            direction.parts.append(message[place])
            direction.counts.append((place.stop - place.start) // FRAME_SIZE)
        if places.long_data.stop > places.long_data.start:
            self._add_long(message[places.long_data])
        self._add_tail(message, places.tail)

    def _add_long(self, data: bytes) -> None:
        lengths = np.frombuffer(self._received.parts[-1], FRAME_DTYPE)["length"].astype(int)
        split = int(np.maximum(lengths - 8, 0).sum())
        self._received.long_parts.append(data[:split])
        self._sent.long_parts.append(data[split:])

    def _add_tail(self, message: bytes, at: int) -> None:
        tail = message[at:]
        phase = self._quiet.get(tail)
        if phase is None:
            tick = unpack_tick(message)
            phase = tick.phase
            if tick.events or tick.tick_in.requests or tick.tick_in.io_events:
                self._notable[len(self._messages)] = tick
            elif len(self._quiet) < _QUIET_LIMIT:
                self._quiet[tail] = phase
        self._phases.append(phase)

    def take(self) -> Batch:
        """Everything collected since the last call."""
        fixed = np.frombuffer(b"".join([message[4 : 4 + FIXED.size] for message in self._messages]), FIXED_DTYPE)
        numbers = np.frombuffer(b"".join(self._numbers), "<f8").reshape(len(fixed), self._width)
        batch = Batch(
            self._messages, fixed["k"], fixed["t_ns"], fixed["late_ns"], fixed["mode"], fixed["action"], self._phases,
            numbers, self._received.frames(), self._sent.frames(), self._notable,
        )  # fmt: skip
        self._clear()
        return batch
