"""Control of tensions that make no joint torque, in digits with more tendons than coordinates.

The matrix R B contains the moment arms of the tendons in the coordinates of the digit. Tensions in
the null space of (R B)^T make no joint torque. The position feedback acts only on the coordinates
of the digit. In the null space, the tensions are kept at their goals by a feedback of the tension
error and of its integral. With the null-space feedback, neither motor friction nor a wrong tendon
length can make a tendon slack.

Source: Abdallah et al. (2010), tension and joint space of tendon-driven fingers.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import MOTION
from handctl.core.estimation.statics import project_onto_digit_motion
from handctl.core.state_block import StateTables

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

INTEGRAL_LIMIT_N = 8.0
"""Limit of the integral of the tension error, against windup [N]."""
MAX_ADDED_BALANCE_TENSION_N = 20.0
"""Largest balance tension, which makes no torque, that is added when the motion feedback unloads a tendon [N].

Friction of the pulleys grows with balance tensions. Larger balance tensions would lock the joints
that the motion feedback has to move.
"""


@kernel_helper
def raise_goals_to_tension_floor(
    x: StateTables, c: ConstantTables, limit: Vector, motion_terms: Matrix, null_space_terms: Matrix
) -> None:
    """Raise tension goals to the floor in digits with more tendons than coordinates, and write null-space forces.

    The position feedback can reduce the force on a tendon to less than the tension floor. A
    multiple of the balance tensions, which make no joint torque, is added to the tension goals of
    all tendons of the digit. The tension limits, and ``MAX_ADDED_BALANCE_TENSION_N``, limit the
    added balance tensions. If the limited balance tensions are too small for the tension floor, the
    position feedback is reduced.

    Args:
        x: state tables.
        c: constants of the hand.
        limit: (N,) largest tensions allowed at present [N].
        motion_terms: (2, N) tension goals and feedback forces of the motion loop [N], modified in place.
        null_space_terms: (2, N) result: forces that the tension errors in the null space cause, and
            integrals of these errors [N].
    """
    count = x.tendon.shape[1]
    error = np.zeros(count)
    error_integral = np.zeros(count)
    feedback = np.zeros(count)
    for d in range(x.digit.shape[1]):
        first_tendon = c.digit_int[h.FIRST_TENDON, d]
        end = c.digit_int[h.END_TENDON, d]
        if (
            not c.tendon_int[h.IS_REDUNDANT_DIGIT, first_tendon]
            or x.tendon_int[s.GOAL_KIND, first_tendon] != MOTION
        ):
            continue
        for n in range(first_tendon, end):
            # Only the part of the feedback that moves the digit is allowed to raise tension goals.
            # The part of the feedback in the null space damps the motion of the motors.
            feedback[n] = project_onto_digit_motion(c, n, motion_terms[1])
        bound = _max_balance_factor(c, first_tendon, end, limit, motion_terms)
        fraction = _max_feedback_fraction(c, first_tendon, end, bound, motion_terms, feedback)
        balance_factor = 0.0
        for n in range(first_tendon, end):
            motion_terms[1, n] -= (1.0 - fraction) * feedback[n]
            missing_tension = (
                c.tendon[h.TENSION_FLOOR, n] - motion_terms[0, n] - fraction * feedback[n]
            )
            balance_factor = max(balance_factor, missing_tension / c.tendon[h.BALANCE_TENSION, n])
        balance_factor = min(balance_factor, bound)
        for n in range(first_tendon, end):
            motion_terms[0, n] += balance_factor * c.tendon[h.BALANCE_TENSION, n]
            error[n] = motion_terms[0, n] - x.tendon[s.TENSION, n]
            error_integral[n] = x.tendon[s.TENSION_INTEGRAL, n] + c.run[h.INTEGRAL_GAIN] * error[n]
        for n in range(first_tendon, end):
            null_space_terms[0, n] = c.tendon[h.TENSION_GAIN, n] * (
                error[n] - project_onto_digit_motion(c, n, error)
            )
            integral = error_integral[n] - project_onto_digit_motion(c, n, error_integral)
            null_space_terms[1, n] = min(max(integral, -INTEGRAL_LIMIT_N), INTEGRAL_LIMIT_N)


@kernel_helper
def _max_balance_factor(
    c: ConstantTables, first_tendon: int, end: int, limit: Vector, motion_terms: Matrix
) -> float:
    """Return the largest multiple of the balance tensions that a digit's tension limits allow."""
    factor = math.inf
    for n in range(first_tendon, end):
        tension_margin = min(c.tendon[h.TENSION_CEILING, n], limit[n]) - motion_terms[0, n]
        factor = min(
            factor,
            min(max(tension_margin, 0.0), MAX_ADDED_BALANCE_TENSION_N)
            / c.tendon[h.BALANCE_TENSION, n],
        )
    return factor


@kernel_helper
def _max_feedback_fraction(
    c: ConstantTables,
    first_tendon: int,
    end: int,
    bound: float,
    motion_terms: Matrix,
    feedback: Vector,
) -> float:
    """Return the largest fraction of the feedback with which no tendon of a digit is below the tension floor.

    Args:
        c: constants of the hand.
        first_tendon: index of the digit's first tendon.
        end: index after the digit's last tendon.
        bound: largest allowed multiple of the balance tensions.
        motion_terms: (2, N) tension goals and feedback forces of the motion loop [N].
        feedback: (N,) part of the feedback forces that moves the digit [N].
    """
    fraction = 1.0
    for n in range(first_tendon, end):
        margin_above_floor = (
            motion_terms[0, n]
            + bound * c.tendon[h.BALANCE_TENSION, n]
            - c.tendon[h.TENSION_FLOOR, n]
        )
        if feedback[n] < -max(margin_above_floor, 0.0):
            fraction = min(fraction, max(margin_above_floor, 0.0) / -feedback[n])
    return fraction
