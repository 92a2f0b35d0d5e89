"""Rows B01 to B18: what goes wrong on the way."""

from collections.abc import Sequence

from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import ITSELF, NOTHING, PERSON, Fault, Reading, above, io
from handctl.safety.signals import Limits, Signals

WINDOW = 100
"""Ticks over which losses are counted."""
SOME, MANY = 20, 40
"""Losses of the last 100 that hold the hand, and that relax it."""
MISSHAPEN_MOST, UNKNOWN_MOST = 3, 50.0
"""Misshapen frames of a node in 20 ticks; frames a second with identifiers that nobody has."""
UNANSWERED = ("no acknowledge", "bus error", "protocol")
"""Error frames of a bus on which nobody hears this host."""


def _motor_late(limits: Limits, s: Signals) -> Sequence[Reading]:
    """In ticks that this host missed it asked for nothing."""
    return above(limits.motors, s.motor_age, s.missed) if s.armed else NOTHING


def _motor_silent(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.motors, s.motor_age, limits.silent_ticks - 1) if s.armed else NOTHING


def _one_silent(limits: Limits, s: Signals) -> Sequence[Reading]:
    """Some nodes are silent while others answer."""
    late = above(limits.motors, s.motor_age, limits.one_silent_ticks - 1) if s.armed else NOTHING
    return late if late and min(s.motor_age) == 0 else NOTHING


def _lost_some(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.nodes, s.lost, SOME) if s.armed and s.lost and max(s.lost) > SOME else NOTHING


def _lost_many(limits: Limits, s: Signals) -> Sequence[Reading]:
    return above(limits.nodes, s.lost, MANY) if s.armed and s.lost and max(s.lost) > MANY else NOTHING


def _delayed(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, late) for name, late in s.stale if not late] if s.armed and s.stale else NOTHING


def _overtaken(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, late) for name, late in s.stale if late] if s.armed and s.stale else NOTHING


def _same_twice(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, other) for name, other in s.twice if not other] if s.armed and s.twice else NOTHING


def _other_twice(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, other) for name, other in s.twice if other] if s.armed and s.twice else NOTHING


def _misshapen_often(limits: Limits, s: Signals) -> Sequence[Reading]:
    if not s.armed or not s.misshapen:
        return NOTHING
    return [(name, count) for name, count in s.misshapen if count >= MISSHAPEN_MOST]


def _misshapen(limits: Limits, s: Signals) -> Sequence[Reading]:
    return s.misshapen if s.armed else NOTHING


def _unknown(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (("bus", s.unknown),) if s.unknown > UNKNOWN_MOST else NOTHING


def _flooded(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (("bus", float(s.frames)),) if s.armed and s.frames > limits.frames_most * (1 + s.missed) else NOTHING


def _alone(limits: Limits, s: Signals) -> Sequence[Reading]:
    if s.armed or s.heard or not s.io:
        return NOTHING
    found = [(w, n) for kind, w, n in s.io if kind == "error_frame" and any(word in w for word in UNANSWERED)]
    return [(where, float(number)) for where, number in found[:1]]


BUS_FAULTS: tuple[Fault, ...] = (
    Fault("B01", "a reply is missing", "feedback older than one tick", 1, Action.WARN, ITSELF, _motor_late),
    Fault("B02", "a motor has gone silent", "no reply for 30 ms, at least four in a row", 1, Action.RELAX, PERSON,
          _motor_silent),
    Fault("B03a", "replies get lost", "more than 20 of the last 100 missing", 1, Action.HOLD, ITSELF, _lost_some),
    Fault("B03b", "many replies get lost", "more than 40 of the last 100 missing", 1, Action.RELAX, PERSON, _lost_many),
    Fault("B04", "a delayed frame", "an answer of the load cells to an older SYNC", 1, Action.WARN, ITSELF, _delayed),
    Fault("B05", "a frame came twice", "more answers than questions, of the same bytes", 1, Action.WARN, ITSELF,
          _same_twice),
    Fault("B06", "a masquerade", "more answers than questions, of other bytes", 1, Action.RELAX, PERSON, _other_twice,
          Release.OPEN),
    Fault("B07", "frames overtake", "a stale load-cell frame arrives after the fresh one", 1, Action.WARN, ITSELF,
          _overtaken),
    Fault("B08", "corrupt payloads", "three frames of a node in 20 ticks cannot be read", 1, Action.RELAX, PERSON,
          _misshapen_often),
    Fault("B09", "a frame of a wrong shape", "length, RTR, 29 bit or non-numeric values", 1, Action.WARN,
          ITSELF, _misshapen),
    Fault("B10", "unknown identifiers", "more than 50 frames a second with unassigned identifiers", 1, Action.WARN,
          ITSELF, _unknown),
    Fault("B11a", "a flooded bus", "more frames than all nodes can send, two ticks", 2, Action.RELAX, PERSON, _flooded),
    Fault("B11b", "a flood that lasts", "the same for ten ticks", 10, Action.CUT, PERSON, _flooded),
    Fault("B12", "bus off", "the interface reports bus-off", 1, Action.CUT, PERSON, io("bus_off")),
    Fault("B13a", "bus errors", "the interface reports error-warning or -passive", 1, Action.WARN, ITSELF,
          io("error_warning", "error_passive")),
    Fault("B13b", "bus error-passive", "interface error-passive, 20 ticks", 20, Action.RELAX, PERSON,
          io("error_passive")),
    Fault("B14", "bus lost", "the interface is down", 1, Action.CUT, PERSON, io("enetdown")),
    Fault("B15", "send queue full", "the interface refuses frames, two ticks", 2, Action.RELAX, PERSON, io("enobufs")),
    Fault("B16", "adapter unplugged", "the interface has gone", 1, Action.CUT, PERSON, io("enodev", "ebadf")),
    Fault("B17", "some nodes do not hear", "a motor misses four ticks in a row while others answer", 1, Action.RELAX,
          PERSON, _one_silent),
    Fault("B18", "alone on the bus", "error frames and no answer, before arming", 20, Action.RELAX, PERSON, _alone),
)  # fmt: skip
