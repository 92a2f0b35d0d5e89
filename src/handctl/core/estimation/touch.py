"""Touch that nobody has planned: a digit that is on a stop, or has met something on its way.

A closing digit is judged by ``programs.contact``, finely; here it takes a force at the tip that no error of the model
makes. The filter must know: it takes a free digit to follow its tendon, and a loop on that belief rings against a
blocked one.
"""

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables

SMOOTH_S = 20e-3
"""Time constant of the tension that is judged."""
BLOCKED_N, FREED_N = 6.0, 3.0
"""Unexplained tension, the mean of a digit's tendons, from which on it is blocked, and below which it is free again:
fast free motion with friction wrong by a half comes to 3.6 N. It is not taken as a force at the tip, since a digit that
is curled up on its stops has no lever there."""
PRESS_N = 30.0
"""A digit that is blocked on its way pulls at most so much more than the way asks: the loop that holds it there is
stiff enough to wind the tendon up to where safety must act."""


@inner
def feel(x: Tables, c: ConstantTables) -> None:
    """Take in what one more tick tells of each digit."""
    for d in range(x.digit.shape[1]):
        first, end = c.digit_int[h.TENDONS_FIRST, d], c.digit_int[h.TENDONS_END, d]
        mean = 0.0
        for n in range(first, end):
            mean += x.tendon[s.EXTERNAL, n] / (end - first)
        kept = c.run[h.TOUCH_KEPT]
        x.digit[s.TOUCH, d] = kept * x.digit[s.TOUCH, d] + (1.0 - kept) * mean
        limit = FREED_N if x.digit_int[s.BLOCKED, d] else BLOCKED_N
        blocked = x.digit[s.TOUCH, d] > limit
        if blocked != x.digit_int[s.BLOCKED, d]:
            x.run_int[s.CHANGED] = 1
        x.digit_int[s.BLOCKED, d] = blocked


@inner
def forget(x: Tables) -> None:
    """Begin anew: no torque acts, so that nothing can be felt."""
    for d in range(x.digit.shape[1]):
        x.digit[s.TOUCH, d] = 0.0
        if x.digit_int[s.BLOCKED, d]:
            x.run_int[s.CHANGED] = 1
        x.digit_int[s.BLOCKED, d] = 0
