"""How two ticks differ: the fields, the values, and the distance in units in the last place."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.controller.state import Decisions, State
from handctl.core.plain import plain_bytes
from handctl.core.types import TELEMETRY_AXES, TELEMETRY_FIELDS, Event, TickOut
from handctl.drives.frame import Frame
from handctl.drives.records import frames_of
from handctl.log.header import RunHeader
from handctl.log.record import TickRecord


class Difference(NamedTuple):
    """One field of one tick that is not the same.

    Attributes:
        k: tick.
        t_s: its time [s].
        field: of TickOut or of its telemetry, e.g. ``frames[3]``, ``mode``, ``tension_goal``.
        name: joint, tendon, motor or digit; empty if it is none.
        logged, computed: the two values; SI units for numbers, text for all else.
        ulps: distance of two numbers in units in the last place; None for text.
    """

    k: int
    t_s: float
    field: str
    name: str
    logged: float | str
    computed: float | str
    ulps: int | None = None


class Columns(NamedTuple):
    """Name of each column of ``Telemetry.packed``: field, and joint, tendon, motor or digit."""

    field: tuple[str, ...]
    name: tuple[str, ...]

    @staticmethod
    def of(header: RunHeader) -> "Columns":
        """Columns of a log."""
        pairs = [(field, name) for field in TELEMETRY_FIELDS for name in header.axis(TELEMETRY_AXES[field])]
        return Columns(tuple(field for field, _ in pairs), tuple(name for _, name in pairs))


def ulps(a: float, b: float) -> int:
    """How many float64 lie between two numbers; 0 if they are the same number, one apart for neighbours."""
    return abs(_ordinal(a) - _ordinal(b))


def _ordinal(value: float) -> int:
    """Place of a float64 in the order of all of them; both zeros are 0."""
    bits = int(np.float64(value).view(np.int64))
    return bits if bits >= 0 else -(bits & 0x7FFF_FFFF_FFFF_FFFF)


def differences(columns: Columns, logged: TickRecord, numbers: bytes, computed: TickOut) -> Iterator[Difference]:
    """Every field in which a recomputed tick is not the recorded one, decisions first, the state's hash last.

    Args:
        columns: of the telemetry.
        logged: the recorded tick.
        numbers: its telemetry, as packed.
        computed: the same tick now.
    """
    k, t_s = logged.tick_in.k, logged.tick_in.t_ns / 1e9

    def text(field: str, was: object, now: object) -> Iterator[Difference]:
        if was != now:
            yield Difference(k, t_s, field, "", str(was), str(now))

    yield from text("mode", logged.mode.name, computed.mode.name)
    yield from text("action", logged.action.name, computed.action.name)
    yield from text("phase", logged.phase, computed.phase)
    yield from text("events", _told(logged.events), _told(computed.events))
    packed = computed.telemetry.packed()[: len(numbers)]  # an earlier version lacks the last fields
    if packed != numbers:
        for column, was, now in _changed(numbers, packed):
            yield Difference(k, t_s, columns.field[column], columns.name[column], was, now, ulps(was, now))
    yield from text("number of frames", len(logged.frames), len(computed.frames))
    for i, (old, new) in enumerate(zip(logged.frames, computed.frames, strict=False)):
        yield from text(f"frames[{i}]", _shown(old), _shown(new))
    yield from text("state_hash", logged.state_hash.hex(), computed.state_hash.hex())


def of_states(header: RunHeader, logged: TickRecord, was: State, now: State) -> Difference | None:
    """Return the first field in which the states after a tick differ, in the order of the schema.

    Args:
        header: of the log. logged: the tick. was: the state in the log. now: the one computed.
    """
    k, t_s, found = logged.tick_in.k, logged.tick_in.t_ns / 1e9, was.layout.difference(was.block, now.block)
    if found:
        field, element, old, new = found
        axis = was.layout.axis_of(field)
        names = header.axis(axis) if axis in ("joint", "tendon", "digit") else ()
        name = names[element % len(names)] if names else f"[{element}]"
        return Difference(k, t_s, f"state {field}", name, old, new, ulps(old, new))
    for field, old_part, new_part in zip(Decisions._fields, was.decisions, now.decisions, strict=True):
        if plain_bytes(old_part) != plain_bytes(new_part):
            return Difference(k, t_s, f"state {field}", "", str(old_part), str(new_part))
    return None


def same(logged: TickRecord, numbers: bytes, computed: TickOut) -> bool:
    """Whether every output byte of a tick is equal."""
    return (
        logged.state_hash == computed.state_hash
        and logged.frames.records.tobytes() == frames_of(computed.frames).records.tobytes()
        and numbers == computed.telemetry.packed()[: len(numbers)]
        and (logged.mode, logged.action, logged.phase, logged.events)
        == (computed.mode, computed.action, computed.phase, computed.events)
    )


def same_decisions(logged: TickRecord, computed: TickOut) -> bool:
    """Whether a tick decides the same: mode, action, phase, and the events but for the numbers in their text."""
    was, now = ([event[:3] for event in events] for events in (logged.events, computed.events))
    return (logged.mode, logged.action, logged.phase, was) == (computed.mode, computed.action, computed.phase, now)


def _told(events: tuple[Event, ...]) -> str:
    return "; ".join(" ".join(filter(None, event)) for event in events)


def _shown(frame: Frame) -> str:
    """A frame as candump writes it, with the flag bits of its identifier, and the time if it has one."""
    flags = f"#{frame.flags:X}" if frame.flags else ""
    at = f" at {frame.t_ns} ns" if frame.t_ns else ""
    return f"bus {frame.bus} {frame.can_id:03X}#{flags}{frame.data.hex().upper()}{at}"


def _changed(was: bytes, now: bytes) -> list[tuple[int, float, float]]:
    """(column, old, new) of every float64 that has other bits; a number that became NaN counts."""
    old: NDArray[np.float64] = np.frombuffer(was, "<f8")
    new: NDArray[np.float64] = np.frombuffer(now, "<f8")
    at = np.flatnonzero(old.view(np.uint64) != new.view(np.uint64))
    return [(int(i), float(old[i]), float(new[i])) for i in at]
