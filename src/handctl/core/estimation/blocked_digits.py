"""Detection of blocked digits.

A blocked digit is in an unplanned contact with a stop or an object. A digit counts as blocked if
its unexplained tension is larger than any error of the model. For closing digits,
``programs.task_program`` has a finer test for a contact. The tension filter must know which digits
are blocked, because it assumes that a free digit follows its tendon. If the tension filter assumed
that a blocked digit follows its tendon, the control loop would oscillate.
"""

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.state_block import StateTables

TOUCH_TIME_CONSTANT_S = 20e-3
"""Time constant of the low-pass filter for the unexplained tension of a digit [s]."""
MAX_UNBLOCKED_TENSION_N = 3.0
"""Mean unexplained tension of a digit's tendons below which the digit counts as free again [N]."""
MIN_BLOCKED_TENSION_N = 6.0
"""Mean unexplained tension of a digit's tendons above which the digit counts as blocked [N].

In the mean of a digit's tensions, the tension of a tendon that opens the digit has the opposite
sign.

In fast free motion, with friction that differs from the model by 50 %, the mean unexplained tension
reaches 3.6 N. The unexplained tension is not converted to a force at the tip, because a force at
the tip of a fully flexed digit has no lever about its joints.
"""
MAX_BLOCKED_EXTRA_TENSION_N = 30.0
"""Largest tension of a blocked digit in excess of the tension that the trajectory requires [N].

Without the limit on the extra tension, the motion loop would raise the tension of a blocked digit
up to the safety limits.
"""


@kernel_helper
def update_blocked_digits(x: StateTables, c: ConstantTables) -> None:
    """Update the flag ``IS_BLOCKED`` of each digit."""
    for d in range(x.digit.shape[1]):
        first_tendon = c.digit_int[h.FIRST_TENDON, d]
        end = c.digit_int[h.END_TENDON, d]
        mean = 0.0
        margin = 0.0
        for n in range(first_tendon, end):
            margin += c.tendon[h.MARGIN_WITHOUT_CELL, n] / (end - first_tendon)
            mean += (
                c.tendon[h.CLOSING_SIGN, n] * x.tendon[s.EXTERNAL_TENSION, n] / (end - first_tendon)
            )
        retained_fraction = c.run[h.TOUCH_DECAY]
        x.digit[s.UNEXPLAINED_TENSION, d] = (
            retained_fraction * x.digit[s.UNEXPLAINED_TENSION, d] + (1.0 - retained_fraction) * mean
        )
        limit = (
            MAX_UNBLOCKED_TENSION_N
            if x.digit_int[s.IS_BLOCKED, d]
            else MIN_BLOCKED_TENSION_N + margin
        )
        is_blocked = x.digit[s.UNEXPLAINED_TENSION, d] > limit
        if is_blocked != x.digit_int[s.IS_BLOCKED, d]:
            x.run_int[s.CONSISTENCY_CHANGED] = 1
        x.digit_int[s.IS_BLOCKED, d] = is_blocked


@kernel_helper
def reset_blocked_digits(x: StateTables) -> None:
    """Mark all digits as not blocked, because a contact cannot be observed without motor torque."""
    for d in range(x.digit.shape[1]):
        x.digit[s.UNEXPLAINED_TENSION, d] = 0.0
        if x.digit_int[s.IS_BLOCKED, d]:
            x.run_int[s.CONSISTENCY_CHANGED] = 1
        x.digit_int[s.IS_BLOCKED, d] = 0
