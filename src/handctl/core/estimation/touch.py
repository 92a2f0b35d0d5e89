"""Detection of blocked digits: an unplanned contact with a stop or an object.

``programs.grasp`` judges a closing digit finely. The test here needs a tension beyond any error
of the model. The filter depends on the result: it assumes a free digit to follow the tendon, and a
loop with this assumption oscillates against a blocked digit.
"""

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables

SMOOTH_S = 20e-3
"""Time constant of the judged tension [s]."""
FREE_BELOW_N = 3.0
"""Unexplained tension, the mean of a digit's tendons, below which the digit is free again [N]."""
BLOCKED_ABOVE_N = 6.0
"""Unexplained tension, the mean of a digit's tendons, from which the digit is blocked [N].

A tension of a tendon that opens the digit counts with the other sign.

Fast free motion with friction wrong by a half reaches 3.6 N. The tension is not converted to a
force at the tip, because a digit curled up on the stops has no lever.
"""
MAX_PRESS_N = 30.0
"""Largest pull of a blocked digit beyond the trajectory's requirement [N].

The loop at a blocked digit is stiff enough to wind the tendon up to the limits of safety.
"""


@inner
def update_blocked(x: Tables, c: ConstantTables) -> None:
    """Update the blocked state of each digit."""
    for d in range(x.digit.shape[1]):
        first = c.digit_int[h.TENDONS_FIRST, d]
        end = c.digit_int[h.TENDONS_END, d]
        mean = 0.0
        margin = 0.0
        for n in range(first, end):
            margin += c.tendon[h.BLIND, n] / (end - first)
            mean += c.tendon[h.SIDE, n] * x.tendon[s.EXTERNAL, n] / (end - first)
        retained = c.run[h.TOUCH_DECAY]
        x.digit[s.TOUCH, d] = retained * x.digit[s.TOUCH, d] + (1.0 - retained) * mean
        limit = FREE_BELOW_N if x.digit_int[s.BLOCKED, d] else BLOCKED_ABOVE_N + margin
        blocked = x.digit[s.TOUCH, d] > limit
        if blocked != x.digit_int[s.BLOCKED, d]:
            x.run_int[s.CHANGED] = 1
        x.digit_int[s.BLOCKED, d] = blocked


@inner
def reset_blocked(x: Tables) -> None:
    """Reset the blocked states: without torque no contact is observable."""
    for d in range(x.digit.shape[1]):
        x.digit[s.TOUCH, d] = 0.0
        if x.digit_int[s.BLOCKED, d]:
            x.run_int[s.CHANGED] = 1
        x.digit_int[s.BLOCKED, d] = 0
