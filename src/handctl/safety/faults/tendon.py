"""Rows T01 to T09: faults of tendons and their load cells. Commissioning judges T07."""

from handctl.safety.action import Action, Release
from handctl.safety.faults.fault import ARMING, DETECTED, ITSELF, OPERATOR, REPLACED, TENDON, TICK, fault, row

TAUT_N, SLACK_N = 2.5, 2.0
"""Filtered tension of a taut tendon (above the first), and of a slack tendon (below the second) [N]."""
SNAP_FRACTION, SNAP_N, SNAP_SPEED, SNAP_MEMORY_S = 0.2, 8.0, 0.03, 0.1
"""Thresholds of a snapped tendon: tension fraction, least tension before [N], spool speed [m/s], memory [s].

A tendon has snapped if the tension is less than the fraction of at least ``SNAP_N``, the spool
winds at least at ``SNAP_SPEED``, and the tendon was taut within the last ``SNAP_MEMORY_S``. A
tendon in take-up was not taut before. A tendon without load is still taut.
"""
SLACK_WARN_S, SLACK_TRIP_S = 0.05, 0.5
RELAXED_S = 0.1
"""Time from the start of relaxing until every tendon of an obeying motor is below the trip limit [s]."""
RESIDUAL_WARN_N, RESIDUAL_TRIP_N, FRICTION_WARN_N = 5.0, 10.0, 3.0
CELL_TICKS, CELL_FORCE_N = 40, 5.0
"""Equal counts in a row of a stuck load cell, and motion of the motor's force meanwhile [N].

The noise of a healthy cell is eight counts.
"""
SAME_LEAST, SAME_WINDOW = 8, 16
"""Repeated readings in a row before the test for chance, and number of readings in the estimate of chance."""
SATURATED_TICKS = 3
DERAILED_DEG, DERAILED_READINGS = 15.0, 3
"""Difference of joint and spool, unfiltered, beyond any stretch of a tendon [deg], and consecutive readings."""

_SLACK = f"{REPLACED}: only where there are joint encoders, by three readings; else by slack (T02)"
_ODRIVE = f"{DETECTED}: against the commanded torque"

row("T01", "snap", ticks=10, asked=3,
    why="a torn tendon's spool takes three to seven ticks to run fast enough, and must do so for two")  # fmt: skip
T01 = fault("T01", "a tendon snapped", "no tension where there was some, and the spool runs", Action.RELAX, OPERATOR,
            TENDON, debounce=2)  # fmt: skip

row("T02", "slack", ticks=4, ms=110, asked=12,
    why="50 ms, as asked, behind the cell's filter of 20 ms; slack that comes at once is T01, in 10 ticks")  # fmt: skip
T02A = fault("T02a", "a tendon is slack",
             f"below {SLACK_N:g} N for {SLACK_WARN_S * 1e3:g} ms where tension is commanded", Action.WARN, ITSELF,
             TENDON)  # fmt: skip
T02B = fault("T02b", "a tendon stays slack", f"the same for {SLACK_TRIP_S * 1e3:g} ms", Action.RELAX, OPERATOR, TENDON)

row("T03", "over-tension", ticks=10, asked=2,
    why="2 from the first sample above the limit; 10 from the moment at which a drive runs away")  # fmt: skip
T03 = fault("T03", "over-tension", "one load-cell sample above tension_trip_N", Action.RELAX, OPERATOR, TENDON,
            release=Release.FAST)  # fmt: skip
T03B = fault("T03b", "beyond the drive", "one load-cell sample above drive_limit_N", Action.CUT, OPERATOR, TENDON)
T03C = fault("T03c", "over-tension stays",
             f"still above tension_trip_N, or at the rail, {RELAXED_S * 1e3:g} ms after relaxing began", Action.CUT,
             OPERATOR, TENDON)  # fmt: skip

row("T04", "load cell drifts", odrive=_ODRIVE, ticks=2, ms=500, asked=200,
    why="sooner than the 1000 ms asked; from the first newton on of 60 a second")  # fmt: skip
T04A = fault("T04a", "a load cell drifts", f"{RESIDUAL_WARN_N:g} N that torque, inertia and friction do not explain",
             Action.WARN, ITSELF, TENDON)  # fmt: skip
T04B = fault("T04b", "a load cell is wrong",
             f"{RESIDUAL_TRIP_N:g} N that torque, inertia and friction do not explain", Action.RELAX, OPERATOR, TENDON,
             release=Release.OPEN)  # fmt: skip

row("T05", "load cell stuck", ticks=42, ms=300, asked=42,
    why="42 from the moment at which the torque moves; a grasp at rest shows nothing")  # fmt: skip
T05 = fault("T05", "a load cell is stuck", f"the same count {CELL_TICKS} times while the motor's torque moves",
            Action.RELAX, OPERATOR, TENDON)  # fmt: skip
T05B = fault("T05b", "load-cell readings are old", f"{SAME_LEAST} to {SAME_WINDOW} in a row as so many ticks before",
             Action.RELAX, OPERATOR, TENDON, release=Release.OPEN)  # fmt: skip

row("T06", "load cell saturated", ticks=4, asked=4)
T06 = fault("T06", "load cell saturated", f"a rail, or a broken wire, {SATURATED_TICKS} ticks", Action.RELAX, OPERATOR,
            TENDON, debounce=SATURATED_TICKS, release=Release.FAST)  # fmt: skip

row("T07", "load cells swapped or inverted", ARMING, tried="tests/controller/test_commission.py")

row("T08", "derailed or crossed", TICK, _SLACK, _SLACK, _SLACK, ticks=8, ms=400, asked=4,
    why="three readings of joints that come by turns; below 15 degrees a filter of 300 ms finds it (N06)")  # fmt: skip
T08 = fault("T08", "a tendon left its pulley",
            f"joint and spool differ by more than any stretch, {DERAILED_READINGS} readings", Action.RELAX, OPERATOR,
            TENDON)  # fmt: skip

row("T09", "friction grows", odrive=_ODRIVE, ticks=4, ms=15000, tried="tests/safety/test_residuals.py")
T09 = fault("T09", "friction has grown", f"{FRICTION_WARN_N:g} N above the hand file's, averaged over 5 s of motion",
            Action.WARN, ITSELF, TENDON)  # fmt: skip
