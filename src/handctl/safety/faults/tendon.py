"""Rows T01 to T09 of the fault catalogue: faults of tendons and their load cells.

Commissioning checks the row T07.
"""

from handctl.safety.faults.fault import (
    CHECKED_BEFORE_ARMING,
    CHECKED_BY_FAULT_TABLE,
    CLEARED_BY_ITSELF,
    CLEARED_BY_OPERATOR,
    FAULT_PLACE_TENDON,
    INDIRECTLY_VISIBLE,
    VISIBLE_FAULT,
    declare_catalogue_row,
    declare_fault,
)
from handctl.safety.safety_action import RelaxMethod, SafetyAction

TAUT_TENSION_N = 2.5
SLACK_TENSION_N = 2.0
"""Filtered tension above which a tendon counts as taut, and below which it counts as slack [N]."""
SNAP_TENSION_FRACTION = 0.2
SNAP_MIN_COMMAND_N = 8.0
SNAP_SPOOL_SPEED_M_PER_S = 0.03
SNAP_SPOOL_SPEED_WITHOUT_CELL = 0.06
TAUT_BEFORE_SNAP_TIME_S = 0.1
"""Thresholds for a snapped tendon: tension fraction, commanded tension [N], spool speeds [m/s], memory [s].

A tendon counts as snapped if more than ``SNAP_MIN_COMMAND_N`` is commanded and its tension is below
``SNAP_TENSION_FRACTION`` of the command, while the spool winds faster than
``SNAP_SPOOL_SPEED_M_PER_S``. A tendon counts as snapped only if it was taut within the last
``TAUT_BEFORE_SNAP_TIME_S``. Therefore a slack tendon does not count as snapped while the spool
takes up the slack. The second spool speed is for tendons without load cell. Of 60 random streams to
``orca_like``, 6 ended with a false T01 at 0.03 m/s, and none at 0.06 m/s. With joint encoders, the
fault T08 reports a torn tendon without load cell sooner.
"""
FREE_SPOOL_SPEED_FRACTION = 0.6
MIN_SNAP_SPOOL_SPEED = 0.01
"""Lower speed threshold of a tension loop: fraction of the speed of a free spool, and smallest threshold [m/s].

The tension loop damps its spool, so the speed of a torn tendon's spool approaches a final speed.
The final speed is proportional to the commanded tension, and can be below
``SNAP_SPOOL_SPEED_M_PER_S``.
"""
SLACK_WARN_S = 0.05
SLACK_TRIP_S = 0.5
"""Durations of slack that are faults [s].

The reaction is WARN above the first duration of slack, and RELAX above the second duration.
"""
RELAXING_TIME_S = 0.1
"""Time after the start of relaxing in which the tension falls below its trip limit if the motor obeys [s]."""
RESIDUAL_WARN_N = 5.0
RESIDUAL_TRIP_N = 10.0
"""Unexplained tensions that are faults [N].

The reaction is WARN above the first unexplained tension, and RELAX above the second.
"""
EXCESS_TENSION_TRIP_N = 20.0
"""Tension in excess of the tension that the motor explains, filtered with 20 ms, that is a fault [N].

The reaction is RELAX. If the power stages of two drives are exchanged, the tension loops of the two
tendons drive each other. With exchanged power stages, the excess tension rises from 10 to 80 N in
30 ms. Without a fault, and with three times the usual noise, the excess tension stays below 3 N.

A tension that is too small is judged only by ``RESIDUAL_TRIP_N``. The judgement by
``RESIDUAL_TRIP_N`` is slower. If a drive switches itself off, the drive therefore has time to
report its own error.
"""
EXCESS_FRICTION_WARN_N = 3.0
"""Friction in excess of the friction in the hand file above which there is a fault [N]."""
STUCK_CELL_READINGS = 40
STUCK_CELL_FORCE_RANGE_N = 5.0
FORCE_RANGE_ERROR_N = 0.5
"""Thresholds for a stuck load cell: equal readings in a row, and range of the motor force meanwhile [N].

``FORCE_RANGE_ERROR_N`` is the largest error of the range because of noise in the torque report [N].

Until the motor force has varied, a stuck load cell is not visible, because its reading is still
right. The friction c of a motor at rest balances a variation of the motor force by 2 c (6 N on
``jamia``) while the tension stays the same. A variation of the motor force by less than 2 c is no
proof that a load cell with little noise is stuck. The noise of a healthy load cell is eight counts
in simulation, and can be below one count on hardware.
"""
MIN_REPEATED_READINGS = 8
REPEAT_WINDOW = 16
"""Two numbers of readings: successive repeated readings that can be a fault, and readings to estimate chance."""
SATURATED_CELL_TICKS = 3
"""Number of consecutive ticks with a saturated load cell after which there is a fault."""
DERAILED_TENDON_DEG = 15.0
DERAILED_TENDON_WITHOUT_CELL_DEG = 10.0
DERAILED_READING_COUNT = 3
"""Thresholds for a derailed tendon: joint minus spool angle that no stretch explains [deg], and readings in a row.

The second threshold is for a tendon without load cell, because no other fault reports soon that a
tendon without load cell has torn. Without a fault, three readings in a row of ``orca_like``
differed by 2.8 degrees with three times the usual noise, and by 5.1 degrees with a stiffness that
was 30 % too low.
"""

_SLACK_TEXT = (
    f"{INDIRECTLY_VISIBLE}: only with joint encoders, by three readings, else by slack (T02)"
)
_TORQUE_COMPARISON_TEXT = f"{VISIBLE_FAULT}: by comparison with the commanded torque"

declare_catalogue_row("T01", "snap", ticks=10, required_ticks=3,
    why="the spool of a torn tendon reaches the speed limit in three to seven ticks, and must exceed it for two ticks",
)  # fmt: skip
T01_SNAPPED_TENDON = declare_fault(
    "T01", "a tendon snapped", "The tension of a tendon has disappeared, and its spool winds fast",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON, debounce_ticks=2,
    cause="The tendon has torn, or its clamp has opened.",
    remedy="Inspect the tendon and its clamp, replace them, then commission the hand (handctl commission).",
)  # fmt: skip

declare_catalogue_row("T02", "slack", ticks=4, ms=110, required_ticks=12,
    why="the required 50 ms begin after a filter of 20 ms. Sudden slack is found by T01 in 10 ticks")  # fmt: skip
T02A_SLACK_TENDON = declare_fault(
    "T02a", "a tendon is slack",
    f"The tension is below {SLACK_TENSION_N:g} N for {SLACK_WARN_S * 1e3:g} ms, although a tension is commanded",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_TENDON,
    cause="The digit moves faster than the motor winds, or the tendon has left its spool.",
    remedy="Ignore single cases in fast motion. If it repeats, inspect the tendon.",
)  # fmt: skip
T02B_LASTING_SLACK = declare_fault(
    "T02b", "a tendon stays slack",
    f"The tension is below {SLACK_TENSION_N:g} N for {SLACK_TRIP_S * 1e3:g} ms, although a tension is commanded",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON,
    cause="The tendon has torn, left its spool, or its load cell reads too little.",
    remedy="Inspect tendon, clamp and load cell, then commission the hand (handctl commission).",
)  # fmt: skip

declare_catalogue_row("T03", "over-tension", ticks=10, required_ticks=2,
    why="2 ticks from the first sample above the limit, 10 ticks from the start of a drive's failure")  # fmt: skip
T03_OVER_TENSION = declare_fault(
    "T03", "over-tension", "A load-cell reading is above tension_trip_N",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON, relax_method=RelaxMethod.FAST_TENSION_LOOP,
    cause="The digit is blocked or pulled from outside, or the tension command is too high.",
    remedy="Free the digit, check the task's tensions, then start a new run.",
)  # fmt: skip
T03B_TENSION_ABOVE_DRIVE_LIMIT = declare_fault(
    "T03b", "tension above the drive's limit", "A load-cell reading is above drive_limit_N",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON,
    needs_load_cell=True,
    cause="The drive makes more torque than its limit allows, or something else pulls the tendon.",
    remedy="Check the torque limit in the drive's own settings before the hand is powered again.",
)  # fmt: skip
T03C_TENSION_AFTER_RELAXING = declare_fault(
    "T03c", "over-tension remains after relaxing",
    f"{RELAXING_TIME_S * 1e3:g} ms after relaxing began, the tension is above tension_trip_N or the load cell is "
    "saturated",
    SafetyAction.CUT, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON,
    cause="The drive does not obey, or the digit is pulled from outside.",
    remedy="Remove the motor power, free the digit, and check the drive before the next run.",
)  # fmt: skip

declare_catalogue_row("T04", "load cell drifts", odrive=_TORQUE_COMPARISON_TEXT, ticks=2, ms=500, required_ticks=200,
    why="sooner than the required 1000 ms, for a drift of 60 N/s from its first newton")  # fmt: skip
T04A_DRIFTING_LOAD_CELL = declare_fault(
    "T04a", "a load cell drifts", f"Torque, inertia and friction do not explain {RESIDUAL_WARN_N:g} N of the tension",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_TENDON,
    needs_load_cell=True,
    cause="The load cell drifts, or the friction or the torque constant differs from the hand file.",
    remedy="Commission the hand again (handctl commission). If it repeats, identify the hand (handctl identify).",
)  # fmt: skip
T04B_WRONG_LOAD_CELL = declare_fault(
    "T04b", "a load cell is wrong",
    f"Torque, inertia and friction do not explain {RESIDUAL_TRIP_N:g} N of the tension, "
    f"or the tension is {EXCESS_TENSION_TRIP_N:g} N too large over 20 ms",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON, relax_method=RelaxMethod.OPEN_LOOP,
    makes_tension_unreliable=True, needs_load_cell=True,
    cause="The load cell or its amplifier has failed, the motor's torque constant is wrong, "
    "or the cables of two motors are exchanged.",
    remedy="Check the load cell with a known weight with handctl bus watch, then commission (handctl commission).",
)  # fmt: skip

declare_catalogue_row("T05", "load cell stuck", ticks=42, required_ticks=42,
    reaction_time_start=f"the motor force has varied by {STUCK_CELL_FORCE_RANGE_N + FORCE_RANGE_ERROR_N:g} N",
)  # fmt: skip
T05_STUCK_LOAD_CELL = declare_fault(
    "T05", "a load cell is stuck",
    f"{STUCK_CELL_READINGS} readings of a load cell are equal, although the torque of the motor changes",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON,
    makes_tension_unreliable=True, needs_load_cell=True,
    cause="The load cell's amplifier or the sensor node repeats one value.",
    remedy="Restart the sensor node, and check the amplifier of this load cell.",
)  # fmt: skip
T05B_OLD_LOAD_CELL_READINGS = declare_fault(
    "T05b", "load-cell readings are old",
    f"{MIN_REPEATED_READINGS} to {REPEAT_WINDOW} readings in a row repeat readings from some ticks before",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON, relax_method=RelaxMethod.OPEN_LOOP,
    makes_tension_unreliable=True, needs_load_cell=True,
    cause="The sensor node or a gateway sends stored readings under new counters.",
    remedy="Restart the sensor node, and check its firmware for a queue of readings.",
)  # fmt: skip

declare_catalogue_row("T06", "load cell saturated", ticks=4, required_ticks=4)
T06_SATURATED_LOAD_CELL = declare_fault(
    "T06", "a load cell is saturated",
    f"For {SATURATED_CELL_TICKS} ticks, the reading is at the end of the range, or shows a broken wire",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON, debounce_ticks=SATURATED_CELL_TICKS,
    relax_method=RelaxMethod.FAST_TENSION_LOOP,
    makes_tension_unreliable=True, needs_load_cell=True,
    cause="A wire is broken, the load cell is unplugged, or the tension is beyond its range.",
    remedy="Check wire and plug of the load cell with handctl bus watch, then commission (handctl commission).",
)  # fmt: skip

declare_catalogue_row(
    "T07",
    "load cells swapped or inverted",
    CHECKED_BEFORE_ARMING,
    tested_by="tests/controller/test_commission.py",
)

declare_catalogue_row("T08", "derailed or crossed", CHECKED_BY_FAULT_TABLE, _SLACK_TEXT, _SLACK_TEXT,
    _SLACK_TEXT, ticks=8, ms=400, required_ticks=4,
    why="three readings are necessary, and joints are read in turn. Below 15 degrees N06 finds the fault in 300 ms",
)  # fmt: skip
T08_TENDON_OFF_PULLEY = declare_fault(
    "T08", "a tendon left its pulley",
    f"In {DERAILED_READING_COUNT} readings, joint and spool differ by more than a tendon can stretch",
    SafetyAction.RELAX, CLEARED_BY_OPERATOR, FAULT_PLACE_TENDON,
    needs_joint_encoders=True,
    cause="The tendon has derailed or crossed another one, or a tendon without load cell has torn.",
    remedy="Put the tendon back on its pulleys, then commission the hand (handctl commission).",
)  # fmt: skip

declare_catalogue_row(
    "T09",
    "friction grows",
    odrive=_TORQUE_COMPARISON_TEXT,
    ticks=4,
    ms=15000,
    tested_by="tests/safety/test_tension_residuals.py",
)
T09_GROWN_FRICTION = declare_fault(
    "T09", "friction has grown",
    f"Over 5 s of motion, the mean friction is {EXCESS_FRICTION_WARN_N:g} N above that of the hand file",
    SafetyAction.WARN, CLEARED_BY_ITSELF, FAULT_PLACE_TENDON,
    needs_load_cell=True,
    cause="The tendon sheath or the pulleys are worn or dirty.",
    remedy="Clean or replace sheath and pulleys, or identify the hand again (handctl identify).",
)  # fmt: skip
