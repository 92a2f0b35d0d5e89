"""Statics of a hand: torques of springs and gravity, and tensions after the friction of pulleys."""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core.constants import ConstantTables
from handctl.core.estimation.spool_pair import net_tension_at_joint
from handctl.hand import rigid_body

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MAX_CAPSTAN_EXPONENT = 700.0
"""Largest exponent of the capstan equation, just below the overflow of a float number.

If an exponent exceeds the limit, Python raises an error, but compiled code does not.
"""


@kernel_helper
def link_poses_of_hand(c: ConstantTables, q: Vector) -> Matrix:
    """Return the poses of all links at joint angles q (J,) [rad], as (J, POSE_COLUMN_COUNT).

    The rows of the result do not contain the masses that the links carry.
    """
    pose = np.empty((len(q), rigid_body.POSE_COLUMN_COUNT))
    rigid_body.write_link_poses(c.joint, h.LINK_TABLE, c.joint_int[h.PARENT_JOINT], q, pose)
    return pose


MAX_DIAGONAL_ELEMENT = 0.999
"""Diagonal element of R R^+ above which a tendon's value does not follow from the other tendons of its digit."""


@kernel_helper
def write_static_torque(c: ConstantTables, q: Vector, torque: Vector) -> None:
    """Write the joint torques (J,) [N m] that balance gravity and springs at joint angles q (J,) [rad].

    The weight of a link acts on the joint of the link and on all joints between the link and the
    palm.
    """
    gravity = c.run[h.GRAVITY : h.GRAVITY + 3]
    rigid_body.write_weight_torques(
        c.joint,
        h.LINK_TABLE,
        c.joint_int[h.PARENT_JOINT],
        gravity,
        link_poses_of_hand(c, q),
        torque,
    )
    for j in range(len(q)):
        torque[j] += c.joint[h.SPRING_STIFFNESS, j] * (q[j] + c.joint[h.SPRING_PRELOAD, j])


@kernel_helper
def joint_wrap_angle(c: ConstantTables, j: int, q: float) -> float:
    """Return the wrap angle that joint j adds to a tendon when the joint is at position q [rad].

    The wrap angle is 0 for a prismatic joint.
    """
    return 0.0 if c.joint[h.LINK_TABLE + rigid_body.IS_PRISMATIC_ROW, j] != 0.0 else q


@kernel_helper
def capstan_ratio(c: ConstantTables, n: int, friction_state: float, wrap_angle: float) -> float:
    """Return the tension of tendon n after a wrap angle, divided by its tension at the load cell.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        friction_state: 1 at full friction while the tendon is wound up, -1 at full friction while it is
            paid out.
        wrap_angle: wrap angle of the tendon [rad].

    Source: capstan equation.
    """
    exponent = -c.tendon[h.CAPSTAN_COEFFICIENT, n] * friction_state * wrap_angle
    return math.exp(MAX_CAPSTAN_EXPONENT if exponent > MAX_CAPSTAN_EXPONENT else exponent)


@kernel_helper
def pulley_torque(
    c: ConstantTables,
    n: int,
    moment_arm: float,
    tension: float,
    friction_state: float,
    wrap_angle: float,
) -> float:
    """Return the torque of tendon n about the joint of a pulley, with the effect of friction [N m].

    Args:
        c: constants of the hand.
        n: index of the tendon.
        moment_arm: moment arm of the tendon about the joint [m].
        tension: tension at the load cell, or the net tension of a spool pair [N].
        friction_state: friction state of the tendon, from 1 while it is wound to -1 while it is
            paid out.
        wrap_angle: wrap angle of the tendon up to and including the pulley [rad].
    """
    transmitted_ratio = capstan_ratio(c, n, friction_state, wrap_angle)
    if c.tendon_int[h.IS_SPOOL_PAIR, n]:
        return moment_arm * net_tension_at_joint(
            tension, c.tendon[h.PRETENSION, n], transmitted_ratio
        )
    return moment_arm * tension * transmitted_ratio


@kernel_helper
def subtract_torque_of_passing_tendons(
    c: ConstantTables, q: Vector, tension: Vector, friction_state: Vector, torque: Vector
) -> None:
    """Subtract from the joint torques (J,) the torques of tendons that cross a joint of a carrying digit.

    A passing tendon crosses a joint of another digit, which carries the tendon's own digit. For
    example, the tendons of a finger cross the wrist.

    Args:
        c: constants of the hand.
        q: (J,) joint angles [rad].
        tension: (N,) tensions at the load cells [N].
        friction_state: (N,) 1 at full friction while a tendon is wound up, -1 at full friction while it is
            paid out.
        torque: (J,) joint torques, modified in place [N m].
    """
    if not c.run_int[h.HAS_CARRIER_ARMS]:
        return
    for n in range(len(tension)):
        wrap_angle = c.tendon[h.WRAP_ANGLE, n]
        for j in range(len(q)):
            arm = c.tendon_joint_table[h.CARRIER_ARMS, n, j]
            if arm != 0.0:
                wrap_angle += joint_wrap_angle(c, j, q[j])
                torque[j] -= pulley_torque(c, n, arm, tension[n], friction_state[n], wrap_angle)


@kernel_helper
def wrap_angle_before_digit(c: ConstantTables, n: int, q: Vector) -> float:
    """Return the wrap angle of tendon n on all pulleys before the pulleys of its own digit [rad].

    Args:
        c: constants of the hand.
        n: index of the tendon.
        q: (J,) joint angles [rad].
    """
    wrap_angle = c.tendon[h.WRAP_ANGLE, n]
    if c.run_int[h.HAS_CARRIER_ARMS]:
        for j in range(len(q)):
            if c.tendon_joint_table[h.CARRIER_ARMS, n, j] != 0.0:
                wrap_angle += joint_wrap_angle(c, j, q[j])
    return wrap_angle


@kernel_helper
def write_tip_levers(c: ConstantTables, d: int, pose: Matrix, lever: Vector) -> None:
    """Write the levers (J,) of a force at a digit's tip about the digit's joints [m].

    The function ``rigid_body.write_levers`` defines the levers.
    """
    last_joint = c.digit_int[h.END_JOINT, d] - 1
    rigid_body.write_levers(
        pose,
        c.digit_int[h.FIRST_JOINT, d],
        last_joint,
        c.joint[h.LINK_TABLE + rigid_body.LINK_LENGTH_ROW, last_joint],
        lever,
    )


@kernel_helper
def write_tensions_for_torque(c: ConstantTables, torque: Vector, tension: Vector) -> None:
    """Write the smallest tensions (N,) [N] that make the given joint torques (J,) [N m]."""
    for n in range(len(tension)):
        d = c.tendon_int[h.DIGIT_OF_TENDON, n]
        tension[n] = 0.0
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            tension[n] += c.tendon_joint_table[h.TORQUE_TO_TENSION, n, j] * torque[j]


@kernel_helper
def write_tensions_at_joints(
    c: ConstantTables, q: Vector, tension: Vector, friction_state: Vector, result: Vector
) -> None:
    """Write the tensions at the joints, with the effect of friction.

    Friction changes the joint torques that the tensions at the load cells make. The tensions at the
    joints are defined as the tensions that would make the changed joint torques without friction.

    Args:
        c: constants of the hand.
        q: (J,) joint angles [rad].
        tension: (N,) tensions at the load cells [N].
        friction_state: (N,) 1 at full friction while a tendon is wound up, -1 at full friction while it is
            paid out.
        result: (N,) tensions at the joints [N].

    Source: capstan equation.
    """
    torque = np.zeros(len(q))
    for n in range(len(tension)):
        d = c.tendon_int[h.DIGIT_OF_TENDON, n]
        wrap_angle = wrap_angle_before_digit(c, n, q)
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            arm = c.tendon_joint_table[h.MOMENT_ARMS, n, j]
            if arm != 0.0:
                wrap_angle += joint_wrap_angle(c, j, q[j])
                torque[j] += pulley_torque(c, n, arm, tension[n], friction_state[n], wrap_angle)
    write_tensions_for_torque(c, torque, result)


@kernel_helper
def project_onto_digit_motion(c: ConstantTables, n: int, tendon_values: Vector) -> float:
    """Return the part of tendon n's value (for example its excursion) that a motion of the digit can cause.

    With the moment arms R of the digit and the values v of all its tendons, the result is element n
    of R R^+ v.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        tendon_values: (N,) values v, one for each tendon, for example excursions or tensions. If the
            values are excursions, the caller must add ``EXCURSION_MODEL_OFFSET`` to the result.
    """
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    total = 0.0
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        angle = 0.0
        for other_tendon in range(c.digit_int[h.FIRST_TENDON, d], c.digit_int[h.END_TENDON, d]):
            angle += (
                c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, other_tendon]
                * tendon_values[other_tendon]
            )
        total += c.tendon_joint_table[h.MOMENT_ARMS, n, j] * angle
    return total


@kernel_helper
def value_from_other_tendons(
    c: ConstantTables, n: int, tendon_values: Vector, offset: float
) -> float:
    """Compute a value of tendon n, such as its excursion, from the values of the other tendons of its digit.

    Return NaN if the other tendons do not determine the value.

    The values of all tendons of a digit are R q, with the moment arms R and the angles or rates q
    of the joints. In a digit with more tendons than coordinates, the other tendons determine q, and
    q determines the value of tendon n.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        tendon_values: (N,) values, one for each tendon, for example excursions [m].
        offset: ``EXCURSION_MODEL_OFFSET`` if the values are excursions, 0 if they are rates of
            excursions.
    """
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    own_term = 0.0
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        own_term += (
            c.tendon_joint_table[h.MOMENT_ARMS, n, j]
            * c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, n]
        )
    if own_term > MAX_DIAGONAL_ELEMENT:
        return math.nan
    return (
        project_onto_digit_motion(c, n, tendon_values) + offset - own_term * tendon_values[n]
    ) / (1.0 - own_term)


@kernel_helper
def winding_efficiency(c: ConstantTables, n: int, q: Vector) -> float:
    """Return the fraction of the load-cell tension that reaches the joints while the tendon is wound up.

    The result is a mean over the pulleys of the tendon, weighted by the moment arms. While the
    tendon is paid out, the tension at the joints divided by the load-cell tension is about the
    reciprocal of the result.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        q: (J,) joint angles [rad].
    """
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    wrap_angle = wrap_angle_before_digit(c, n, q)
    efficiency = 0.0
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        if c.tendon_joint_table[h.MOMENT_ARMS, n, j] != 0.0:
            wrap_angle += joint_wrap_angle(c, j, q[j])
            efficiency += c.tendon_joint_table[h.PULLEY_WEIGHTS, n, j] * capstan_ratio(
                c, n, 1.0, wrap_angle
            )
    return efficiency
