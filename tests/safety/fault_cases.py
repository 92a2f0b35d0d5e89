"""Test cases for each fault.

A test case has two inputs of the safety monitor: one with the fault, and one just below the limit
of the fault. A test case contains the required action, and a flag that is True if only an operator
is allowed to clear the fault.
"""

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
from handctl.drives.contract import DriveFaultCause, DrivePhase
from handctl.safety.safety_action import SafetyAction
from handctl.safety.tick_verdict import EventReport, filter_error_frames, second_controller_reports
from tests.safety.synthetic_monitor import (
    NOW_NS,
    PERIOD_NS,
    PERIOD_S,
    StateValues,
    SyntheticMonitor,
    synthetic_limits,
)

TENDON_COUNT = 8
"""Number of tendons of the hand in the test cases.

Some faults cannot occur together in one tendon. In a hand with eight tendons, all faults can occur
at once.
"""
EIGHT_TENDON_LIMITS = replace(
    synthetic_limits(TENDON_COUNT), tension_trip=(140.0, 50.0, *(140.0,) * 6), drive_limit=(160.0, 60.0, *(160.0,) * 6)
)  # fmt: skip
LOAD_CELLS_NODE_INDEX = TENDON_COUNT
"""Index that stands for all load cells together in the list of the hand's nodes."""


class TickInput(NamedTuple):
    """Input of the safety monitor for one tick.

    ``state_values`` contains the values of the state that differ from a hand at rest. For each
    changed field, ``state_values`` contains a dictionary from an index to a number. ``reports``
    contains events of the buses and of the host.
    """

    state_values: Mapping[str, dict[object, float]] = MappingProxyType({})
    reports: tuple[EventReport, ...] = ()


INPUT_AT_REST = TickInput()


class FaultCase(NamedTuple):
    """Expected behaviour of one fault.

    Attributes:
        input_with_fault: input that shows the fault.
        input_below_limit: input that is just below the limit of the fault.
        faulty_part: name of the part of the hand that has the fault.
        debounce_ticks: number of ticks with the fault until the fault is reported.
        action: action that the fault demands.
        is_latched: True if only an operator can clear the fault.
        is_found_only_while_armed: True if the fault is reported only while a drive is armed.
    """

    input_with_fault: TickInput
    input_below_limit: TickInput
    faulty_part: str
    debounce_ticks: int
    action: SafetyAction
    is_latched: bool
    is_found_only_while_armed: bool = False


def state_input(**values_by_field: object) -> TickInput:
    """Return an input of the safety monitor, with the given values in the named fields of the state.

    If a field of the state applies to the whole run, the argument is a single number. If a field is
    an array, the argument is a dictionary from an array index to a number.
    """
    return TickInput(
        {name: c if isinstance(c, dict) else {...: c} for name, c in values_by_field.items()}
    )  # type: ignore[misc]


def frame_ages(field: str, **age_by_node: int) -> TickInput:
    """Return an input in which the latest frames of the named nodes are some ticks old.

    Each keyword is the name of a node. The value of the keyword is the age of the latest frame of
    the node [ticks]. Examples of keywords are m1=... for motor 1, t1=... for load cell 1, and
    j1=... for joint encoder 1.
    """
    first_index = TENDON_COUNT if field == "group_ns" and min(age_by_node)[0] == "j" else 0
    return state_input(
        **{
            field: {
                first_index + int(name[1:]): NOW_NS - ticks * PERIOD_NS
                for name, ticks in age_by_node.items()
            }
        }
    )


def late_motor_frames(**age_by_motor: int) -> TickInput:
    return frame_ages("feedback_ns", **age_by_motor)


def late_sensor_frames(**age_by_sensor: int) -> TickInput:
    return frame_ages("group_ns", **age_by_sensor)


def lost_frames(**lost_frames_by_node: int) -> TickInput:
    """Return an input in which nodes have lost frames in the ticks before the present tick.

    Each keyword is the name of a node, and its value is the number of frames that this node has
    lost. Examples of keywords are m1=... for motor 1, and cells=... for the load cells.
    """
    return state_input(
        lost={
            (0, LOAD_CELLS_NODE_INDEX if name == "cells" else int(name[1:])): (1 << n) - 1
            for name, n in lost_frames_by_node.items()
        }
    )


def malformed_frames(node_index: int, earlier_frames: int) -> TickInput:
    """Return an input in which a frame of a node has a wrong length.

    In earlier ticks, ``earlier_frames`` frames with a wrong length have arrived.
    """
    return state_input(
        misread_now={node_index: 1}, misshapen={node_index: (1 << earlier_frames) - 1}
    )


def filtered_residuals(residual_kind: int, **residual_by_part: float) -> TickInput:
    """Return an input in which one kind of filtered residual has given values at the named tendons or motors."""
    return state_input(
        residual={(residual_kind, int(name[1:])): value for name, value in residual_by_part.items()}
    )


def measured_tensions(**tension_by_tendon: float) -> TickInput:
    return state_input(
        measured_tension={int(name[1:]): value for name, value in tension_by_tendon.items()}
    )


def drive_temperatures(**temperature_by_motor: float) -> TickInput:
    return state_input(
        temperature={int(name[1:]): value for name, value in temperature_by_motor.items()}
    )


def drive_error(motor_index: int, cause: DriveFaultCause, error_code: int = 9) -> TickInput:
    return state_input(
        phase={motor_index: int(DrivePhase.FAULT)},
        fault_cause={motor_index: int(cause)},
        fault_code={motor_index: error_code},
    )


def event_report(event_kind: str, place_name: str = "can0", report_value: int = 1) -> TickInput:
    return TickInput(reports=((event_kind, place_name, float(report_value)),))


def merge_inputs(*tick_input: TickInput) -> TickInput:
    """Combine several inputs into one input of the same tick."""
    cells: dict[str, dict[object, float]] = {}
    for single_input in tick_input:
        for name, values in single_input.state_values.items():
            merge_function = min if name.endswith("_ns") and name != "late_ns" else max
            merged_cells = cells.setdefault(name, {})
            for index, value in values.items():
                merged_cells[index] = (
                    merge_function(merged_cells[index], value) if index in merged_cells else value
                )
    return TickInput(
        cells,
        tuple(
            dict.fromkeys(report for single_input in tick_input for report in single_input.reports)
        ),
    )


def input_without_torque(tick_input: TickInput) -> TickInput:
    """Copy an input, and set the mode of the hand to READY in the copy.

    In the mode READY, the hand is not armed yet, but can be armed.
    """
    return TickInput(
        {**tick_input.state_values, "mode": {...: int(HandMode.READY)}}, tick_input.reports
    )


def slack_tendon(earlier_slack_ticks: int, tendon_index: int = 3) -> TickInput:
    """Return an input with a slack tendon.

    The tendon is slack in the present tick, and was slack in the ``earlier_slack_ticks`` previous
    ticks.
    """
    return state_input(
        slack_ticks={tendon_index: earlier_slack_ticks},
        taut_ago={tendon_index: 5},
        residual={(TENSION, tendon_index): 0.0},
    )


def derailed_tendon(tendon_index: int, deviation_deg: float) -> TickInput:
    """Return an input in which the angles of a tendon's joint and spool disagree by ``deviation_deg`` [deg].

    Joint and spool disagree in three successive readings, the present reading included.
    """
    excursion = -20.0 / 1e5 - 0.02 * np.radians(deviation_deg)
    return state_input(
        joints_read=1,
        taut_s={tendon_index: 1.0},
        slip_from={tendon_index: 0.0},
        derailed={tendon_index: 2.0},
        measured_excursion={tendon_index: excursion},
    )


def open_stream(silence_ns: int) -> TickInput:
    """Return an input with an open stream of targets.

    The latest target of the stream was sent ``silence_ns`` ago.
    """
    return state_input(streaming=2, stream_sent_ns=NOW_NS - silence_ns)


def stuck_motor(motor_index: int, goal_change_m: float) -> TickInput:
    return state_input(motor_value={motor_index: 0.0}, motor_stuck={motor_index: 50},
                       motor_anchor={(0, motor_index): 0.0, (1, motor_index): 20.0},
                       followed={motor_index: goal_change_m})  # fmt: skip


def stuck_joint(joint_index: int, spool_turn_deg: float) -> TickInput:
    spool_excursion_m = np.radians(spool_turn_deg) / 50.0 + 20.0 / 1e5
    return state_input(joint_value={joint_index: 0.3}, joint_stuck={joint_index: 50}, joint_anchor={joint_index: 0.0},
                       measured_joint={joint_index: 0.3}, measured_travel={joint_index: spool_excursion_m})  # fmt: skip


def replayed_readings(tendon_index: int, repeated_readings: int) -> TickInput:
    """Return an input with repeated load-cell readings.

    Each of the last ``repeated_readings`` readings of the load cell equals the reading 16 ticks
    before it.
    """
    past_readings = {(age, tendon_index): 20.0 + (age - 15) / 16.0 for age in range(64)}
    return state_input(past=past_readings, same={(15, tendon_index): repeated_readings - 1})


def unacknowledged_frames_input(is_other_node_heard: bool) -> TickInput:
    reports = filter_error_frames(
        [("error_frame", "can0 no acknowledge", 3.0)], is_other_node_heard
    )
    return TickInput({"mode": {...: int(HandMode.INVENTORY)}}, tuple(reports))


RELAX_STATE_VALUES = {
    "mode": {...: int(HandMode.RELAX)},
    "mode_since": {...: NOW_NS * 1e-9 - 0.2},
}
"""Values of the state of a hand that has already been relaxing for longer than a hand usually needs to relax."""
CUT_STATE_VALUES = {"mode": {...: int(HandMode.CUT)}, "cut_ticks": {...: 49}}
"""Values of the state of a hand whose motors were disabled 100 ms ago."""


def tension_after_cut(tension_N: float) -> TickInput:
    return TickInput(
        {
            **CUT_STATE_VALUES,
            "measured_tension": {...: 5.0, 0: tension_N},
            "cut_from": {0: 30.0},
        }
    )


def swinging_tension(tendon_index: int, duration_before: float) -> TickInput:
    return state_input(swing_square={tendon_index: 90.0}, swing_s={tendon_index: duration_before})


def partial_torque_reports(motor_index: int, reported_fraction: float) -> TickInput:
    """Return an input with a motor whose torque reports change too little.

    After a change of the torque command, the torque report changes only by the fraction
    ``reported_fraction`` of the change.
    """
    return state_input(
        report_moments={
            (row, motor_index): value
            for row, value in enumerate((1.0, reported_fraction, reported_fraction, 1.0, 0.95))
        }
    )


PASS, WARN, HOLD, RELAX, CUT = SafetyAction
CASE_BY_FAULT = {
    "B01": FaultCase(late_motor_frames(m1=1), INPUT_AT_REST, "m1", 1, WARN, False, True),
    "B02": FaultCase(late_motor_frames(m0=6),
                     late_motor_frames(**dict.fromkeys(EIGHT_TENDON_LIMITS.motors, 5)), "m0", 1,
                     RELAX, True, True),
    "B03a": FaultCase(lost_frames(m1=21), lost_frames(m0=20, m1=20, cells=20), "m1", 1, HOLD, False, True),
    "B03b": FaultCase(lost_frames(cells=41), lost_frames(m0=40, m1=40, cells=40), "load cells", 1, RELAX, True, True),
    "B04": FaultCase(state_input(stale_now=1), INPUT_AT_REST, "load cells", 1, WARN, False, True),
    "B05": FaultCase(state_input(twice={0: 1}), INPUT_AT_REST, "m0", 1, WARN, False, True),
    "B06": FaultCase(state_input(twice={2: 2}), state_input(twice={2: 1}), "m2", 1, RELAX, True, True),
    "B07": FaultCase(state_input(stale_now=2), state_input(stale_now=1), "load cells", 1, WARN, False, True),
    "B08": FaultCase(malformed_frames(1, 2), malformed_frames(1, 1), "m1", 1, RELAX, True, True),
    "B09": FaultCase(malformed_frames(1, 0), state_input(misshapen={1: 1}), "m1", 1, WARN, False, True),
    "B10": FaultCase(state_input(strange=50, unknown=0.1 / (1.0 - PERIOD_S)), state_input(strange=50), "bus", 1, WARN,
                     False),
    "B11a": FaultCase(state_input(frames=65), state_input(frames=64), "bus", 2, RELAX, True, True),
    "B11b": FaultCase(state_input(frames=65), state_input(frames=128, missed=1), "bus", 10, CUT, True, True),
    "B12": FaultCase(event_report("bus_off"), event_report("bus_on"), "can0", 1, CUT, True),
    "B13a": FaultCase(event_report("error_warning"), event_report("error_active"), "can0", 1, WARN, False),
    "B13b": FaultCase(event_report("error_passive"), event_report("error_warning"), "can0", 20, RELAX, True),
    "B14": FaultCase(event_report("enetdown"), event_report("enobufs"), "can0", 1, CUT, True),
    "B15": FaultCase(event_report("enobufs"), event_report("dropped"), "can0", 2, RELAX, True),
    "B16": FaultCase(event_report("enodev"), event_report("enetdown"), "can0", 1, CUT, True),
    "B17": FaultCase(late_motor_frames(m0=4),
                     late_motor_frames(**dict.fromkeys(EIGHT_TENDON_LIMITS.motors, 4)), "m0", 1,
                     RELAX, True, True),
    "B18": FaultCase(
        unacknowledged_frames_input(False), unacknowledged_frames_input(True), "can0 no acknowledge", 20, RELAX, True),
    "N01": FaultCase(drive_error(1, DriveFaultCause.DROPPED_OUT), drive_error(1, DriveFaultCause.OTHER), "m1", 1,
                     RELAX, True, True),
    "N02": FaultCase(late_sensor_frames(t1=6),
                     late_sensor_frames(**dict.fromkeys(EIGHT_TENDON_LIMITS.tendons, 5)), "t1",
                     1, RELAX, True, True),
    "N02b": FaultCase(late_sensor_frames(j1=16), late_sensor_frames(j1=15), "j1", 1, RELAX, True, True),
    "N04": FaultCase(stuck_motor(5, 0.6e-3), stuck_motor(5, 0.49e-3), "m5", 1, RELAX, True, True),
    "N05a": FaultCase(state_input(jump={0: 0.4}), INPUT_AT_REST, "m0", 1, WARN, False),
    "N05b": FaultCase(state_input(jump={0: 0.4}, dropped={0: 2.0}), state_input(jump={0: 0.4}, dropped={0: 1.0}), "m0",
                      1, RELAX, True),
    "N06a": FaultCase(filtered_residuals(SLIP, t1=3.1), filtered_residuals(SLIP, t0=3.0), "t1", 1, WARN, False, True),
    "N06b": FaultCase(filtered_residuals(SLIP, t0=6.1), filtered_residuals(SLIP, t1=6.0), "t0", 1, RELAX, True, True),
    "N07": FaultCase(filtered_residuals(JERK, m1=1.1e-4), filtered_residuals(JERK, m0=1e-4), "m1", 1, HOLD, False,
                     True),
    "N08": FaultCase(drive_error(2, DriveFaultCause.WATCHDOG), drive_error(2, DriveFaultCause.VOLTAGE), "m2", 1, RELAX,
                     True, True),
    "N09a": FaultCase(drive_temperatures(m0=70.1), drive_temperatures(m0=70.0), "m0", 20, WARN, False),
    "N09b": FaultCase(drive_temperatures(m1=85.1), drive_temperatures(m1=85.0), "m1", 20, RELAX, True),
    "N10": FaultCase(drive_error(3, DriveFaultCause.VOLTAGE), drive_error(3, DriveFaultCause.OVERHEATED), "m3", 1,
                     RELAX, True, True),
    "N11": FaultCase(drive_error(4, DriveFaultCause.OTHER), state_input(fault_cause={4: DriveFaultCause.OTHER}), "m4",
                     1, RELAX, True,
    True),
    "N11b": FaultCase(drive_error(5, DriveFaultCause.UNKNOWN), drive_error(5, DriveFaultCause.OTHER), "m5", 1, CUT,
                      True, True),
    "N12": FaultCase(drive_error(6, DriveFaultCause.SETTING_MISMATCH), drive_error(6, DriveFaultCause.OTHER),
                     "m6", 1, CUT, True, True),
    "N13": FaultCase(state_input(twice={0: 1}), INPUT_AT_REST, "m0", 3, RELAX, True, True),
    "N14": FaultCase(
        filtered_residuals(COMMAND_DIFFERENCE, m0=15.1),
        filtered_residuals(COMMAND_DIFFERENCE, m0=15.0, m1=6.0), "m0", 1,
        RELAX, True, True
    ),
    "N14b": FaultCase(swinging_tension(1, 0.25), swinging_tension(1, 0.25 - 1.5 * PERIOD_S), "t1", 1, RELAX, True,
                      True),
    "N15": FaultCase(lost_frames(m7=0)._replace(state_values={"lost": {(0, 7): 0b1010101010101}}),
                lost_frames(m7=0)._replace(state_values={"lost": {(0, 7): 0b10101010101}}), "m7", 1, WARN, False, True),
    "N16": FaultCase(tension_after_cut(30.0), tension_after_cut(14.9), "t0", 1, CUT, True, True),
    "N17": FaultCase(partial_torque_reports(1, 0.1), partial_torque_reports(1, 0.2), "m1", 1, RELAX, True, True),
    "T01": FaultCase(state_input(measured_tension={3: 0.0}, speed={3: 0.1}),
                     state_input(measured_tension={3: 0.0}, speed={3: 0.03}),
                "t3", 2, RELAX, True, True),
    "T02a": FaultCase(slack_tendon(25), slack_tendon(24), "t3", 1, WARN, False, True),
    "T02b": FaultCase(slack_tendon(250), slack_tendon(249), "t3", 1, RELAX, True, True),
    "T03": FaultCase(measured_tensions(t1=50.1), measured_tensions(t0=139.9, t1=50.0), "t1", 1, RELAX, True),
    "T03b": FaultCase(measured_tensions(t1=60.1), measured_tensions(t0=159.9, t1=60.0), "t1", 1, CUT, True),
    "T03c": FaultCase(merge_inputs(measured_tensions(t1=50.1), TickInput(RELAX_STATE_VALUES)),
                      merge_inputs(measured_tensions(t0=139.9, t1=50.0), TickInput(RELAX_STATE_VALUES)), "t1", 1,
                      CUT, True, True),
    "T04a": FaultCase(filtered_residuals(BALANCE, t0=5.1), filtered_residuals(BALANCE, t1=5.0), "t0", 1, WARN, False,
                      True),
    "T04b": FaultCase(filtered_residuals(BALANCE, t1=10.1), filtered_residuals(BALANCE, t0=10.0), "t1", 1, RELAX, True,
                      True),
    "T05": FaultCase(state_input(cell_value={2: 20.0}, cell_stuck={2: 39}, cell_anchor={(0, 2): 14.0, (1, 2): 20.0}),
                state_input(cell_value={2: 20.0}, cell_stuck={2: 38}, cell_anchor={(0, 2): 14.0, (1, 2): 20.0}),
                "t2", 1, RELAX, True, True),
    "T05b": FaultCase(replayed_readings(2, 16), replayed_readings(2, 7), "t2", 1, RELAX, True, True),
    "T06": FaultCase(measured_tensions(t0=244.0), measured_tensions(t0=243.9, t1=-4.9), "t0", 3, RELAX, True, True),
    "T08": FaultCase(derailed_tendon(4, 15.1), derailed_tendon(4, 14.9), "t4", 1, RELAX, True, True),
    "T09": FaultCase(filtered_residuals(EXCESS_FRICTION, t0=3.1), filtered_residuals(EXCESS_FRICTION, t1=3.0), "t0", 1,
                     WARN, False, True),
    "H01": FaultCase(state_input(late_ns=520_000), state_input(late_ns=500_000), "loop", 1, PASS, False),
    "H02": FaultCase(state_input(missed=1), INPUT_AT_REST, "loop", 1, WARN, False),
    "H03": FaultCase(state_input(missed=5), state_input(missed=4), "loop", 1, RELAX, True, True),
    "H04": FaultCase(event_report("suspended", "host", 900), event_report("recorder", "host"), "host", 1, RELAX, True),
    "H08": FaultCase(event_report("recorder", "disk_full"), event_report("recorder", "misshapen"), "disk_full", 1,
                     WARN, False),
    "H09": FaultCase(event_report("recorder", "dropped"), event_report("dropped", "dropped"), "dropped", 1, WARN,
                     False),
    "H10": FaultCase(event_report("recorder", "gone"), event_report("recorder", "misshapen"), "gone", 1, WARN, False),
    "H13": FaultCase(TickInput(reports=tuple(second_controller_reports(["0x001"]))), INPUT_AT_REST, "0x001", 1, RELAX,
                     True),
    "I07a": FaultCase(state_input(refused_now=1, refused=1), state_input(refused=1), "goal", 1, WARN, False, True),
    "I07b": FaultCase(state_input(refused_now=1, refused=3), state_input(refused_now=1, refused=2), "goal", 1, RELAX,
                      True, True),
    "I11a": FaultCase(open_stream(100_000_001), open_stream(100_000_000), "stream", 1, HOLD, False, True),
    "I11b": FaultCase(open_stream(1_000_000_001), open_stream(1_000_000_000), "stream", 1, RELAX, True, True),
}  # fmt: skip
ALTERNATIVE_INPUTS_BY_FAULT = {
    "B16": [event_report("ebadf")],
    "N04": [stuck_joint(0, 11.0), stuck_motor(5, -0.6e-3)],
    "N05a": [state_input(joint_jump={0: 0.4})],
    "N05b": [state_input(joint_jump={0: 0.4}, joint_dropped={0: 2.0})],
    "N11": [
        drive_error(4, DriveFaultCause.OVERHEATED),
        drive_error(4, DriveFaultCause.COMMUNICATION_LOST),
    ],
    "T06": [
        measured_tensions(t0=-5.0),
        measured_tensions(t0=300.0),
        merge_inputs(measured_tensions(t0=-3.0), state_input(saturated={0: 1})),
        merge_inputs(measured_tensions(t0=9.0), state_input(saturated={0: 1})),
    ],
    "H08": [event_report("recorder", "disk_low")],
    "H09": [event_report("recorder", "filling")],
    "H10": [event_report("recorder", "error")],
}


def monitor_at_rest() -> SyntheticMonitor:
    """Return the safety monitor of a hand at rest.

    The residuals of the hand keep the values that a test has set.
    """
    return SyntheticMonitor(EIGHT_TENDON_LIMITS, residual_fraction=0.0, coulomb=0.0, stiffness=1e5)


def reset_monitor_for_input(monitor: SyntheticMonitor, tick_input: TickInput) -> StateValues:
    """Reset a monitor to a hand at rest.

    Return the state values of ``tick_input``. The caller must pass the returned state values to the
    next call of ``monitor.tick``.
    """
    monitor.reset_to_rest()
    return dict(tick_input.state_values)
