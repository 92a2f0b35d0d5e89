"""Detection of a tension that oscillates, because of torque ripple or an unstable control loop.

A torque ripple of 0.1 N m near the resonance of motor and tendon, about 20 Hz, makes the tension
oscillate by tens of newtons. The other detectors do not find an oscillation of the tension. Cogging
torque does not appear in the motor current, so the comparison of reported and commanded torque
(fault N14) cannot find the oscillation.
"""

import math

from handctl.compiled import kernel_helper, square
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.state_block import StateTables
from handctl.safety.faults.node import SWING_N

SLOW_PART_TIME_CONSTANT_S = 0.02
"""Time constant of the slow part that is subtracted from the tension error [s].

The time constant belongs to the frequency ``SWING_HZ``.
"""
MEAN_SQUARE_TIME_CONSTANT_S = 0.025
"""Time constant of the mean square of the remaining, fast part [s]."""


@kernel_helper
def update_swing(x: StateTables, c: ConstantTables, tared: bool) -> None:
    """Update for each tendon the mean square of the difference between measured and commanded tension."""
    period = c.run[h.PERIOD]
    slow_fraction = 1.0 - math.exp(-period / SLOW_PART_TIME_CONSTANT_S)
    mean = 1.0 - math.exp(-period / MEAN_SQUARE_TIME_CONSTANT_S)
    for n in range(x.tendon.shape[1]):
        quick = 0.0
        deviation = x.tendon[s.MEASURED_TENSION, n] - x.tendon[s.COMMANDED_TENSION, n]
        if tared and not math.isnan(deviation):
            x.tendon[s.SWING_SLOW, n] += slow_fraction * (deviation - x.tendon[s.SWING_SLOW, n])
            quick = deviation - x.tendon[s.SWING_SLOW, n]
        # A missing reading counts as a difference of 0.
        x.tendon[s.SWING_SQUARE, n] += mean * (quick * quick - x.tendon[s.SWING_SQUARE, n])
        large = x.tendon[s.SWING_SQUARE, n] > square(SWING_N)
        x.tendon[s.SWING_S, n] = x.tendon[s.SWING_S, n] + period if large else 0.0
