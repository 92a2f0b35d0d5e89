"""Detection of an oscillating tension.

Torque ripple or an unstable control loop can make the tension oscillate. The resonance of motor and
tendon is at about 20 Hz. Near the resonance, a torque ripple of 0.1 N m makes the tension oscillate
by tens of newtons. The other detectors do not find an oscillation of the tension. Cogging torque
does not appear in the motor current, so the comparison of reported and commanded torque (fault N14)
cannot find an oscillation that is caused by cogging.
"""

import math

from handctl.compiled import kernel_helper, square
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.state_block import StateTables
from handctl.safety.faults.node import OSCILLATION_RMS_N

SLOW_DEVIATION_TIME_CONSTANT_S = 0.02
"""Time constant of the slow part that is subtracted from the tension error [s].

The time constant corresponds to the frequency ``MIN_OSCILLATION_HZ``.
"""
MEAN_SQUARE_TIME_CONSTANT_S = 0.025
"""Time constant of the mean square of the tension error's fast part [s]."""


@kernel_helper
def update_tension_swing(x: StateTables, c: ConstantTables, are_cells_tared: bool) -> None:
    """Update the mean square of the fast part of the tension error, for each tendon."""
    period = c.run[h.CONTROL_PERIOD]
    slow_sample_weight = 1.0 - math.exp(-period / SLOW_DEVIATION_TIME_CONSTANT_S)
    mean_square_sample_weight = 1.0 - math.exp(-period / MEAN_SQUARE_TIME_CONSTANT_S)
    for n in range(x.tendon.shape[1]):
        fast_deviation = 0.0
        deviation = x.tendon[s.MEASURED_TENSION, n] - x.tendon[s.COMMANDED_TENSION, n]
        if are_cells_tared and not math.isnan(deviation):
            x.tendon[s.SLOW_TENSION_DEVIATION, n] += slow_sample_weight * (
                deviation - x.tendon[s.SLOW_TENSION_DEVIATION, n]
            )
            fast_deviation = deviation - x.tendon[s.SLOW_TENSION_DEVIATION, n]
        # A missing reading counts as a tension error of 0.
        x.tendon[s.MEAN_SQUARE_TENSION_SWING, n] += mean_square_sample_weight * (
            fast_deviation * fast_deviation - x.tendon[s.MEAN_SQUARE_TENSION_SWING, n]
        )
        is_oscillating = x.tendon[s.MEAN_SQUARE_TENSION_SWING, n] > square(OSCILLATION_RMS_N)
        x.tendon[s.SWING_DURATION, n] = (
            x.tendon[s.SWING_DURATION, n] + period if is_oscillating else 0.0
        )
