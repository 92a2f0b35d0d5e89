"""Slip of a tendon.

The spool encoder and the joint encoders both measure the position of the tendon. The slip of a
tendon is the change of the difference between both measured positions (spool and joints) since the
tendon became taut.
"""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.measurements import monitored_tension
from handctl.core.state_block import StateTables
from handctl.safety.faults.tendon import (
    DERAILED_TENDON_DEG,
    DERAILED_TENDON_WITHOUT_CELL_DEG,
    SLACK_TENSION_N,
    TAUT_TENSION_N,
)

MIN_TAUT_DURATION_S = 0.1
"""Time for which a tendon must be taut before the start value for its slip is measured [s]."""
DEG_PER_RAD = 180.0 / math.pi


@kernel_helper
def update_tendon_slip(x: StateTables, c: ConstantTables, are_cells_tared: bool) -> None:
    """Update the slip of each tendon.

    Args:
        x: state tables.
        c: constants of the hand.
        are_cells_tared: True if the zeros of the load cells are known.
    """
    has_joint_reading = x.run_int[s.HAS_ANY_JOINT_READING] == 1
    for n in range(x.tendon.shape[1]):
        tension = monitored_tension(x, c, n, are_cells_tared)
        if c.tendon_int[h.IS_SPOOL_PAIR, n]:
            # At least one tendon of a spool pair is always taut.
            x.tendon[s.TAUT_TIME_S, n] += c.run[h.CONTROL_PERIOD]
        elif tension < SLACK_TENSION_N or _is_tautness_unknown(x, c, n):
            x.tendon[s.TAUT_TIME_S, n] = 0.0
        elif tension > TAUT_TENSION_N:
            x.tendon[s.TAUT_TIME_S, n] += c.run[h.CONTROL_PERIOD]
        stretch = tension / c.tendon[h.TENDON_STIFFNESS, n]
        length_difference = (
            x.tendon[s.MEASURED_TRAVEL, n] - stretch - x.tendon[s.MEASURED_EXCURSION, n]
        )
        if has_joint_reading and math.isnan(x.tendon[s.SLIP_REFERENCE, n]):
            x.tendon[s.SLIP_REFERENCE, n] = length_difference
        if x.tendon[s.TAUT_TIME_S, n] <= MIN_TAUT_DURATION_S:
            x.tendon[s.SLIP_REFERENCE, n] = math.nan
        x.tendon[s.TENDON_SLIP, n] = math.nan
        if has_joint_reading:
            x.tendon[s.TENDON_SLIP, n] = (
                (length_difference - x.tendon[s.SLIP_REFERENCE, n])
                / c.tendon[h.MOMENT_ARM_SUM, n]
                * DEG_PER_RAD
            )
            is_derailed = abs(x.tendon[s.TENDON_SLIP, n]) > derailment_threshold(c, n)
            x.tendon[s.DERAILED_READING_COUNT, n] = (
                x.tendon[s.DERAILED_READING_COUNT, n] + 1.0 if is_derailed else 0.0
            )


@kernel_helper
def _is_tautness_unknown(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True for a tendon that has no load cell and no commanded torque.

    After a cut of its torque, a motor turns freely, and its tendon becomes slack. Without a load
    cell, the friction of a motor at rest looks like tension.
    """
    return c.tendon_int[h.CELL_GROUP, n] < 0 and math.isnan(x.tendon[s.COMMANDED_TENSION, n])


@kernel_helper
def derailment_threshold(c: ConstantTables, n: int) -> float:
    """Return the slip above which a tendon counts as derailed [deg]."""
    return (
        DERAILED_TENDON_WITHOUT_CELL_DEG
        if c.tendon_int[h.CELL_GROUP, n] < 0
        else DERAILED_TENDON_DEG
    )
