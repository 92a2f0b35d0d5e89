"""Joint angles, and their standard deviations, in digits with fewer tendons than joints.

In a digit with fewer tendons than joints, the excursions of the tendons do not fully determine the
joint angles. A motion in the null space of the moment arms changes no excursion. In a free digit,
the coupling B determines the joint angles q = B theta from the coordinates theta. When a digit
touches an object, the contact turns the joints of the digit against each other. The turn of the
joints is the torque of the contact times a compliance. With the stiffness K of the springs and a
basis N of the null space of the moment arms, the compliance is N (N^T K N)^-1 N^T. The torque of
the contact follows from the part of the tension that the model does not explain. The place of the
contact on the digit is unknown, so the estimate is the mean over several assumed contacts. The
assumed contacts are a force at the middle of each link, a force at the tip, and an equal torque on
all joints. The standard deviation of an angle has several parts:

- the differences between the assumed places of contact,
- the error of the modelled tension, at each assumed place of contact,
- capstan friction, whose sign depends on the direction of motion,
- springs and gravity that do not agree with the coupling of a free digit,
- the error of the excursion.

If the hand has joint encoders, a Kalman update with the full covariance combines the readings of
the encoders with the estimate from the tendons. In a digit with as many tendons as joints, the
excursions fully determine the joint angles.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper, square
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.statics import (
    joint_wrap_angle,
    link_poses_of_hand,
    wrap_angle_before_digit,
    write_static_torque,
    write_tip_levers,
)
from handctl.core.estimation.varying_moment_arms import fit_angles_to_excursions
from handctl.core.state_block import StateTables
from handctl.hand.rigid_body import LINK_LENGTH_ROW, write_levers, write_levers_after_turn

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MODEL_ERROR_N = 0.5
"""Standard deviation of the error of the tension that the model expects in free motion [N].

The expected tension is wrong if friction or springs differ from the hand file.
"""
MODEL_ERROR_FRACTION = 0.15
"""Standard deviation of the error of the expected tension, as a fraction of the unexplained tension."""
STIFFNESS_ERROR_FRACTION = 0.03
"""Relative error of the tendons' stiffness.

Because of the stiffness error, the tension filter mistakes a part of the stretch for excursion.
"""
FRICTION_FRACTION = 0.5
"""Standard deviation of a joint's turn by friction, as a fraction of the turn that fully developed friction causes."""
MIN_SQUARED_LEVER_M2 = 1e-8
"""Smallest sum of squared levers of a place of contact [m^2].

The lower bound prevents a division by 0 for a place of contact without levers.
"""
MAX_READING_AGE_S = 0.1
"""Largest age at which a joint encoder's reading is used [s]."""
RATE_ERROR_FRACTION = 1.0
"""Relative error of the joint rate with which a reading is advanced to the present.

The joint rate is computed for a free digit.
"""
MIN_TURN_RAD = 1e-9
"""Smallest divisor in the computation that limits a turn to the ranges of the joints [rad]."""
CONTACT_DECAY_TIME_S = 0.15
"""Time constant with which the effect of a contact fades [s].

Friction holds the joints for some time after the end of a contact.
"""
POSTURE_UPDATE_PERIOD_S = 8e-3
"""Time between two estimates of the turn of the joints in the null space [s]."""
TURN_SMOOTHING_S = 20e-3
"""Time constant of the low-pass filter for the turn of the joints that a contact causes [s]."""


@kernel_helper
def estimate_joint_angles(x: StateTables, c: ConstantTables, k: int, t_ns: int) -> None:
    """Write the estimated joint angles of a tick, and their standard deviations.

    Args:
        x: state tables, with the angles of free digits in ``Q``.
        c: constants of the hand.
        k: number of the tick.
        t_ns: time of the tick [ns].
    """
    angle_deviations, variance = _excursion_deviations(x, c)
    if not c.run_int[h.HAS_NULL_SPACE]:
        for j in range(x.joint.shape[1]):
            x.joint[s.Q_SIGMA, j] = math.sqrt(variance[j])
        return
    for d in range(x.digit.shape[1]):
        # The contact tension rises at once when the digit touches an object, and later decays with
        # the time constant CONTACT_DECAY_TIME_S.
        x.digit[s.CONTACT_TENSION, d] = max(
            x.digit[s.UNEXPLAINED_TENSION, d],
            x.digit[s.CONTACT_TENSION, d] * c.run[h.CONTACT_DECAY],
        )
    update = k % c.run_int[h.POSTURE_UPDATE_TICKS] == 0
    columns = np.zeros((0, 0))
    if update:
        columns = _covariance_columns(x, c)
    for j in range(x.joint.shape[1]):
        sigma = math.sqrt(square(x.joint[s.CONTACT_TURN_SIGMA, j]) + variance[j])
        x.joint[s.Q, j] += x.joint[s.CONTACT_TURN, j]
        x.joint[s.Q_SIGMA, j] = min(sigma, c.joint[h.ANGLE_RANGE_SIGMA, j])
    if c.run_int[h.HAND_HAS_VARYING_ARM]:
        fit_angles_to_excursions(x, c)
    if update and c.run_int[h.HAS_FUSED_ENCODERS]:
        _fuse_encoders(x, c, columns, angle_deviations, t_ns)


@kernel_helper
def _excursion_deviations(x: StateTables, c: ConstantTables) -> tuple[Matrix, Vector]:
    """Return the angle error that each excursion error causes (J, N) [rad], and the angle variances (J,) [rad^2]."""
    joints = x.joint.shape[1]
    tendons = x.tendon.shape[1]
    angle_deviations = np.zeros((joints, tendons))
    angle_variances = np.zeros(joints)
    for n in range(tendons):
        stretch = square(x.tendon[s.TENSION, n] * STIFFNESS_ERROR_FRACTION) + square(
            x.tendon[s.TENSION_SIGMA, n]
        )
        variance = c.tendon[h.EXCURSION_VARIANCE, n] + stretch / square(
            c.tendon[h.TENDON_STIFFNESS, n]
        )
        if c.run_int[h.HAS_CARRIER_ARMS]:
            # Add the error that the joint angles of carrying digits cause. The tendons of carrying
            # digits come first, so ``angle_variances`` already contains the variances of these
            # angles.
            for j in range(joints):
                variance += square(c.tendon_joint_table[h.CARRIER_ARMS, n, j]) * angle_variances[j]
        excursion = math.sqrt(variance)
        for j in range(joints):
            angle_deviations[j, n] = c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, n] * excursion
            angle_variances[j] += square(angle_deviations[j, n])
    return angle_deviations, angle_variances


@kernel_helper
def _covariance_columns(x: StateTables, c: ConstantTables) -> Matrix:
    """Return the deviations of the joint angles in the null space of the moment arms [rad].

    The function also writes ``CONTACT_TURN``, the estimated rotation of each joint that a contact
    causes [rad], and the standard deviation of this rotation.

    The result has the shape (2 H + 2, J) for H assumed places of contact. A row belongs to one
    source of error, and contains the deviation of each joint angle that this source causes. To get
    the covariance of two joint angles, multiply their deviations in each row, and add the products
    of all rows. The levers of the contact forces are computed at the joint angles of the last
    estimate. Each tick is thus one step of a fixed-point iteration.
    """
    place_count = c.place_joint_table.shape[1]
    joints = x.joint.shape[1]
    columns = np.zeros((2 * place_count + 2, joints))
    turns, deviation = _joint_turns_by_contact(x, c)
    _write_angle_errors_of_free_digits(x, c, columns[2 * place_count :])
    for j in range(joints):
        mean = 0.0
        for place in range(place_count):
            mean += c.place_joint_table[h.CONTACT_PLACE_PROBABILITY, place, j] * turns[place, j]
        turn = x.joint[s.CONTACT_TURN, j] + c.run[h.TURN_SMOOTHING_FRACTION] * (
            mean - x.joint[s.CONTACT_TURN, j]
        )
        x.joint[s.CONTACT_TURN, j] = turn
        for place in range(place_count):
            root_probability = math.sqrt(c.place_joint_table[h.CONTACT_PLACE_PROBABILITY, place, j])
            # The errors are multiplied by the square root of the probability of their place of
            # contact, so that the sum of their squares is the variance over the places.
            columns[place, j] = root_probability * (turns[place, j] - turn)
            columns[place_count + place, j] = root_probability * deviation[place, j]
    for row in range(place_count, 2 * place_count + 2):
        for d in range(x.digit.shape[1]):
            fraction = max(
                _largest_turn_fraction(x, c, d, columns[row], 1.0),
                _largest_turn_fraction(x, c, d, columns[row], -1.0),
            )
            for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
                columns[row, j] *= fraction
    for j in range(joints):
        variance = 0.0
        for row in range(len(columns)):
            variance += square(columns[row, j])
        x.joint[s.CONTACT_TURN_SIGMA, j] = math.sqrt(variance)
    return columns


@kernel_helper
def _joint_turns_by_contact(x: StateTables, c: ConstantTables) -> tuple[Matrix, Matrix]:
    """Return the turns of the joints that a contact at each assumed place causes (H, J), and their deviations [rad]."""
    place_count = c.place_joint_table.shape[1]
    joints = x.joint.shape[1]
    turns = np.zeros((place_count, joints))
    deviation = np.zeros((place_count, joints))
    torque = np.zeros(joints)
    error = np.zeros(joints)
    for j in range(joints):
        for n in range(x.tendon.shape[1]):
            contact_tension = x.digit[s.CONTACT_TENSION, c.tendon_int[h.DIGIT_OF_TENDON, n]]
            tension_error = math.sqrt(
                square(MODEL_ERROR_N) + square(MODEL_ERROR_FRACTION * contact_tension)
            )
            torque[j] += c.joint_tendon_table[h.POSTURE_TORQUE, j, n] * contact_tension
            error[j] += c.joint_tendon_table[h.POSTURE_TORQUE, j, n] * tension_error
    q = np.zeros(joints)
    lever = np.zeros(joints)
    for j in range(joints):
        q[j] = x.joint[s.Q, j] + x.joint[s.CONTACT_TURN, j]
    pose = link_poses_of_hand(c, q)
    for place in range(place_count):
        for d in range(x.digit.shape[1]):
            _write_levers_at_contact_place(c, d, place, pose, lever)
            _write_digit_turn(x, c, d, lever, torque, error, turns[place], deviation[place])
    return turns, deviation


@kernel_helper
def _write_levers_at_contact_place(
    c: ConstantTables, d: int, place_index: int, pose: Matrix, lever: Vector
) -> None:
    """Write the levers (J,) of a contact force about the joints of a digit [m].

    If ``place_index`` i is smaller than the number of links, the contact is at the middle of link
    i. If i equals the number of links, the contact is at the tip. If i exceeds the number of links,
    all levers are 0.
    """
    first_joint = c.digit_int[h.FIRST_JOINT, d]
    end = c.digit_int[h.END_JOINT, d]
    for j in range(first_joint, end):
        lever[j] = 0.0
    touched_link = first_joint + place_index
    if touched_link < end:
        write_levers(
            pose,
            first_joint,
            touched_link,
            0.5 * c.joint[h.LINK_TABLE + LINK_LENGTH_ROW, touched_link],
            lever,
        )
    elif touched_link == end:
        write_tip_levers(c, d, pose, lever)


@kernel_helper
def _write_digit_turn(
    x: StateTables,
    c: ConstantTables,
    d: int,
    lever: Vector,
    torque: Vector,
    error: Vector,
    turns: Vector,
    deviation: Vector,
) -> None:
    """Write how far a contact turns the joints of a digit, for given levers of the contact force.

    Args:
        x: state tables.
        c: constants of the hand.
        d: index of the digit.
        lever: (J,) levers of the contact force about the joints [m].
        torque: (J,) torque of the contact [N m].
        error: (J,) standard deviation of the torque of the contact [N m].
        turns: (J,) result: turn of each joint [rad].
        deviation: (J,) result: standard deviation of each turn [rad].
    """
    first_joint = c.digit_int[h.FIRST_JOINT, d]
    end = c.digit_int[h.END_JOINT, d]
    squared_lever = 0.0
    virtual_work = 0.0
    work_sigma = 0.0
    for j in range(first_joint, end):
        virtual_work += lever[j] * torque[j]
        work_sigma += lever[j] * error[j]
        for other_joint in range(first_joint, end):
            squared_lever += (
                lever[j]
                * c.joint_joint_table[h.COORDINATE_PROJECTION, j, other_joint]
                * lever[other_joint]
            )
    squared_lever = max(squared_lever, MIN_SQUARED_LEVER_M2)
    for j in range(first_joint, end):
        compliance = 0.0
        for other_joint in range(first_joint, end):
            compliance += lever[other_joint] * c.joint_joint_table[h.COMPLIANCE, other_joint, j]
        # Unexplained tension is positive if the object pushes the digit open.
        turns[j] = -virtual_work / squared_lever * compliance
        deviation[j] = work_sigma / squared_lever * compliance
    fraction = _largest_turn_fraction(x, c, d, turns, 1.0)
    for j in range(first_joint, end):
        # the turns of all joints are reduced by the same fraction, so that the excursion does not
        # change
        turns[j] *= fraction


@kernel_helper
def _largest_turn_fraction(
    x: StateTables, c: ConstantTables, d: int, joint_turn: Vector, sign: float
) -> float:
    """Return the largest fraction (0 to 1) of a turn (J,) that keeps all joints within their ranges.

    The turn is added to the joint angles of the free digit.
    """
    fraction = 1.0
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        signed_turn = sign * joint_turn[j]
        q = x.joint[s.Q, j]
        margin = max(
            c.joint[h.MAX_JOINT_ANGLE, j] - q
            if signed_turn > 0.0
            else q - c.joint[h.MIN_JOINT_ANGLE, j],
            0.0,
        )
        fraction = min(fraction, margin / max(abs(signed_turn), MIN_TURN_RAD))
    return fraction


@kernel_helper
def _write_angle_errors_of_free_digits(x: StateTables, c: ConstantTables, turn: Matrix) -> None:
    """Write the turns of the joints of free digits by two causes, (2, J) [rad].

    Row 0 contains the turns by friction, and row 1 contains the turns by springs and gravity.
    """
    joints = x.joint.shape[1]
    torque = np.zeros((2, joints))
    write_static_torque(c, x.joint[s.Q], torque[1])
    for n in range(x.tendon.shape[1]):
        d = c.tendon_int[h.DIGIT_OF_TENDON, n]
        wrap_angle = wrap_angle_before_digit(c, n, x.joint[s.Q])
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            arm = c.tendon_joint_table[h.MOMENT_ARMS, n, j]
            if arm != 0.0:
                wrap_angle += joint_wrap_angle(c, j, x.joint[s.Q, j])
                friction_arm = arm * c.tendon[h.CAPSTAN_COEFFICIENT, n]
                torque[0, j] += (
                    FRICTION_FRACTION * x.tendon[s.TENSION, n] * friction_arm * wrap_angle
                )
    for row in range(2):
        for j in range(joints):
            turn[row, j] = 0.0
            for other_joint in range(joints):
                turn[row, j] += (
                    torque[row, other_joint] * c.joint_joint_table[h.COMPLIANCE, other_joint, j]
                )


@kernel_helper
def _fuse_encoders(
    x: StateTables,
    c: ConstantTables,
    covariance_columns: Matrix,
    angle_deviations: Matrix,
    t_ns: int,
) -> None:
    """Correct the joint angles by the readings of the joint encoders, one encoder after the other.

    The result equals the correction by all encoders at once, because the noises of the encoders are
    independent.

    Args:
        x: state tables.
        c: constants of the hand.
        covariance_columns: (2 H + 2, J) deviations of the angles in the null space [rad], see
            ``_covariance_columns``.
        angle_deviations: (J, N) errors of the angles that the errors of the excursions cause [rad], see
            ``_excursion_deviations``.
        t_ns: present time [ns].

    Source: sequential measurement update of the Kalman filter (Bierman 1977).
    """
    joints = x.joint.shape[1]
    covariance = np.zeros((joints, joints))
    for a in range(joints):
        for b in range(joints):
            for row in range(len(covariance_columns)):
                covariance[a, b] += covariance_columns[row, a] * covariance_columns[row, b]
            for n in range(angle_deviations.shape[1]):
                covariance[a, b] += angle_deviations[a, n] * angle_deviations[b, n]
            covariance[a, b] *= c.joint_joint_table[h.ARE_IN_SAME_DIGIT, a, b]
    has_reading = False
    gain = np.zeros(joints)
    covariance_row = np.zeros(joints)
    for j in range(joints):
        if not c.joint_int[h.IS_ENCODER_FUSED, j]:
            continue
        last_frame_ns = x.group_int[s.GROUP_RECEIVED_NS, c.joint_int[h.JOINT_GROUP, j]]
        age = (t_ns - last_frame_ns) / 1e9
        if last_frame_ns < 0 or age >= MAX_READING_AGE_S:
            continue
        has_reading = True
        change_since_reading = x.joint[s.DQ, j] * age
        noise = c.joint[h.ENCODER_VARIANCE, j] + square(RATE_ERROR_FRACTION * change_since_reading)
        residual = x.joint[s.JOINT_ANGLE, j] + change_since_reading - x.joint[s.Q, j]
        for a in range(joints):
            # A row of the covariance is copied, because the loop below changes the row.
            gain[a] = covariance[a, j] / (covariance[j, j] + noise)
            covariance_row[a] = covariance[j, a]
        for a in range(joints):
            x.joint[s.Q, a] += gain[a] * residual
            for b in range(joints):
                covariance[a, b] -= gain[a] * covariance_row[b]
    if has_reading:
        for j in range(joints):
            if c.joint_int[h.IS_ENCODER_FUSED, j]:
                x.joint[s.Q_SIGMA, j] = math.sqrt(max(covariance[j, j], 0.0))


@kernel_helper
def estimate_tip_forces(x: StateTables, c: ConstantTables) -> None:
    """Estimate the tip-equivalent contact force of each digit, and the standard deviation of this force [N].

    The tip-equivalent force is the force at the tip that would make the torque of the contact. It
    acts along the y axis of the last link. In a digit with several coordinates, the torque of the
    tip-equivalent force fits the torque of the contact in the sense of least squares. From the
    tension of a single tendon, the place of the contact cannot be computed, so the contact is
    assumed at the tip.
    """
    joints = x.joint.shape[1]
    coordinates = x.coordinate.shape[1]
    torque = np.zeros(coordinates)
    lever = np.zeros(coordinates)
    turned_lever = np.zeros(coordinates)
    joint_levers = np.zeros(joints)
    turned_joint_levers = np.zeros(joints)
    q = np.zeros(joints)
    for j in range(joints):
        q[j] = x.joint[s.Q, j]
    for k in range(coordinates):
        for n in range(x.tendon.shape[1]):
            torque[k] += (
                x.tendon[s.EXTERNAL_TENSION, n] * c.tendon_coordinate_table[h.REDUCED_ARMS, n, k]
            )
    pose = link_poses_of_hand(c, q)
    for d in range(x.digit.shape[1]):
        first_joint = c.digit_int[h.FIRST_JOINT, d]
        last_joint = c.digit_int[h.END_JOINT, d] - 1
        length = c.joint[h.LINK_TABLE + LINK_LENGTH_ROW, last_joint]
        write_tip_levers(c, d, pose, joint_levers)
        _reduce_levers(c, d, joint_levers, lever)
        force = _dot_over_coordinates(c, d, lever, torque) / _dot_over_coordinates(
            c, d, lever, lever
        )
        x.digit[s.TIP_FORCE, d] = force
        x.digit[s.TIP_FORCE_SIGMA, d] = 0.0
        for j in range(first_joint, last_joint + 1):
            # The derivative is computed numerically, with a step of one standard deviation of the
            # joint angle.
            for i in range(first_joint, last_joint + 1):
                turned_joint_levers[i] = joint_levers[i]
            write_levers_after_turn(
                pose, first_joint, last_joint, length, j, x.joint[s.Q_SIGMA, j], turned_joint_levers
            )
            _reduce_levers(c, d, turned_joint_levers, turned_lever)
            change = (
                _dot_over_coordinates(c, d, turned_lever, torque)
                / _dot_over_coordinates(c, d, turned_lever, turned_lever)
                - force
            )
            x.digit[s.TIP_FORCE_SIGMA, d] += square(change)
    for n in range(x.tendon.shape[1]):
        d = c.tendon_int[h.DIGIT_OF_TENDON, n]
        error = math.sqrt(
            square(x.tendon[s.TENSION_SIGMA, n])
            + square(MODEL_ERROR_N)
            + square(MODEL_ERROR_FRACTION * x.tendon[s.EXTERNAL_TENSION, n])
        )
        arms = c.tendon_coordinate_table[h.REDUCED_ARMS, n]
        change = (
            _dot_over_coordinates(c, d, lever, arms)
            * error
            / _dot_over_coordinates(c, d, lever, lever)
        )
        x.digit[s.TIP_FORCE_SIGMA, d] += square(change)
    for d in range(x.digit.shape[1]):
        x.digit[s.TIP_FORCE_SIGMA, d] = math.sqrt(x.digit[s.TIP_FORCE_SIGMA, d])


@kernel_helper
def _reduce_levers(c: ConstantTables, d: int, lever: Vector, result: Vector) -> None:
    """Convert the levers (J,) about a digit's joints to levers (C,) about its coordinates [m]."""
    for k in range(c.digit_int[h.FIRST_COORDINATE, d], c.digit_int[h.END_COORDINATE, d]):
        result[k] = 0.0
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            result[k] += c.joint_coordinate_table[h.JOINT_COUPLING, j, k] * lever[j]


@kernel_helper
def _dot_over_coordinates(c: ConstantTables, d: int, vector: Vector, other_vector: Vector) -> float:
    """Return the dot product of two vectors (C,), summed over the coordinates of a digit."""
    total = 0.0
    for k in range(c.digit_int[h.FIRST_COORDINATE, d], c.digit_int[h.END_COORDINATE, d]):
        total += vector[k] * other_vector[k]
    return total
