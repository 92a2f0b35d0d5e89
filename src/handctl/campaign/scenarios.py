"""Which fault is tried on what, when, and what must happen by when: the matrix as data.

``latest`` is counted from the physical event to the frames that carry the reaction: so many ticks, plus so many
milliseconds where a row or a drive needs a time. An ODrive tells its state every 100 ms and its temperature every 200.
"""

import math
from itertools import pairwise
from typing import NamedTuple

from handctl.drives.sensors.node import TENSION_RAIL_N
from handctl.hand.description import Hand
from handctl.safety.action import Action

ARMING, FREE, GRASP = "arming", "free motion", "grasp"
MIT, ODRIVE, CIA402 = "mit", "odrive", "cia402"
ALL = (MIT, ODRIVE, CIA402)
EVERYWHERE, MOVING = (ARMING, FREE, GRASP), (FREE, GRASP)
HEARTBEAT, RESTART = {ODRIVE: 100.0}, {CIA402: 2}
"""What else a drive's own report may take [ms], and one that is silent while it restarts [ticks]."""
LATE_MS, LATE_TICKS = 7.0, 1.5
"""A delay that is late at every rate [ms], [ticks]."""
JUMP_RAD, JUMP_MS = 1.0, 5.0
"""A step that no drive makes within two periods, as much more as one is longer than this."""
ROUGH_RAD, ROUGH_MS = 0.04, 5.0
"""Noise that no drive makes within a period, as much more as its square is longer than this."""
READABLE_N = 0.9 * TENSION_RAIL_N
"""A trip above this cannot be told from a load cell at its rail (T06)."""
HOST = "host "
"""Begins what is done to the host: io events, missed ticks, requests."""


class Row(NamedTuple):
    """One line of the matrix.

    Attributes:
        id: row of the fault catalogue.
        fault: text for the simulator, with {node}, {tendon}, {digit}, {bus} or {joint} for the instance, {other} for
            the next motor, {trip} and {limit} for a tendon's tension_trip_N and drive_limit_N, {late} for a delay that
            is late at this rate [ms],
            {jump} and {rough} for a step and for noise that no drive makes at this rate [rad]; or HOST ...
        action: what must happen at least.
        ticks, ms: by when, together.
        rows: rows of the table that may find it, by their beginnings; the first one is the fault's own.
        stages: when it is tried. protocols: with which drives.
        extra_ms, extra_ticks: what a protocol needs besides, together.
    """

    id: str
    fault: str
    action: Action
    ticks: int
    ms: float = 0.0
    rows: tuple[str, ...] = ()
    stages: tuple[str, ...] = MOVING
    protocols: tuple[str, ...] = ALL
    extra_ms: dict[str, float] = {}  # noqa: RUF012 - read only
    extra_ticks: dict[str, int] = {}  # noqa: RUF012 - read only

    def bound(self, protocol: str, period_ms: float) -> int:
        """By when it must be answered with these drives [ticks]."""
        extra = self.extra_ticks.get(protocol, 0)
        return self.ticks + extra + math.ceil((self.ms + self.extra_ms.get(protocol, 0.0)) / period_ms)


class Scenario(NamedTuple):
    """One row on one instance in one stage.

    Attributes:
        row: of the matrix. fault: its text with the instance. stage: when. second: another fault, for pairs.
    """

    row: Row
    fault: str
    stage: str
    second: str = ""

    @property
    def id(self) -> str:
        """Of its row."""
        return self.row.id

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.row.id} {self.fault}" + (f" + {self.second}" if self.second else "") + f", {self.stage}"


WARN, HOLD, RELAX, CUT = Action.WARN, Action.HOLD, Action.RELAX, Action.CUT
ONCE = (MIT, CIA402)
"""Drives with exactly one answer to a command."""

_EXCHANGED = ("N14", "N05", "N06", "T04", "T02", "N04", "T03")
"""Rows that may find drives that were exchanged before N17 does, in motion or where they pull unequally."""

MATRIX: tuple[Row, ...] = (
    Row("B01", "drop node={node} for=2500us", WARN, 2, rows=("B01", "N02"), stages=EVERYWHERE),
    Row("B02", "drop bus={bus}", RELAX, 1, 30.0, ("B02", "N02", "B17"), EVERYWHERE),
    Row("B03", "drop node={node} p=0.3 seed=3", HOLD, 102, 0.0, ("B03", "B17", "N02"), protocols=ONCE),
    Row("B03", "drop node={node} p=0.6 seed=3", HOLD, 102, 0.0, ("B03", "B17", "N02", "N11"), protocols=(ODRIVE,)),
    Row("B03", "replay node=sensors size=16", RELAX, 102, 0.0, ("B03", "N02", "B04")),
    Row("B04", "delay node=sensors size={late} for=20ms", WARN, 4, rows=("B04",)),
    Row("B05", "duplicate node={node}", WARN, 2, rows=("B05", "N13", "B06"), protocols=ONCE),
    Row("B05", "duplicate node=sensors", WARN, 2, rows=("B05",)),
    Row("B06", "twin node={node}", RELAX, 2, rows=("B06",), protocols=ONCE),
    Row("B06", "twin node=sensors", RELAX, 2, rows=("B06",)),
    Row("B07", "reorder node=sensors", WARN, 2, rows=("B07",)),
    Row("B08", "shorten node={node}", RELAX, 4, rows=("B08", "B17")),
    Row("B09", "shorten node={node} for=3ms", WARN, 2, rows=("B09",)),
    Row("B09", "extend node={node} for=3ms", WARN, 2, rows=("B09",)),
    Row("B10", "unknown bus={bus}", WARN, 2, 51.0, ("B10",), EVERYWHERE),
    Row("B11", "flood bus={bus} size=100", RELAX, 3, rows=("B11",)),
    Row("B11", "flood bus={bus} size=101", CUT, 11, rows=("B11b", "B11a")),
    Row("B12", HOST + "io bus_off", CUT, 1, rows=("B12",), stages=EVERYWHERE),
    Row("B13", HOST + "io error_warning", WARN, 1, rows=("B13a",)),
    Row("B13", HOST + "io error_passive lasting", RELAX, 21, rows=("B13b",)),
    Row("B14", HOST + "io enetdown", CUT, 1, rows=("B14",), stages=EVERYWHERE),
    Row("B15", HOST + "io enobufs lasting", RELAX, 3, rows=("B15",)),
    Row("B16", HOST + "io enodev", CUT, 1, rows=("B16",), stages=EVERYWHERE),
    Row("B17", "deaf node={node}", RELAX, 4, rows=("B17", "N08", "B02", "B03"), protocols=(MIT, ODRIVE),
        extra_ms={ODRIVE: 160.0}),
    Row("B17", "drop node={node}", RELAX, 4, rows=("B17",)),
    Row("N01", "reset node={node}", RELAX, 2, rows=("N01", "N11", "B17"), extra_ms=HEARTBEAT, extra_ticks=RESTART),
    Row("N01", "reset node={node}", RELAX, 2, rows=("N01", "N11", "B17"), stages=(ARMING,), protocols=ONCE,
        extra_ticks=RESTART),
    Row("N02", "drop node=sensors", RELAX, 1, 30.0, ("N02",), EVERYWHERE),
    Row("N02", "off node={node}", RELAX, 5, rows=("B17", "B02", "N01"), stages=EVERYWHERE),
    Row("N04", "stuck encoder={node}", RELAX, 2, 500.0, ("N04", "T04", "N05", "N06"), (FREE,)),
    Row("N04", "stuck joint={joint}", RELAX, 2, 500.0, ("N04", "N06", "T08"), (FREE,)),
    Row("N05", "offset encoder={node} size={jump}", RELAX, 3, rows=("N05",)),
    Row("N06", "drift joint={joint} size=0.8", RELAX, 4, 900.0, ("N06", "T08")),
    Row("N07", "noise encoder={node} size={rough}", HOLD, 4, 60.0, ("N07", "N05")),
    Row("N08", "watchdog node={node}", RELAX, 2, rows=("N08",), stages=EVERYWHERE, extra_ms=HEARTBEAT),
    Row("N09", "hot node={node} size=95", RELAX, 22, rows=("N09b",), protocols=(MIT, ODRIVE),
        extra_ms={ODRIVE: 200.0}),
    Row("N09", "hot node={node} size=80", WARN, 22, rows=("N09a",), protocols=(MIT, ODRIVE),
        extra_ms={ODRIVE: 200.0}),
    Row("N10", "voltage node={node}", RELAX, 2, rows=("N10",), stages=EVERYWHERE, extra_ms=HEARTBEAT),
    Row("N11", "error node={node}", RELAX, 2, rows=("N11",), stages=EVERYWHERE, extra_ms=HEARTBEAT),
    Row("N11", "error node={node} size=3", CUT, 2, rows=("N11b",), protocols=(MIT,)),
    Row("N11", "error node={node} size=0xff01", CUT, 2, rows=("N11b",), protocols=(CIA402,)),
    Row("N11", "error node={node} size=0x20000000", CUT, 2, rows=("N11b",), protocols=(ODRIVE,), extra_ms=HEARTBEAT),
    Row("N12", "forget node={node}", CUT, 4, 1000.0, ("N12",)),
    Row("N13", "twin node={node} seed=1", RELAX, 2, rows=("B06", "N13"), protocols=ONCE),
    Row("N13", "duplicate node={node} seed=1", RELAX, 4, rows=("N13", "B06"), protocols=ONCE),
    Row("N14", "disobey node={node} size=0", RELAX, 22, rows=("N14", "T02", "T04"), stages=(GRASP,), protocols=ONCE),
    Row("N14", "runaway node={node}", RELAX, 10, rows=("N14", "T03", "N05", "T04")),
    Row("N14", "ripple node={node} size=0.2 hz=20", RELAX, 22, 600.0, ("N14b", "T03", "N07", "T01"), (GRASP,)),
    Row("N15", "slow node={node} size=2", WARN, 22, rows=("N15",), protocols=ONCE),
    Row("N15", "slow node={node} size=4", WARN, 4, rows=("B01",), protocols=(ODRIVE,)),
    Row("N16", "hold_on node={node}", CUT, 2, 100.0, ("N16",), (GRASP,)),
    Row("N17", "swap node={node} with={other}", RELAX, 2, 1000.0, ("N17", *_EXCHANGED), protocols=ONCE),
    Row("N17", "cross node={node} with={other}", RELAX, 2, 1000.0, ("N17", *_EXCHANGED), protocols=ONCE),
    Row("N17", "late node={node} size=50", RELAX, 2, 4000.0, ("N17", *_EXCHANGED), protocols=ONCE),
    Row("T01", "snap tendon={tendon}", RELAX, 10, rows=("T01",), stages=(GRASP,)),
    Row("T02", "snap tendon={tendon}", WARN, 4, 110.0, ("T02", "T01", "N04"), (FREE,)),
    Row("T02", "slack tendon={tendon} size=30", WARN, 10, rows=("T02", "T01"), stages=(GRASP,)),
    Row("T03", "offset cell={tendon} size={trip}", RELAX, 2, rows=("T03",), stages=(GRASP,)),
    Row("T03", "offset cell={tendon} size={limit}", CUT, 2, rows=("T03b",), stages=(GRASP,)),
    Row("T03", "runaway node={node} size=1 seed=1", RELAX, 10, rows=("T03", "N14", "T06"), stages=(GRASP,)),
    Row("T04", "drift cell={tendon} size=60", RELAX, 2, 500.0, ("T04", "T03", "N14", "T02"), (GRASP,)),
    Row("T04", "drift cell={tendon} size=-60", RELAX, 2, 500.0, ("T04", "T02", "T01"), (GRASP,)),
    Row("T05", "stuck cell={tendon}", RELAX, 42, 300.0, ("T05", "T04"), (GRASP,)),
    Row("T05", "old cell={tendon} size=16", RELAX, 20, rows=("T05b",)),
    Row("T05", "old cell={tendon} size=50", RELAX, 20, rows=("T05b",)),
    Row("T06", "saturate cell={tendon} size=1", RELAX, 4, rows=("T06",), stages=EVERYWHERE),
    Row("T06", "saturate cell={tendon} size=-1", RELAX, 4, rows=("T06", "T01"), stages=EVERYWHERE),
    Row("T08", "offset joint={joint} size=0.4", RELAX, 8, 400.0, ("T08", "N06", "N05")),
    Row("H01", HOST + "late 0.4", Action.PASS, 1, rows=("H01",)),
    Row("H02", HOST + "skip 1", WARN, 1, rows=("H02",)),
    Row("H03", HOST + "skip 14", RELAX, 1, rows=("H03",)),
    Row("H04", HOST + "io suspended", RELAX, 1, rows=("H04",)),
    Row("H06", HOST + "ask stop", RELAX, 1, rows=("",), stages=EVERYWHERE),
    Row("H06", HOST + "ask cut", CUT, 1, rows=("",), stages=EVERYWHERE),
    Row("H08", HOST + "io recorder disk_full", WARN, 1, rows=("H08",)),
    Row("H09", HOST + "io recorder dropped", WARN, 1, rows=("H09",)),
    Row("H10", HOST + "io recorder gone", WARN, 1, rows=("H10",)),
    Row("H13", "foreign node={node}", RELAX, 2, rows=("H13",), stages=EVERYWHERE),
    Row("I07", HOST + "ask nonsense 3", RELAX, 1, rows=("I07b",)),
)  # fmt: skip
"""All rows that a simulator or the loop can produce while the hand is armed."""

LIKELIEST = ("B01", "B02", "B03", "B17", "N01", "N02", "N08", "N11", "T01", "T04", "T06", "H02")
"""The faults of which all pairs are tried: cables, connectors, supply, ropes, a busy host."""
LEFT_OUT = {
    "B18": "before arming: unit tests with error frames", "N03": "before arming: tests of the modes",
    "T07": "commissioning: its own tests",
    "T09": "needs minutes of motion: tests of the residuals", "H05": "real processes: tests/runtime",
    "H07": "real processes: tests of the loop", "H11": "real processes, as root in a guest: tests/vcan",
    "H12": "real processes",
    "H14": "real processes", "H15": "the soak",
}  # fmt: skip
"""Rows of sections 2.1 to 2.4 that are not in the matrix, and where they are tried instead."""


def scenarios(hand: Hand, protocol: str, period_ms: float) -> list[Scenario]:
    """Every row on the first and the last instance, in every stage that it is for, at a control period [ms]."""
    found = []
    for row in MATRIX:
        if protocol in row.protocols:
            every = texts(hand, row.fault, period_ms)
            ends = dict.fromkeys(every[:1] + every[-1:])
            found += [Scenario(row, text, stage) for stage in row.stages for text in ends]
    return found


def pairs(hand: Hand, protocol: str, period_ms: float) -> list[Scenario]:
    """The likeliest faults two by two, in a grasp: the graver one first, the other one a little later elsewhere."""
    rows = [next(row for row in MATRIX if row.id == id_ and protocol in row.protocols) for id_ in LIKELIEST]
    found = []
    for i, first in enumerate(rows):
        for second in rows[i + 1 :]:
            main, other = (first, second) if first.action >= second.action else (second, first)
            text, second_text = texts(hand, main.fault, period_ms)[0], texts(hand, other.fault, period_ms)[-1]
            found.append(Scenario(main, text, GRASP, second_text))
    return found


def texts(hand: Hand, fault: str, period_ms: float) -> list[str]:
    """A fault on each instance; nothing where the hand has none that can show it."""
    if fault.startswith(HOST):
        return [fault]
    sizes = {
        "late": max(LATE_MS, LATE_TICKS * period_ms),
        "jump": JUMP_RAD * max(1.0, period_ms / JUMP_MS),
        "rough": ROUGH_RAD * max(1.0, (period_ms / ROUGH_MS) ** 2),
    }
    words = {name: f"{size:g}" for name, size in sizes.items()}
    return [fault.format(**words, **instance) for instance in _instances(hand, fault)]


def _instances(hand: Hand, fault: str) -> list[dict[str, str]]:
    """What stands for {node} and the like, for each instance; for one only, where the fault names none."""
    if "{tendon}" in fault:
        limited = "{trip}" in fault or "{limit}" in fault
        return [
            {"tendon": rope.name, "trip": f"{rope.tension_trip_N:g}", "limit": f"{rope.drive_limit_N:g}"}
            for rope in hand.tendon
            if not limited or rope.tension_trip_N < READABLE_N
        ]
    if "{other}" in fault:
        motors = [motor.name for motor in hand.motor]
        return [{"node": one, "other": other} for one, other in pairwise(motors)]
    names = {
        "node": [motor.name for motor in hand.motor],
        "digit": list(hand.digit_names),
        "bus": list(hand.bus_names),
        "joint": list(hand.sensor_node.joints),
    }
    return next(([{key: name} for name in names[key]] for key in names if f"{{{key}}}" in fault), [{}])
