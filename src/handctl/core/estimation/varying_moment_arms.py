"""Moment arms that depend on the joint angles.

The tables with moment arms are computed for the present joint angles. Filter, control law and
allocation use the linear relation q = B (R B)^+ s between joint angles q and excursions s. R are
the moment arms, and B is the coupling of the joints. For a digit with varying moment arms, the
module ``constants`` has tables that depend on R. The tables that depend on R are evaluated at the
angles q0 = B theta. At q0, a free digit has the modelled excursions e(q0) = s.

Near q0 the excursion is e(q0) + R (q - q0), so the linear relation has an offset. If all moment
arms of a digit are constant, the offset of the linear relation is 0, and the tables with moment
arms keep their values. The tables with moment arms depend only on the state block, and are
evaluated before each use in a tick. A second computation of a tick from a stored state gives the
same result, because the tables depend only on the state.

The tendons of a finger pass the wrist that carries the finger. If a tendon does not pass through
the axis of the wrist, a motion of the wrist moves the tendon, and the tension of the tendon turns
the wrist. The motion of the tendon and the torque on the wrist are computed from the estimated
angle of the wrist and from the tension. The travel of a tendon has a part that the wrist causes.
``carrier_excursion`` computes the part of the travel that the wrist causes. After this part is
subtracted, the filter, the goals and the detectors treat the finger as if its base were at rest.
The tendons of the wrist must balance the torque of the tendons that pass the wrist
(``statics.subtract_torque_of_passing_tendons``).

Source: Tsai, Robot Analysis (1999), structure matrix; Gauss-Newton method.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.statics import project_onto_digit_motion
from handctl.core.state_block import StateTables
from handctl.hand.file.quantity_types import POLYNOMIAL_COEFFICIENTS

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

NEWTON_STEPS = 8
"""Largest number of Newton steps for a digit's joint angles in a tick.

Usually, one or two Newton steps are enough.
"""
NEWTON_TOLERANCE_RAD = 1e-6
"""Newton step below which the iteration ends [rad].

After the iteration, the error of the joint angles is of the order of the squared last step.
"""
MIN_SPRING_STIFFNESS = 1e-3
"""Smallest spring stiffness used in the null space [N m/rad].

With softer springs, the ranges of the joints limit the turn by a contact.
"""
REGULARISATION_FRACTION = 1e-9
"""Regularisation of R K^-1 R^T for dependent rows of R, as a fraction of the mean diagonal element."""
MIN_BALANCE_FRACTION = 0.05
"""Smallest balance tension of a tendon, as a fraction of its balance tension with mean moment arms."""


@kernel_helper
def moment_arm(c: ConstantTables, n: int, j: int, q: float) -> float:
    """Return the moment arm of tendon n about joint j, when this joint is at the angle q [m]."""
    if not c.tendon_int[h.HAS_VARYING_ARM, n]:
        return c.tendon_joint_table[h.MOMENT_ARMS, n, j]
    clamped_angle = min(max(q, c.joint[h.MIN_JOINT_ANGLE, j]), c.joint[h.MAX_JOINT_ANGLE, j])
    value = 0.0
    for order in range(POLYNOMIAL_COEFFICIENTS - 1, -1, -1):
        value = value * clamped_angle + c.tendon_joint_table[h.ARM_POLYNOMIAL + order, n, j]
    return value


@kernel_helper
def joint_excursion(c: ConstantTables, n: int, j: int, q: float) -> float:
    """Return the part of tendon n's excursion that joint j causes [m].

    The part of the excursion that joint j causes is the integral of the moment arm over the joint
    angle.
    """
    if not c.tendon_int[h.HAS_VARYING_ARM, n]:
        return c.tendon_joint_table[h.MOMENT_ARMS, n, j] * q
    clamped_angle = min(max(q, c.joint[h.MIN_JOINT_ANGLE, j]), c.joint[h.MAX_JOINT_ANGLE, j])
    value = 0.0
    for order in range(POLYNOMIAL_COEFFICIENTS - 1, -1, -1):
        value = value * clamped_angle + c.tendon_joint_table[h.ARM_POLYNOMIAL + order, n, j] / (
            order + 1.0
        )
    return value * clamped_angle + moment_arm(c, n, j, clamped_angle) * (q - clamped_angle)


@kernel_helper
def carrier_excursion(c: ConstantTables, n: int, values: Vector) -> float:
    """Return the part of tendon n's excursion [m] or excursion rate [m/s] that the carrying digits cause.

    Args:
        c: constants of the hand.
        n: index of the tendon.
        values: (J,) angles [rad] or rates [rad/s] of the joints. An unknown value (NaN) counts as
            0.
    """
    total = 0.0
    for j in range(len(values)):
        arm = c.tendon_joint_table[h.CARRIER_ARMS, n, j]
        if arm != 0.0 and not math.isnan(values[j]):
            total += arm * values[j]
    return total


@kernel_helper
def motor_speed(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the speed of a tendon at its spool [m/s], including the part that the motion of carrying digits causes."""
    speed = x.tendon[s.SPOOL_SPEED, n]
    if c.run_int[h.HAS_CARRIER_ARMS]:
        speed += carrier_excursion(c, n, x.joint[s.DQ])
    return speed


@kernel_helper
def moment_arm_slope(c: ConstantTables, n: int, j: int, q: float) -> float:
    """Return the derivative of tendon n's moment arm with respect to the angle of joint j [m/rad]."""
    if (
        not c.tendon_int[h.HAS_VARYING_ARM, n]
        or q < c.joint[h.MIN_JOINT_ANGLE, j]
        or q > c.joint[h.MAX_JOINT_ANGLE, j]
    ):
        return 0.0
    value = 0.0
    for order in range(POLYNOMIAL_COEFFICIENTS - 1, 0, -1):
        value = value * q + c.tendon_joint_table[h.ARM_POLYNOMIAL + order, n, j] * order
    return value


@kernel_helper
def update_moment_arm_tables(x: StateTables, c: ConstantTables) -> None:
    """Compute the tables of all digits with varying moment arms, for the joint angles of the free digits."""
    q = np.empty(x.joint.shape[1])
    for d in range(x.digit.shape[1]):
        if not c.digit_int[h.DIGIT_HAS_VARYING_ARM, d]:
            continue
        first_joint = c.digit_int[h.FIRST_JOINT, d]
        end = c.digit_int[h.END_JOINT, d]
        for j in range(first_joint, end):
            q[j] = c.joint[h.MIN_JOINT_ANGLE, j] if math.isnan(x.joint[s.Q, j]) else x.joint[s.Q, j]
        for _ in range(NEWTON_STEPS):
            _write_moment_arm_tables(c, d, q)
            change = 0.0
            for j in range(first_joint, end):
                angle = c.joint[h.ANGLE_OFFSET, j]
                for n in range(c.digit_int[h.FIRST_TENDON, d], c.digit_int[h.END_TENDON, d]):
                    angle += (
                        c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, n] * x.tendon[s.EXCURSION, n]
                    )
                change = max(change, abs(angle - q[j]))
                q[j] = angle
            if change < NEWTON_TOLERANCE_RAD:
                break
        _write_weights(c, d)
        if c.joint_joint_table[h.COMPLIANCE, first_joint, first_joint] > 0.0:
            _write_compliance(c, d)


@kernel_helper
def fit_angles_to_excursions(x: StateTables, c: ConstantTables) -> None:
    """Correct the joint angles of digits with varying moment arms, so that they fit the estimated excursions."""
    for d in range(x.digit.shape[1]):
        if not c.digit_int[h.DIGIT_HAS_VARYING_ARM, d]:
            continue
        first_tendon = c.digit_int[h.FIRST_TENDON, d]
        excursion_errors = np.empty(c.digit_int[h.END_TENDON, d] - first_tendon)
        for i in range(len(excursion_errors)):
            excursion_errors[i] = x.tendon[s.EXCURSION, first_tendon + i]
            for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
                excursion_errors[i] -= joint_excursion(c, first_tendon + i, j, x.joint[s.Q, j])
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            for i in range(len(excursion_errors)):
                x.joint[s.Q, j] += (
                    c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, first_tendon + i]
                    * excursion_errors[i]
                )


@kernel_helper
def _write_moment_arm_tables(c: ConstantTables, d: int, q: Vector) -> None:
    """Write a digit's tables R, R B and B (R B)^+ and its excursion offsets, for joint angles q (J,) [rad].

    R are the moment arms of the digit's tendons, and B is the coupling of its joints.
    """
    joints = (c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d])
    tendons = (c.digit_int[h.FIRST_TENDON, d], c.digit_int[h.END_TENDON, d])
    first_coordinate = c.digit_int[h.FIRST_COORDINATE, d]
    count = c.digit_int[h.END_COORDINATE, d] - first_coordinate
    gram_matrix = np.zeros((count, count))
    excursion_offsets = np.zeros(tendons[1] - tendons[0])  # excursion minus the product R q
    for n in range(tendons[0], tendons[1]):
        for j in range(joints[0], joints[1]):
            arm = moment_arm(c, n, j, q[j])
            excursion_offsets[n - tendons[0]] += joint_excursion(c, n, j, q[j]) - arm * q[j]
            c.tendon_joint_table[h.MOMENT_ARMS, n, j] = arm
        for k in range(count):
            reduced_arm = 0.0
            for j in range(joints[0], joints[1]):
                reduced_arm += (
                    c.tendon_joint_table[h.MOMENT_ARMS, n, j]
                    * c.joint_coordinate_table[h.JOINT_COUPLING, j, first_coordinate + k]
                )
            c.tendon_coordinate_table[h.REDUCED_ARMS, n, first_coordinate + k] = reduced_arm
        for k in range(count):
            for other_coordinate in range(count):
                product = c.tendon_coordinate_table[h.REDUCED_ARMS, n, first_coordinate + k]
                gram_matrix[k, other_coordinate] += (
                    product
                    * c.tendon_coordinate_table[
                        h.REDUCED_ARMS, n, first_coordinate + other_coordinate
                    ]
                )
    _invert_matrix(gram_matrix)
    for j in range(joints[0], joints[1]):
        c.joint[h.ANGLE_OFFSET, j] = 0.0
        for n in range(tendons[0], tendons[1]):
            angle = 0.0
            for k in range(count):
                for other_coordinate in range(count):
                    product = (
                        c.joint_coordinate_table[h.JOINT_COUPLING, j, first_coordinate + k]
                        * gram_matrix[k, other_coordinate]
                    )
                    angle += (
                        product
                        * c.tendon_coordinate_table[
                            h.REDUCED_ARMS, n, first_coordinate + other_coordinate
                        ]
                    )
            c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, n] = c.tendon_joint_table[
                h.TORQUE_TO_TENSION, n, j
            ] = angle
            c.joint[h.ANGLE_OFFSET, j] -= angle * excursion_offsets[n - tendons[0]]
    for n in range(tendons[0], tendons[1]):
        c.tendon[h.EXCURSION_MODEL_OFFSET, n] = excursion_offsets[n - tendons[0]]
        for j in range(joints[0], joints[1]):
            c.tendon[h.EXCURSION_MODEL_OFFSET, n] += (
                c.tendon_joint_table[h.MOMENT_ARMS, n, j] * c.joint[h.ANGLE_OFFSET, j]
            )


@kernel_helper
def _write_weights(c: ConstantTables, d: int) -> None:
    """Write the pulley weights, the torques ``POSTURE_TORQUE`` and the balance tensions of a digit.

    The function computes all three tables from the digit's present moment arms R.
    """
    for n in range(c.digit_int[h.FIRST_TENDON, d], c.digit_int[h.END_TENDON, d]):
        total = 0.0
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            total += abs(c.tendon_joint_table[h.MOMENT_ARMS, n, j])
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            c.tendon_joint_table[h.PULLEY_WEIGHTS, n, j] = (
                abs(c.tendon_joint_table[h.MOMENT_ARMS, n, j]) / total
            )
            torque = 0.0
            for i in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
                torque += (
                    c.joint_joint_table[h.COORDINATE_PROJECTION, j, i]
                    * c.tendon_joint_table[h.MOMENT_ARMS, n, i]
                )
            c.joint_tendon_table[h.POSTURE_TORQUE, j, n] = torque
        mean = c.tendon[h.MEAN_BALANCE_TENSION, n]
        if c.tendon_int[h.IS_REDUNDANT_DIGIT, n] and mean > 0.0:
            # The balance tensions for the mean moment arms are known. The new balance tensions are
            # the part of these tensions that makes no torque with the present moment arms.
            balance = mean - project_onto_digit_motion(c, n, c.tendon[h.MEAN_BALANCE_TENSION])
            c.tendon[h.BALANCE_TENSION, n] = c.tendon[h.RELAXED_TENSION, n] = max(
                balance, MIN_BALANCE_FRACTION * mean
            )


@kernel_helper
def _write_compliance(c: ConstantTables, d: int) -> None:
    """Write the compliance of the joints: the turn of the joints per torque while all excursions stay constant.

    With the spring stiffness K and the moment arms R, the compliance is K^-1 - K^-1 R^T (R K^-1
    R^T)^-1 R K^-1.
    """
    joints = (c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d])
    tendons = (c.digit_int[h.FIRST_TENDON, d], c.digit_int[h.END_TENDON, d])
    count = tendons[1] - tendons[0]
    tendon_compliance = np.zeros((count, count))
    joint_compliance = np.empty(joints[1])
    for j in range(joints[0], joints[1]):
        min_stiffness = MIN_SPRING_STIFFNESS / (
            c.joint[h.JOINT_SCALE, j] * c.joint[h.JOINT_SCALE, j]
        )
        joint_compliance[j] = 1.0 / max(c.joint[h.SPRING_STIFFNESS, j], min_stiffness)
        for a in range(count):
            for b in range(count):
                product = (
                    c.tendon_joint_table[h.MOMENT_ARMS, tendons[0] + a, j] * joint_compliance[j]
                )
                tendon_compliance[a, b] += (
                    product * c.tendon_joint_table[h.MOMENT_ARMS, tendons[0] + b, j]
                )
    trace = 0.0
    for a in range(count):
        trace += tendon_compliance[a, a]
    for a in range(count):
        tendon_compliance[a, a] += REGULARISATION_FRACTION * trace / count
    _invert_matrix(tendon_compliance)
    for i in range(joints[0], joints[1]):
        for j in range(joints[0], joints[1]):
            value = joint_compliance[i] if i == j else 0.0
            for a in range(count):
                for b in range(count):
                    product = (
                        joint_compliance[i]
                        * c.tendon_joint_table[h.MOMENT_ARMS, tendons[0] + a, i]
                        * tendon_compliance[a, b]
                    )
                    value -= (
                        product
                        * c.tendon_joint_table[h.MOMENT_ARMS, tendons[0] + b, j]
                        * joint_compliance[j]
                    )
            c.joint_joint_table[h.COMPLIANCE, i, j] = value


@kernel_helper
def _invert_matrix(matrix: Matrix) -> None:
    """Invert a symmetric positive definite matrix in place, by Gauss-Jordan elimination."""
    count = len(matrix)
    for k in range(count):
        pivot = 1.0 / matrix[k, k]
        matrix[k, k] = 1.0
        for j in range(count):
            matrix[k, j] *= pivot
        for i in range(count):
            if i != k:
                factor = matrix[i, k]
                matrix[i, k] = 0.0
                for j in range(count):
                    matrix[i, j] -= factor * matrix[k, j]
