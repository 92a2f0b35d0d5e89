"""The fault table: what is detected, how long it may last, what is done, and who may clear it.

One row a fault; the identifiers are those of the project's fault catalogue. A detector is a pure function of one
tick's ``Signals``; it names the instances (motor, tendon, bus) in which the fault is present, each with the reading
that shows it. Debounce, latch and the choice of the action are in ``judge``.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from handctl.safety.action import Action

Reading = tuple[str, float]
"""Instance and the value that shows the fault."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Thresholds of one hand.

    Attributes:
        tendons: names, (N,).
        tension_trip: (N,) tension of one sample that means relax [N].
        tension_rail: reading at which a load cell is saturated [N].
        tension_low: reading that no rope can make: a broken wire or a sensor without supply [N].
        motors: names, (M,).
        silent_ticks: replies in a row that may be missing before a node counts as silent.
        stalled_ticks: ticks in a row that may be missed before the host counts as standing still.
        temperature_hard: of a drive [degC].
        temperature_soft: of a drive [degC].
    """

    tendons: tuple[str, ...]
    tension_trip: tuple[float, ...]
    tension_rail: float
    motors: tuple[str, ...]
    tension_low: float = -math.inf
    silent_ticks: int = 4
    stalled_ticks: int = 3
    temperature_soft: float = 70.0
    temperature_hard: float = 85.0


@dataclass(frozen=True, slots=True)
class Signals:
    """What safety may know of one tick.

    Attributes:
        armed: whether torque may be acting; node faults count only then.
        missed: ticks that were skipped before this one.
        late: how late this tick began, as a share of the period.
        motor_age: (M,) whole ticks since the tick that should have brought feedback; 0 is on time.
        sensor_age: likewise for the tension frames, (N,).
        tension: (N,) load-cell samples of this tick [N], NaN if missing.
        slack_for: longest time any tendon has been slack while active [s].
        drive_errors: (motor, code) of every drive in fault.
        temperature: (M,) [degC], NaN if unknown.
        foreign: identifiers of the host seen from somebody else, as text.
        io: (kind, where, number) of buses and host.
    """

    armed: bool
    missed: int = 0
    late: float = 0.0
    motor_age: tuple[int, ...] = ()
    sensor_age: tuple[int, ...] = ()
    tension: tuple[float, ...] = ()
    drive_errors: tuple[tuple[str, int], ...] = ()
    temperature: tuple[float, ...] = ()
    foreign: tuple[str, ...] = ()
    io: tuple[tuple[str, str, int], ...] = ()


SILENT_S, STALLED_S = 0.030, 0.025
"""How long a node may be silent, and the host stand still: less than the drives' watchdog of 50 ms."""
LEAST_SILENT, LEAST_STALLED = 4, 3
"""The same in ticks at least, for slow rates."""


def ticks_for(seconds: float, period: float, least: int) -> int:
    """A time as whole ticks of a period [s], at least ``least``."""
    return max(least, math.ceil(seconds / period))


Detector = Callable[[Limits, Signals], Iterator[Reading]]


@dataclass(frozen=True, slots=True)
class Fault:
    """One row.

    Attributes:
        id: row of the fault catalogue.
        title: what it is, for a person.
        detection: how it is noticed.
        debounce: consecutive ticks before it counts.
        action: what happens.
        clears: who ends it: "by itself", or "a person" for latched ones.
        detect: the detector.
    """

    id: str
    title: str
    detection: str
    debounce: int
    action: Action
    clears: str
    detect: Detector

    @property
    def latched(self) -> bool:
        """Whether the action stays until a person clears it."""
        return self.clears == "a person"


def _older_than(ages: tuple[int, ...], names: tuple[str, ...], limit: int) -> Iterator[Reading]:
    return ((name, float(age)) for name, age in zip(names, ages, strict=False) if age >= limit)


def _motor_late(limits: Limits, s: Signals) -> Iterator[Reading]:
    return _older_than(s.motor_age, limits.motors, 1) if s.armed else iter(())


def _motor_silent(limits: Limits, s: Signals) -> Iterator[Reading]:
    return _older_than(s.motor_age, limits.motors, limits.silent_ticks) if s.armed else iter(())


def _sensor_silent(limits: Limits, s: Signals) -> Iterator[Reading]:
    return _older_than(s.sensor_age, limits.tendons, limits.silent_ticks) if s.armed else iter(())


def _over_tension(limits: Limits, s: Signals) -> Iterator[Reading]:
    rows = zip(limits.tendons, s.tension, limits.tension_trip, strict=False)
    return ((name, f) for name, f, trip in rows if trip < f < limits.tension_rail)


def _saturated(limits: Limits, s: Signals) -> Iterator[Reading]:
    rows = zip(limits.tendons, s.tension, strict=False)
    return ((name, f) for name, f in rows if s.armed and (f >= limits.tension_rail or f <= limits.tension_low))


def _drive_error(limits: Limits, s: Signals) -> Iterator[Reading]:
    return ((name, float(code)) for name, code in s.drive_errors if s.armed)


def _hotter_than(limits: Limits, s: Signals, limit: float) -> Iterator[Reading]:
    return ((name, value) for name, value in zip(limits.motors, s.temperature, strict=False) if value > limit)


def _warm(limits: Limits, s: Signals) -> Iterator[Reading]:
    return _hotter_than(limits, s, limits.temperature_soft)


def _hot(limits: Limits, s: Signals) -> Iterator[Reading]:
    return _hotter_than(limits, s, limits.temperature_hard)


def _foreign(limits: Limits, s: Signals) -> Iterator[Reading]:
    return ((name, 1.0) for name in s.foreign)


def _late(limits: Limits, s: Signals) -> Iterator[Reading]:
    return iter((("loop", s.late),) if s.late > 0.25 else ())


def _missed(limits: Limits, s: Signals) -> Iterator[Reading]:
    return iter((("loop", float(s.missed)),) if s.missed >= 1 else ())


def _stalled(limits: Limits, s: Signals) -> Iterator[Reading]:
    return iter((("loop", float(s.missed)),) if s.missed >= limits.stalled_ticks and s.armed else ())


def _io(*kinds: str) -> Detector:
    def detect(limits: Limits, s: Signals) -> Iterator[Reading]:
        return ((where or kind, float(number)) for kind, where, number in s.io if kind in kinds)

    return detect


def _recorder(*wheres: str) -> Detector:
    def detect(limits: Limits, s: Signals) -> Iterator[Reading]:
        return ((where, float(number)) for kind, where, number in s.io if kind == "recorder" and where in wheres)

    return detect


PERSON, ITSELF = "a person", "by itself"

TABLE: tuple[Fault, ...] = (
    Fault("B01", "a reply is missing", "feedback older than one tick", 1, Action.WARN, ITSELF, _motor_late),
    Fault(
        "B02",
        "a motor has gone silent",
        "no reply for 30 ms, at least four in a row",
        1,
        Action.RELAX,
        PERSON,
        _motor_silent,
    ),
    Fault("B12", "bus off", "the interface reports bus-off", 1, Action.CUT, PERSON, _io("bus_off")),
    Fault("B13", "bus error-passive", "interface error-passive", 20, Action.RELAX, PERSON, _io("error_passive")),
    Fault("B14", "bus lost", "interface down or unplugged", 1, Action.CUT, PERSON, _io("enetdown", "enodev", "ebadf")),
    Fault("B15", "send queue full", "the interface refuses frames, two ticks", 2, Action.RELAX, PERSON, _io("enobufs")),
    Fault(
        "N02",
        "load cells silent",
        "no tension frame for 30 ms, at least four in a row",
        1,
        Action.RELAX,
        PERSON,
        _sensor_silent,
    ),
    Fault("N09a", "drive warm", "temperature above the soft limit", 20, Action.WARN, ITSELF, _warm),
    Fault("N09b", "drive too hot", "temperature above the hard limit", 20, Action.RELAX, PERSON, _hot),
    Fault("N11", "drive reports an error", "error code in the feedback", 1, Action.RELAX, PERSON, _drive_error),
    Fault("T03", "over-tension", "one load-cell sample above tension_trip_N", 1, Action.RELAX, PERSON, _over_tension),
    Fault("T06", "load cell saturated", "a rail, or a broken wire, three ticks", 3, Action.RELAX, PERSON, _saturated),
    Fault("H01", "late tick", "the tick began more than a quarter period late", 1, Action.PASS, ITSELF, _late),
    Fault("H02", "missed tick", "the tick number jumped", 1, Action.WARN, ITSELF, _missed),
    Fault(
        "H03", "the host stood still", "25 ms without a tick, at least three missed", 1, Action.RELAX, PERSON, _stalled
    ),
    Fault(
        "H08", "disk full", "the log could not be written", 1, Action.WARN, ITSELF, _recorder("disk_low", "disk_full")
    ),
    Fault(
        "H09",
        "log records dropped",
        "the recorder does not keep up",
        1,
        Action.WARN,
        ITSELF,
        _recorder("dropped", "filling"),
    ),
    Fault(
        "H10",
        "recorder lost",
        "the recorder process or its disk is gone",
        1,
        Action.WARN,
        ITSELF,
        _recorder("gone", "error"),
    ),
    Fault("H13", "a second controller", "a frame that only the host may send", 1, Action.RELAX, PERSON, _foreign),
)
"""All rows, in the order of the catalogue."""
