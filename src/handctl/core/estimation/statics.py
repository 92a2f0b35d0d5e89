"""Known forces along the tendons: requirement of springs and gravity, and tension after friction."""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner
from handctl.core import constants as h
from handctl.core.constants import ConstantTables
from handctl.core.estimation.spool_pair import net_tension_at_joint
from handctl.hand import rigid_body

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@inner
def link_poses_of_hand(c: ConstantTables, q: Vector) -> Matrix:
    """Return the poses (J, rigid_body.POSE) of all links at joint angles q (J,) [rad], without carried masses."""
    pose = np.empty((len(q), rigid_body.POSE))
    rigid_body.write_link_poses(c.joint, h.LINK, c.joint_int[h.PARENT], q, pose)
    return pose


MAX_OWN_FRACTION = 0.999
"""Largest fraction of a tendon's value that only the tendon itself tells. Above, no other tendon tells it."""


@inner
def write_static_torque(c: ConstantTables, q: Vector, torque: Vector) -> None:
    """Write the joint torques of gravity and springs, (J,) [N m], at joint angles q (J,) [rad].

    A link's weight acts on the link's joint and on all joints towards the palm.
    """
    gravity = c.run[h.GRAVITY : h.GRAVITY + 3]
    rigid_body.write_weight_torques(c.joint, h.LINK, c.joint_int[h.PARENT], gravity, link_poses_of_hand(c, q), torque)
    for j in range(len(q)):
        torque[j] += c.joint[h.SPRING, j] * (q[j] + c.joint[h.PRELOAD, j])


@inner
def pulley_torque(c: ConstantTables, n: int, arm: float, tension: float, developed: float, wrapped: float) -> float:
    """Return the torque of tendon n at the joint of a pulley, friction subtracted [N m].

    Args:
        c: constants of the hand.
        n: index of the tendon.
        arm: moment arm about the joint [m].
        tension: at the load cell, net for a spool pair [N].
        developed: development of friction, 1 winding, -1 paying out.
        wrapped: wrap angle up to the pulley [rad].

    Source: capstan equation.
    """
    passed = math.exp(-c.tendon[h.CAPSTAN, n] * developed * wrapped)
    if c.tendon_int[h.PAIR, n]:
        return arm * net_tension_at_joint(tension, c.tendon[h.PRETENSION, n], passed)
    return arm * tension * passed


@inner
def subtract_passing_torque(c: ConstantTables, q: Vector, tension: Vector, developed: Vector, torque: Vector) -> None:
    """Subtract the torques of passing tendons from the joint torques (J,) that the carriers' own tendons must make.

    Args:
        c: constants of the hand.
        q: (J,) joint angles [rad].
        tension: (N,) at the load cells [N].
        developed: (N,) development of friction, 1 winding, -1 paying out.
        torque: (J,) modified in place [N m].
    """
    if not c.run_int[h.HAND_PASSED]:
        return
    for n in range(len(tension)):
        wrapped = c.tendon[h.WRAP, n]
        for j in range(len(q)):
            arm = c.tendon_joint[h.CARRIER_ARMS, n, j]
            if arm != 0.0:
                wrapped += q[j]
                torque[j] -= pulley_torque(c, n, arm, tension[n], developed[n], wrapped)


@inner
def first_wrap(c: ConstantTables, n: int, q: Vector) -> float:
    """Return the wrap angle of tendon n before the joints of its digit [rad].

    Args:
        c: constants of the hand.
        n: index of the tendon.
        q: (J,) joint angles [rad].
    """
    wrapped = c.tendon[h.WRAP, n]
    if c.run_int[h.HAND_PASSED]:
        for j in range(len(q)):
            if c.tendon_joint[h.CARRIER_ARMS, n, j] != 0.0:
                wrapped += q[j]
    return wrapped


@inner
def write_tip_levers(c: ConstantTables, d: int, pose: Matrix, lever: Vector) -> None:
    """Write the levers (J,) [m] of a force at a digit's tip about its joints, see ``rigid_body.write_levers``."""
    last = c.digit_int[h.JOINTS_END, d] - 1
    rigid_body.write_levers(
        pose, c.digit_int[h.JOINTS_FIRST, d], last, c.joint[h.LINK + rigid_body.LENGTH, last], lever
    )


@inner
def write_tensions_for_torque(c: ConstantTables, torque: Vector, tension: Vector) -> None:
    """Write the smallest tensions (N,) [N] for joint torques (J,) [N m]."""
    for n in range(len(tension)):
        d = c.tendon_int[h.DIGIT, n]
        tension[n] = 0.0
        for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
            tension[n] += c.tendon_joint[h.TORQUE_TO_TENSION, n, j] * torque[j]


@inner
def write_tensions_at_joints(c: ConstantTables, q: Vector, tension: Vector, developed: Vector, result: Vector) -> None:
    """Write the tensions at the joints, friction subtracted, with the torques of tensions at the load cells.

    Args:
        c: constants of the hand.
        q: (J,) joint angles [rad].
        tension: (N,) at the load cells [N].
        developed: (N,) development of friction, 1 winding, -1 paying out.
        result: (N,) tensions at the joints [N].

    Source: capstan equation.
    """
    torque = np.zeros(len(q))
    for n in range(len(tension)):
        d = c.tendon_int[h.DIGIT, n]
        wrapped = first_wrap(c, n, q)
        for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
            arm = c.tendon_joint[h.MOMENT_ARMS, n, j]
            if arm != 0.0:
                wrapped += q[j]
                torque[j] += pulley_torque(c, n, arm, tension[n], developed[n], wrapped)
    write_tensions_for_torque(c, torque, result)


@inner
def part_explained_by_motion(c: ConstantTables, n: int, values: Vector) -> float:
    """Return the part of tendon n's value that a motion of the digit explains: element n of R R^+ v.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        values: (N,) values along all tendons. Excursions with varying moment arms have an offset.
    """
    d = c.tendon_int[h.DIGIT, n]
    total = 0.0
    for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
        angle = 0.0
        for other in range(c.digit_int[h.TENDONS_FIRST, d], c.digit_int[h.TENDONS_END, d]):
            angle += c.joint_tendon[h.EXCURSION_TO_JOINTS, j, other] * values[other]
        total += c.tendon_joint[h.MOMENT_ARMS, n, j] * angle
    return total


@inner
def value_from_other_tendons(c: ConstantTables, n: int, values: Vector, offset: float) -> float:
    """Return the value of tendon n that follows from the other tendons of the digit, NaN if none follows.

    The values of a digit are R q. The equation for one tendon is solved with the values of the
    others, which are enough in a digit with more tendons than coordinates.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        values: (N,) values along all tendons, for example excursions [m].
        offset: value of the tendon beyond R q: ``EXPLAINED_OFFSET`` for excursions, 0 for their rates.
    """
    d = c.tendon_int[h.DIGIT, n]
    own = 0.0
    for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
        own += c.tendon_joint[h.MOMENT_ARMS, n, j] * c.joint_tendon[h.EXCURSION_TO_JOINTS, j, n]
    if own > MAX_OWN_FRACTION:
        return math.nan
    return (part_explained_by_motion(c, n, values) + offset - own * values[n]) / (1.0 - own)


@inner
def winding_efficiency(c: ConstantTables, n: int, q: Vector) -> float:
    """Return the fraction of a tendon's load-cell tension at the joints while winding.

    The mean over the pulleys, weighted by moment arms. The fraction while paying out is about the
    reciprocal.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        q: (J,) joint angles [rad].
    """
    d = c.tendon_int[h.DIGIT, n]
    wrapped = first_wrap(c, n, q)
    efficiency = 0.0
    for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
        if c.tendon_joint[h.MOMENT_ARMS, n, j] != 0.0:
            wrapped += q[j]
            efficiency += c.tendon_joint[h.PULLEY_WEIGHT, n, j] * math.exp(-c.tendon[h.CAPSTAN, n] * wrapped)
    return efficiency
