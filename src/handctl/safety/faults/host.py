"""Rows H01 to H13 and I07: what goes wrong on this side."""

from collections.abc import Sequence

from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import ITSELF, NOTHING, PERSON, Fault, Reading, io, recorder
from handctl.safety.signals import Limits, Signals

LATE_SHARE = 0.25
REFUSED_MOST = 3


def _late(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (("loop", s.late),) if s.late > LATE_SHARE else NOTHING


def _missed(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (("loop", float(s.missed)),) if s.missed >= 1 else NOTHING


def _stalled(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (("loop", float(s.missed)),) if s.missed >= limits.stalled_ticks and s.armed else NOTHING


def _foreign(limits: Limits, s: Signals) -> Sequence[Reading]:
    return [(name, 1.0) for name in s.foreign] if s.foreign else NOTHING


def _refused(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (("goal", float(s.refused)),) if s.refused and s.armed else NOTHING


def _refused_often(limits: Limits, s: Signals) -> Sequence[Reading]:
    return (("goal", float(s.refused)),) if s.refused >= REFUSED_MOST and s.armed else NOTHING


HOST_FAULTS: tuple[Fault, ...] = (
    Fault("H01", "late tick", "the tick began more than a quarter period late", 1, Action.PASS, ITSELF, _late),
    Fault("H02", "missed tick", "the tick number jumped", 1, Action.WARN, ITSELF, _missed),
    Fault("H03", "the host stood still", "25 ms without a tick, at least three missed", 1, Action.RELAX, PERSON,
          _stalled),
    Fault("H04", "the host was suspended", "CLOCK_BOOTTIME ran ahead of CLOCK_MONOTONIC", 1, Action.RELAX, PERSON,
          io("suspended")),
    Fault("H08", "disk full", "the log could not be written", 1, Action.WARN, ITSELF,
          recorder("disk_low", "disk_full")),
    Fault("H09", "log records dropped", "the recorder does not keep up", 1, Action.WARN, ITSELF,
          recorder("dropped", "filling")),
    Fault("H10", "recorder lost", "the recorder process or its disk is gone", 1, Action.WARN, ITSELF,
          recorder("gone", "error")),
    Fault("H13", "a second controller", "a frame that only the host may send, or an answer it did not ask for", 1,
          Action.RELAX, PERSON, _foreign, Release.OPEN),
    Fault("I07a", "a bad live goal", "refused; the last good one stays", 1, Action.WARN, ITSELF, _refused),
    Fault("I07b", "bad live goals", "three refused within a second", 1, Action.RELAX, PERSON, _refused_often),
)  # fmt: skip
