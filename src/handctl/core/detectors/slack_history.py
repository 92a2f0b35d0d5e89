"""Tension history of a tendon.

The tension history contains the time since the tendon was taut, the duration of slack, and the
tensions at and after a cut of the torque.
"""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.detectors.residuals import TENSION
from handctl.core.state_block import StateTables
from handctl.safety.faults.tendon import SLACK_TENSION_N, TAUT_TENSION_N

MIN_READING_DELAY_AFTER_CUT_S = 0.08
"""Time after a cut of the torque from which each new reading is stored as the tension after the cut [s]."""


@kernel_helper
def update_slack_history(x: StateTables, c: ConstantTables) -> None:
    """Update the tension history while the motors are allowed to make torque.

    For a spool pair, a tension in the direction of the commanded tension is positive.
    """
    x.run_int[s.TICKS_SINCE_CUT] = -1
    for n in range(x.tendon.shape[1]):
        tension = x.tendon[s.RESIDUAL + TENSION, n]
        commanded_tension = x.tendon[s.COMMANDED_TENSION, n]
        is_pair = c.tendon_int[h.IS_SPOOL_PAIR, n] == 1
        if is_pair and commanded_tension < 0.0:
            tension = -tension
            commanded_tension = -commanded_tension
        # If no tension is commanded, the history of a tendon is cleared, so that the tendon does
        # not count as torn.
        if math.isnan(commanded_tension):
            x.tendon_int[s.TICKS_SINCE_TAUT, n] = -1
            x.tendon_int[s.SLACK_TICKS, n] = 0
        elif tension > TAUT_TENSION_N:
            x.tendon_int[s.TICKS_SINCE_TAUT, n] = 0
            x.tendon_int[s.SLACK_TICKS, n] = 0
        elif x.tendon_int[s.TICKS_SINCE_TAUT, n] >= 0:
            x.tendon_int[s.TICKS_SINCE_TAUT, n] += 1
            # Both tendons of a spool pair are taut if the net tension is below twice the
            # pretension. No tendon of a spool pair counts as slack while the commanded net tension
            # is below twice the pretension.
            is_slack = tension < SLACK_TENSION_N and commanded_tension > max(
                TAUT_TENSION_N, 2.0 * c.tendon[h.PRETENSION, n]
            )
            x.tendon_int[s.SLACK_TICKS, n] = x.tendon_int[s.SLACK_TICKS, n] + 1 if is_slack else 0
        is_taut = tension > TAUT_TENSION_N or (
            x.tendon_int[s.IS_TAUT, n] == 1 and tension > SLACK_TENSION_N
        )
        # At least one tendon of a spool pair is always taut.
        x.tendon_int[s.IS_TAUT, n] = is_taut or is_pair


@kernel_helper
def update_history_after_cut(x: StateTables, c: ConstantTables, are_cells_tared: bool) -> None:
    """Update the tension history after the motor torque was cut.

    The tension at the cut is the load-cell reading of the tick in which the torque is cut. In a
    tick in which a cut of the torque is necessary, the load-cell reading is often missing. Instead
    of a missing load-cell reading, the last reading before the cut of the torque is used. If there
    is no load-cell reading before the cut of the torque, the first reading after the cut is used.

    Args:
        x: state tables.
        c: constants of the hand.
        are_cells_tared: True if the zeros of the load cells are known.
    """
    ticks = x.run_int[s.TICKS_SINCE_CUT] + 1
    for n in range(x.tendon.shape[1]):
        tension = x.tendon[s.MEASURED_TENSION, n] if are_cells_tared else math.nan
        if ticks == 0:
            x.tendon[s.POSITION_AT_CUT, n] = x.tendon[s.POSITION, n]
            x.tendon[s.TENSION_AT_CUT, n] = (
                x.tendon[s.STUCK_TEST_TENSION, n] if math.isnan(tension) else tension
            )
        elif math.isnan(x.tendon[s.TENSION_AT_CUT, n]):
            x.tendon[s.TENSION_AT_CUT, n] = tension
        if ticks * c.run[h.CONTROL_PERIOD] < MIN_READING_DELAY_AFTER_CUT_S:
            x.tendon[s.TENSION_AFTER_CUT, n] = math.nan
        elif not math.isnan(tension):
            x.tendon[s.TENSION_AFTER_CUT, n] = tension
    x.run_int[s.TICKS_SINCE_CUT] = ticks
