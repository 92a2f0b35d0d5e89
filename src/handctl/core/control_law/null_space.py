"""Tension control in the null space of (R B)^T, for digits with surplus tendons.

Tensions in this null space make no joint torque. Position feedback acts only on the coordinates of
the digit. In the null space, a tension feedback with an integral keeps the tensions at their goals.
So neither motor friction nor an error of tendon length makes a tendon slack. Source: Abdallah et
al. (2010), tension and joint space of tendon-driven fingers.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import MOTION
from handctl.core.estimation.statics import part_explained_by_motion
from handctl.core.state_block import StateTables

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

INTEGRAL_LIMIT_N = 8.0
"""Limit of the integral of the tension error, against windup [N]."""
MAX_ADDED_BALANCE_N = 20.0
"""Largest balance tension, which makes no torque, that is added when the motion feedback unloads a tendon [N].

Friction of the pulleys grows with balance tensions. Larger ones would lock the joints that the
feedback has to move.
"""


@kernel_helper
def raise_tensions_to_floor(
    x: StateTables, c: ConstantTables, limit: Vector, terms: Matrix, internal: Matrix
) -> None:
    """Raise the tension goals of surplus tendons in moving digits above the floor, and write the null-space forces.

    The feedback of the motion may reduce the force on a tendon to less than the tension floor. In
    this case, a multiple of the balance tensions is added to the goals of all tendons of the digit.
    Balance tensions make no joint torque. If the feedback would need more than the allowed
    multiple, it is reduced.

    Args:
        x: state tables.
        c: constants of the hand.
        limit: (N,) present tension limits [N].
        terms: (2, N) tension goal and feedback of motion [N], modified in place.
        internal: (2, N) result: force that the tension error in the null space causes, and the
            integral of this error [N].
    """
    count = x.tendon.shape[1]
    error = np.zeros(count)
    total = np.zeros(count)
    feedback = np.zeros(count)
    for d in range(x.digit.shape[1]):
        first = c.digit_int[h.TENDONS_FIRST, d]
        end = c.digit_int[h.TENDONS_END, d]
        if not c.tendon_int[h.HAS_SURPLUS, first] or x.tendon_int[s.GOAL_KIND, first] != MOTION:
            continue
        for n in range(first, end):
            # Only the part of the feedback that moves the digit may raise tension goals. The other
            # part, in the null space, damps the rotors.
            feedback[n] = part_explained_by_motion(c, n, terms[1])
        bound = _largest_balance_factor(c, first, end, limit, terms)
        fraction = _fraction_of_feedback(c, first, end, bound, terms, feedback)
        more = 0.0
        for n in range(first, end):
            terms[1, n] -= (1.0 - fraction) * feedback[n]
            lacking = c.tendon[h.TENSION_FLOOR, n] - terms[0, n] - fraction * feedback[n]
            more = max(more, lacking / c.tendon[h.BALANCE_TENSION, n])
        more = min(more, bound)
        for n in range(first, end):
            terms[0, n] += more * c.tendon[h.BALANCE_TENSION, n]
            error[n] = terms[0, n] - x.tendon[s.TENSION, n]
            total[n] = x.tendon[s.TENSION_INTEGRAL, n] + c.run[h.INTEGRAL_GAIN] * error[n]
        for n in range(first, end):
            internal[0, n] = c.tendon[h.TENSION_GAIN, n] * (
                error[n] - part_explained_by_motion(c, n, error)
            )
            integral = total[n] - part_explained_by_motion(c, n, total)
            internal[1, n] = min(max(integral, -INTEGRAL_LIMIT_N), INTEGRAL_LIMIT_N)


@kernel_helper
def _largest_balance_factor(
    c: ConstantTables, first: int, end: int, limit: Vector, terms: Matrix
) -> float:
    """Return the largest factor of the balance tensions with which all tendons of a digit stay within their limits."""
    factor = math.inf
    for n in range(first, end):
        room = min(c.tendon[h.TENSION_CEILING, n], limit[n]) - terms[0, n]
        factor = min(
            factor, min(max(room, 0.0), MAX_ADDED_BALANCE_N) / c.tendon[h.BALANCE_TENSION, n]
        )
    return factor


@kernel_helper
def _fraction_of_feedback(
    c: ConstantTables, first: int, end: int, bound: float, terms: Matrix, feedback: Vector
) -> float:
    """Return the fraction of the feedback with which all tendons of a digit stay at or above the tension floor.

    Args:
        c: constants of the hand.
        first, end: tendons of the digit.
        bound: largest factor of the balance tensions.
        terms: (2, N) tension goal and feedback of motion [N].
        feedback: (N,) part of the feedback that moves the digit [N].
    """
    fraction = 1.0
    for n in range(first, end):
        above = terms[0, n] + bound * c.tendon[h.BALANCE_TENSION, n] - c.tendon[h.TENSION_FLOOR, n]
        if feedback[n] < -max(above, 0.0):
            fraction = min(fraction, max(above, 0.0) / -feedback[n])
    return fraction
