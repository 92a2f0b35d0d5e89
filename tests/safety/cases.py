"""Cases of each fault: input that shows the fault, input just below its limit, its action, and who may clear it."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from handctl.core.detectors.residuals import (
    BALANCE,
    COMMAND_DIFFERENCE,
    EXCESS_FRICTION,
    JERK,
    SLIP,
    TENSION,
)
from handctl.core.tick_types import HandMode
from handctl.drives.contract import DrivePhase
from handctl.drives.fault_causes import DriveFaultCause
from handctl.safety.action import SafetyAction
from handctl.safety.tick_verdict import EventReport, filter_error_frames, second_controller_reports
from tests.safety.monitor import NOW_NS, PERIOD_NS, Monitor, Rows, T, synthetic_limits

COUNT = 8
"""Number of tendons of the hand.

Faults that exclude each other in one tendon are shown in two tendons, so that all faults can be
present at once.
"""
LIMITS = replace(
    synthetic_limits(COUNT), tension_trip=(140.0, 50.0, *(140.0,) * 6), drive_limit=(160.0, 60.0, *(160.0,) * 6)
)  # fmt: skip
CELLS = COUNT
"""Index of all load cells together among the nodes of the hand."""


class TickInput(NamedTuple):
    """Input of the safety monitor for one tick.

    Rows of the state that differ from those at rest are given by field and index. Reports come from
    buses and host.
    """

    rows: Mapping[str, dict[object, float]] = MappingProxyType({})
    reports: tuple[EventReport, ...] = ()


REST = TickInput()


class Case(NamedTuple):
    """Expected behaviour of one fault.

    Attributes:
        present: input that shows the fault. almost: input that is just below its limit.
        instance: name of the part that has the fault. debounce: ticks until the fault counts. action: action that the
            fault demands. latched: whether only an operator ends the fault.
        asleep: whether the fault does not count while no drive is armed.
    """

    present: TickInput
    almost: TickInput
    instance: str
    debounce: int
    action: SafetyAction
    latched: bool
    asleep: bool = False


def rows(**cells: object) -> TickInput:
    """Return an input with rows of the state. A row is one number for a field of the run, or numbers by index."""
    return TickInput({name: c if isinstance(c, dict) else {...: c} for name, c in cells.items()})  # type: ignore[misc]


def frame_ages(field: str, **late: int) -> TickInput:
    """Return an input with the ages of frames in ticks.

    The frames are feedback of motors (m1=...), or of load cells (t1=...) or joint encoders
    (j1=...).
    """
    first = COUNT if field == "group_ns" and min(late)[0] == "j" else 0
    return rows(
        **{
            field: {
                first + int(name[1:]): NOW_NS - ticks * PERIOD_NS for name, ticks in late.items()
            }
        }
    )


def motors(**late: int) -> TickInput:
    return frame_ages("feedback_ns", **late)


def sensors(**late: int) -> TickInput:
    return frame_ages("group_ns", **late)


def lost(**number: int) -> TickInput:
    """Return an input with lost frames of nodes (m1=..., cells=...) in the last ticks before the present one."""
    return rows(
        lost={
            (0, CELLS if name == "cells" else int(name[1:])): (1 << n) - 1
            for name, n in number.items()
        }
    )


def misshapen(node: int, before: int) -> TickInput:
    """Return an input with frames of a wrong length from a node, one in this tick and ``before`` in earlier ticks."""
    return rows(misread_now={node: 1}, misshapen={node: (1 << before) - 1})


def residual(row: int, **values: float) -> TickInput:
    """Return an input with one kind of filtered residual, for the named tendons or motors."""
    return rows(residual={(row, int(name[1:])): value for name, value in values.items()})


def tensions(**values: float) -> TickInput:
    return rows(measured_tension={int(name[1:]): value for name, value in values.items()})


def heat(**values: float) -> TickInput:
    return rows(temperature={int(name[1:]): value for name, value in values.items()})


def error(motor: int, cause: DriveFaultCause, code: int = 9) -> TickInput:
    return rows(
        phase={motor: int(DrivePhase.FAULT)},
        fault_cause={motor: int(cause)},
        fault_code={motor: code},
    )


def io(kind: str, where: str = "can0", number: int = 1) -> TickInput:
    return TickInput(reports=((kind, where, float(number)),))


def merge_inputs(*shown: TickInput) -> TickInput:
    """Combine several inputs into one input of the same tick."""
    cells: dict[str, dict[object, float]] = {}
    for one in shown:
        for name, values in one.rows.items():
            larger = min if name.endswith("_ns") and name != "late_ns" else max
            mine = cells.setdefault(name, {})
            for index, value in values.items():
                mine[index] = larger(mine[index], value) if index in mine else value
    return TickInput(cells, tuple(dict.fromkeys(report for one in shown for report in one.reports)))


def without_torque(shown: TickInput) -> TickInput:
    """Return an input with the mode of a hand that is ready to be armed."""
    return TickInput({**shown.rows, "mode": {...: int(HandMode.READY)}}, shown.reports)


def slack_tendon(before: int, tendon: int = 3) -> TickInput:
    """Return an input with a tendon that is slack now and was slack in the ``before`` ticks before."""
    return rows(
        slack_ticks={tendon: before}, taut_ago={tendon: 5}, residual={(TENSION, tendon): 0.0}
    )


def derailed(tendon: int, deg: float) -> TickInput:
    """Return an input with an angle between joint and spool of a tendon. It is the third such reading in a row."""
    excursion = -20.0 / 1e5 - 0.02 * np.radians(deg)
    return rows(joints_read=1, taut_s={tendon: 1.0}, slip_from={tendon: 0.0}, derailed={tendon: 2.0},
                measured_excursion={tendon: excursion})  # fmt: skip


def stream(silence_ns: int) -> TickInput:
    """Return an input with an open stream of targets. Its latest target was sent ``silence_ns`` ago."""
    return rows(streaming=2, stream_sent_ns=NOW_NS - silence_ns)


def stuck_motor(motor: int, goal: float) -> TickInput:
    return rows(motor_value={motor: 0.0}, motor_stuck={motor: 50}, motor_anchor={(0, motor): 0.0, (1, motor): 20.0},
                followed={motor: goal})  # fmt: skip


def stuck_joint(joint: int, deg: float) -> TickInput:
    turned = np.radians(deg) / 50.0 + 20.0 / 1e5
    return rows(joint_value={joint: 0.3}, joint_stuck={joint: 50}, joint_anchor={joint: 0.0},
                measured_joint={joint: 0.3}, measured_travel={joint: turned})  # fmt: skip


def replayed_readings(tendon: int, run: int) -> TickInput:
    """Return an input with load-cell readings that repeat those of 16 ticks ago, ``run`` times in a row."""
    past = {(age, tendon): 20.0 + (age - 15) / 16.0 for age in range(64)}
    return rows(past=past, same={(15, tendon): run - 1})


def alone_on_the_bus(heard: bool) -> TickInput:
    reports = filter_error_frames([("error_frame", "can0 no acknowledge", 3.0)], heard)
    return TickInput({"mode": {...: int(HandMode.INVENTORY)}}, tuple(reports))


RELAXED = {"mode": {...: int(HandMode.RELAX)}, "mode_since": {...: NOW_NS * 1e-9 - 0.2}}
"""Rows of the state of a hand that has been relaxing for longer than its tendons need to lose their tension."""
AFTER_CUT = {"mode": {...: int(HandMode.CUT)}, "cut_ticks": {...: 49}}
"""Rows of the state of a hand whose motor torque was cut 100 ms ago."""


def pulled(tension: float) -> TickInput:
    return TickInput(
        {**AFTER_CUT, "measured_tension": {...: 5.0, 0: tension}, "cut_from": {0: 30.0}}
    )


def swinging(tendon: int, before: float) -> TickInput:
    return rows(swing_square={tendon: 90.0}, swing_s={tendon: before})


def report_fractions(motor: int, part: float) -> TickInput:
    """Return an input with a motor that reports the fraction ``part`` of each change of its command by 1 N."""
    return rows(
        report_moments={
            (row, motor): value for row, value in enumerate((1.0, part, part, 1.0, 0.95))
        }
    )


PASS, WARN, HOLD, RELAX, CUT = SafetyAction
CASES = {
    "B01": Case(motors(m1=1), REST, "m1", 1, WARN, False, True),
    "B02": Case(motors(m0=6), motors(**dict.fromkeys(LIMITS.motors, 5)), "m0", 1, RELAX, True, True),
    "B03a": Case(lost(m1=21), lost(m0=20, m1=20, cells=20), "m1", 1, HOLD, False, True),
    "B03b": Case(lost(cells=41), lost(m0=40, m1=40, cells=40), "load cells", 1, RELAX, True, True),
    "B04": Case(rows(stale_now=1), REST, "load cells", 1, WARN, False, True),
    "B05": Case(rows(twice={0: 1}), REST, "m0", 1, WARN, False, True),
    "B06": Case(rows(twice={2: 2}), rows(twice={2: 1}), "m2", 1, RELAX, True, True),
    "B07": Case(rows(stale_now=2), rows(stale_now=1), "load cells", 1, WARN, False, True),
    "B08": Case(misshapen(1, 2), misshapen(1, 1), "m1", 1, RELAX, True, True),
    "B09": Case(misshapen(1, 0), rows(misshapen={1: 1}), "m1", 1, WARN, False, True),
    "B10": Case(rows(strange=50, unknown=0.1 / (1.0 - T)), rows(strange=50), "bus", 1, WARN, False),
    "B11a": Case(rows(frames=65), rows(frames=64), "bus", 2, RELAX, True, True),
    "B11b": Case(rows(frames=65), rows(frames=128, missed=1), "bus", 10, CUT, True, True),
    "B12": Case(io("bus_off"), io("bus_on"), "can0", 1, CUT, True),
    "B13a": Case(io("error_warning"), io("error_active"), "can0", 1, WARN, False),
    "B13b": Case(io("error_passive"), io("error_warning"), "can0", 20, RELAX, True),
    "B14": Case(io("enetdown"), io("enobufs"), "can0", 1, CUT, True),
    "B15": Case(io("enobufs"), io("dropped"), "can0", 2, RELAX, True),
    "B16": Case(io("enodev"), io("enetdown"), "can0", 1, CUT, True),
    "B17": Case(motors(m0=4), motors(**dict.fromkeys(LIMITS.motors, 4)), "m0", 1, RELAX, True, True),
    "B18": Case(alone_on_the_bus(False), alone_on_the_bus(True), "can0 no acknowledge", 20, RELAX, True),
    "N01": Case(error(1, DriveFaultCause.DROPPED_OUT), error(1, DriveFaultCause.OTHER), "m1", 1, RELAX, True, True),
    "N02": Case(sensors(t1=6), sensors(**dict.fromkeys(LIMITS.tendons, 5)), "t1", 1, RELAX, True, True),
    "N02b": Case(sensors(j1=16), sensors(j1=15), "j1", 1, RELAX, True, True),
    "N04": Case(stuck_motor(5, 0.6e-3), stuck_motor(5, 0.49e-3), "m5", 1, RELAX, True, True),
    "N05a": Case(rows(jump={0: 0.4}), REST, "m0", 1, WARN, False),
    "N05b": Case(rows(jump={0: 0.4}, dropped={0: 2.0}), rows(jump={0: 0.4}, dropped={0: 1.0}), "m0", 1, RELAX, True),
    "N06a": Case(residual(SLIP, t1=3.1), residual(SLIP, t0=3.0), "t1", 1, WARN, False, True),
    "N06b": Case(residual(SLIP, t0=6.1), residual(SLIP, t1=6.0), "t0", 1, RELAX, True, True),
    "N07": Case(residual(JERK, m1=1.1e-4), residual(JERK, m0=1e-4), "m1", 1, HOLD, False, True),
    "N08": Case(error(2, DriveFaultCause.WATCHDOG), error(2, DriveFaultCause.VOLTAGE), "m2", 1, RELAX, True, True),
    "N09a": Case(heat(m0=70.1), heat(m0=70.0), "m0", 20, WARN, False),
    "N09b": Case(heat(m1=85.1), heat(m1=85.0), "m1", 20, RELAX, True),
    "N10": Case(error(3, DriveFaultCause.VOLTAGE), error(3, DriveFaultCause.HOT), "m3", 1, RELAX, True, True),
    "N11": Case(error(4, DriveFaultCause.OTHER), rows(fault_cause={4: DriveFaultCause.OTHER}), "m4", 1, RELAX, True,
    True),
    "N11b": Case(error(5, DriveFaultCause.UNKNOWN), error(5, DriveFaultCause.OTHER), "m5", 1, CUT, True, True),
    "N12": Case(error(6, DriveFaultCause.MISMATCH), error(6, DriveFaultCause.OTHER), "m6", 1, CUT, True, True),
    "N13": Case(rows(twice={0: 1}), REST, "m0", 3, RELAX, True, True),
    "N14": Case(
        residual(COMMAND_DIFFERENCE, m0=15.1), residual(COMMAND_DIFFERENCE, m1=15.0), "m0", 1, RELAX, True, True
    ),
    "N14b": Case(swinging(1, 0.25), swinging(1, 0.25 - 1.5 * T), "t1", 1, RELAX, True, True),
    "N15": Case(lost(m7=0)._replace(rows={"lost": {(0, 7): 0b1010101010101}}),
                lost(m7=0)._replace(rows={"lost": {(0, 7): 0b10101010101}}), "m7", 1, WARN, False, True),
    "N16": Case(pulled(30.0), pulled(14.9), "t0", 1, CUT, True, True),
    "N17": Case(report_fractions(1, 0.1), report_fractions(1, 0.2), "m1", 1, RELAX, True, True),
    "T01": Case(rows(measured_tension={3: 0.0}, speed={3: 0.1}), rows(measured_tension={3: 0.0}, speed={3: 0.03}),
                "t3", 2, RELAX, True, True),
    "T02a": Case(slack_tendon(25), slack_tendon(24), "t3", 1, WARN, False, True),
    "T02b": Case(slack_tendon(250), slack_tendon(249), "t3", 1, RELAX, True, True),
    "T03": Case(tensions(t1=50.1), tensions(t0=139.9, t1=50.0), "t1", 1, RELAX, True),
    "T03b": Case(tensions(t1=60.1), tensions(t0=159.9, t1=60.0), "t1", 1, CUT, True),
    "T03c": Case(tensions(t1=50.1)._replace(rows=tensions(t1=50.1).rows | RELAXED),
                 tensions(t0=139.9, t1=50.0)._replace(rows=tensions(t0=139.9, t1=50.0).rows | RELAXED),
                 "t1", 1, CUT, True, True),
    "T04a": Case(residual(BALANCE, t0=5.1), residual(BALANCE, t1=5.0), "t0", 1, WARN, False, True),
    "T04b": Case(residual(BALANCE, t1=10.1), residual(BALANCE, t0=10.0), "t1", 1, RELAX, True, True),
    "T05": Case(rows(cell_value={2: 20.0}, cell_stuck={2: 39}, cell_anchor={2: 14.0}),
                rows(cell_value={2: 20.0}, cell_stuck={2: 38}, cell_anchor={2: 14.0}), "t2", 1, RELAX, True, True),
    "T05b": Case(replayed_readings(2, 16), replayed_readings(2, 7), "t2", 1, RELAX, True, True),
    "T06": Case(tensions(t0=244.0), tensions(t0=243.9, t1=-4.9), "t0", 3, RELAX, True, True),
    "T08": Case(derailed(4, 15.1), derailed(4, 14.9), "t4", 1, RELAX, True, True),
    "T09": Case(residual(EXCESS_FRICTION, t0=3.1), residual(EXCESS_FRICTION, t1=3.0), "t0", 1, WARN, False, True),
    "H01": Case(rows(late_ns=520_000), rows(late_ns=500_000), "loop", 1, PASS, False),
    "H02": Case(rows(missed=1), REST, "loop", 1, WARN, False),
    "H03": Case(rows(missed=5), rows(missed=4), "loop", 1, RELAX, True, True),
    "H04": Case(io("suspended", "host", 900), io("recorder", "host"), "host", 1, RELAX, True),
    "H08": Case(io("recorder", "disk_full"), io("recorder", "misshapen"), "disk_full", 1, WARN, False),
    "H09": Case(io("recorder", "dropped"), io("dropped", "dropped"), "dropped", 1, WARN, False),
    "H10": Case(io("recorder", "gone"), io("recorder", "misshapen"), "gone", 1, WARN, False),
    "H13": Case(TickInput(reports=tuple(second_controller_reports(["0x001"]))), REST, "0x001", 1, RELAX, True),
    "I07a": Case(rows(refused_now=1, refused=1), rows(refused=1), "goal", 1, WARN, False, True),
    "I07b": Case(rows(refused_now=1, refused=3), rows(refused_now=1, refused=2), "goal", 1, RELAX, True, True),
    "I11a": Case(stream(100_000_001), stream(100_000_000), "stream", 1, HOLD, False, True),
    "I11b": Case(stream(1_000_000_001), stream(1_000_000_000), "stream", 1, RELAX, True, True),
}  # fmt: skip
OTHER_SIGNS = {
    "B16": [io("ebadf")],
    "N04": [stuck_joint(0, 11.0), stuck_motor(5, -0.6e-3)],
    "N05a": [rows(joint_jump={0: 0.4})],
    "N05b": [rows(joint_jump={0: 0.4}, joint_dropped={0: 2.0})],
    "N11": [error(4, DriveFaultCause.HOT), error(4, DriveFaultCause.LOST)],
    "T06": [
        tensions(t0=-5.0),
        tensions(t0=300.0),
        merge_inputs(tensions(t0=-3.0), rows(saturated={0: 1})),
        merge_inputs(tensions(t0=9.0), rows(saturated={0: 1})),
    ],
    "H08": [io("recorder", "disk_low")],
    "H09": [io("recorder", "filling")],
    "H10": [io("recorder", "error")],
}


def rested_monitor() -> Monitor:
    """Return the safety monitor of a hand at rest. The residuals of the hand keep the values that a test sets."""
    return Monitor(LIMITS, residual_fraction=0.0, coulomb=0.0, stiffness=1e5)


def show(monitor: Monitor, shown: TickInput) -> Rows:
    """Reset a monitor to a hand at rest, and return the rows of an input that are to be set for one tick."""
    monitor.forget()
    return dict(shown.rows)
