"""Joint angles of digits with fewer tendons than joints, with standard deviations.

Excursions determine the joint angles of a digit up to the null space of the moment arms. A free
digit has the angles of its coupling, q = B theta. In contact the object turns the joints against
each other, by the contact's torque times the compliance of the springs in the null space, N (N^T K
N)^-1 N^T. The torque is measured (unexplained tension), the place on the digit is not. The estimate
is the mean over places: the middle of each link, the tip, and all joints alike. The standard
deviation consists of the differences between places, and of

- the model's error of tension, at each of these places,
- capstan friction, with a sign by the direction of motion,
- the free digit's own error: springs and gravity not matching the coupling,
- the excursion's error.

Joint encoders, if present, are fused with this prior (Kalman update with the full covariance).
Digits with as many tendons as joints have no null space: excursions determine the angles.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner, square
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.core.estimation.statics import first_wrap, link_poses_of_hand, write_static_torque, write_tip_levers
from handctl.core.estimation.structure import keep_excursion
from handctl.hand.rigid_body import LENGTH, write_levers, write_turned_levers

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MODEL_ERROR_N = 0.5
"""Model error of the tension in free motion, standard deviation, for friction and springs of the hand file [N]."""
MODEL_ERROR_FRACTION = 0.15
"""Model error of the tension, as a fraction of the unexplained tension."""
STIFFNESS_ERROR_FRACTION = 0.03
"""Error of the tendons' stiffness, as a fraction. The error converts stretch into excursion."""
FRICTION_FRACTION = 0.5
"""Standard deviation of the turn by friction, as a fraction of the turn by fully developed friction."""
MIN_SQUARED_LEVER_M2 = 1e-8
"""Smallest square of a lever [m^2]. A place without lever (all joints alike) has no turn."""
READING_LIMIT_S = 0.1
"""Largest age of a joint encoder's reading [s]."""
RATE_ERROR_FRACTION = 1.0
"""Error of the rate for advancing a reading to the present, as a fraction. The rate is the free digit's."""
MIN_TURN_RAD = 1e-9
"""Smallest turn limited by a joint's range [rad]."""
CONTACT_FADE_S = 0.15
"""Time constant of the fading effect of a contact [s]. Friction holds the joints for a while."""
UPDATE_S = 8e-3
"""Period of the estimate in the null space [s]."""
TURN_SMOOTHING_S = 20e-3
"""Time constant of the turn [s]."""


@inner
def estimate_joint_angles(x: Tables, c: ConstantTables, k: int, t_ns: int) -> None:
    """Estimate the joint angles of a tick, and the standard deviations.

    Args:
        x: state tables, with the free digits' angles in ``Q``.
        c: constants of the hand.
        k: number of the tick.
        t_ns: time of the tick [ns].
    """
    spread, variance = _excursion_deviations(x, c)
    if not c.run_int[h.NULL_SPACE]:
        for j in range(x.joint.shape[1]):
            x.joint[s.Q_SIGMA, j] = math.sqrt(variance[j])
        return
    for d in range(x.digit.shape[1]):
        # Rises at once with the touch, and decays with RELEASE_S.
        x.digit[s.PRESSED, d] = max(x.digit[s.TOUCH, d], x.digit[s.PRESSED, d] * c.run[h.PRESSED_DECAY])
    update = k % c.run_int[h.POSTURE_TICKS] == 0
    columns = np.zeros((0, 0))
    if update:
        columns = _covariance_columns(x, c)
    for j in range(x.joint.shape[1]):
        sigma = math.sqrt(square(x.joint[s.TURN_SIGMA, j]) + variance[j])
        x.joint[s.Q, j] += x.joint[s.TURN, j]
        x.joint[s.Q_SIGMA, j] = min(sigma, c.joint[h.RANGE_SIGMA, j])
    if c.run_int[h.HAND_VARYING]:
        keep_excursion(x, c)
    if update and c.run_int[h.JOINTS_FUSED]:
        _fuse_encoders(x, c, columns, spread, t_ns)


@inner
def _excursion_deviations(x: Tables, c: ConstantTables) -> tuple[Matrix, Vector]:
    """Return deviations (J, N) of the joint angles by each tendon's excursion [rad], and the sums of squares (J,)."""
    joints = x.joint.shape[1]
    tendons = x.tendon.shape[1]
    spread = np.zeros((joints, tendons))
    total = np.zeros(joints)
    for n in range(tendons):
        stretch = square(x.tendon[s.TENSION, n] * STIFFNESS_ERROR_FRACTION) + square(x.tendon[s.SIGMA, n])
        variance = c.tendon[h.EXCURSION_VARIANCE, n] + stretch / square(c.tendon[h.STIFFNESS, n])
        if c.run_int[h.HAND_PASSED]:
            # The error of the carrier's angle, whose tendons come before.
            for j in range(joints):
                variance += square(c.tendon_joint[h.CARRIER_ARMS, n, j]) * total[j]
        excursion = math.sqrt(variance)
        for j in range(joints):
            spread[j, n] = c.joint_tendon[h.EXCURSION_TO_JOINTS, j, n] * excursion
            total[j] += square(spread[j, n])
    return spread, total


@inner
def _covariance_columns(x: Tables, c: ConstantTables) -> Matrix:
    """Return deviations (2 H + 2, J) [rad] with the null-space covariance as sum of squares. Write the turn.

    The levers are those of the last estimate: the ticks are the iterations of a fixed point.
    """
    places = c.place_joint.shape[1]
    joints = x.joint.shape[1]
    columns = np.zeros((2 * places + 2, joints))
    turns, doubt = _contact_turns(x, c)
    _write_free_errors(x, c, columns[2 * places :])
    for j in range(joints):
        mean = 0.0
        for place in range(places):
            mean += c.place_joint[h.PLACE_WEIGHT, place, j] * turns[place, j]
        turn = x.joint[s.TURN, j] + c.run[h.TURN_FRACTION] * (mean - x.joint[s.TURN, j])
        x.joint[s.TURN, j] = turn
        for place in range(places):
            root = math.sqrt(c.place_joint[h.PLACE_WEIGHT, place, j])
            # Square root of a probability: the squares then add up to the variance over places.
            columns[place, j] = root * (turns[place, j] - turn)
            columns[places + place, j] = root * doubt[place, j]
    for row in range(places, 2 * places + 2):
        for d in range(x.digit.shape[1]):
            fraction = max(_range_fraction(x, c, d, columns[row], 1.0), _range_fraction(x, c, d, columns[row], -1.0))
            for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
                columns[row, j] *= fraction
    for j in range(joints):
        variance = 0.0
        for row in range(len(columns)):
            variance += square(columns[row, j])
        x.joint[s.TURN_SIGMA, j] = math.sqrt(variance)
    return columns


@inner
def _contact_turns(x: Tables, c: ConstantTables) -> tuple[Matrix, Matrix]:
    """Return the turn of joints by a contact at each place, and by the error of tension, (H, J) [rad] each."""
    places = c.place_joint.shape[1]
    joints = x.joint.shape[1]
    turns = np.zeros((places, joints))
    doubt = np.zeros((places, joints))
    torque = np.zeros(joints)
    error = np.zeros(joints)
    for j in range(joints):
        for n in range(x.tendon.shape[1]):
            external = x.digit[s.PRESSED, c.tendon_int[h.DIGIT, n]]
            wrong = math.sqrt(square(MODEL_ERROR_N) + square(MODEL_ERROR_FRACTION * external))
            torque[j] += c.joint_tendon[h.POSTURE_TORQUE, j, n] * external
            error[j] += c.joint_tendon[h.POSTURE_TORQUE, j, n] * wrong
    q = np.zeros(joints)
    lever = np.zeros(joints)
    for j in range(joints):
        q[j] = x.joint[s.Q, j] + x.joint[s.TURN, j]
    pose = link_poses_of_hand(c, q)
    for place in range(places):
        for d in range(x.digit.shape[1]):
            _write_place_levers(c, d, place, pose, lever)
            _write_digit_turn(x, c, d, lever, torque, error, turns[place], doubt[place])
    return turns, doubt


@inner
def _write_place_levers(c: ConstantTables, d: int, place: int, pose: Matrix, lever: Vector) -> None:
    """Write the levers (J,) [m] of a force on a digit at a place about its joints.

    Place i is the middle of link i, the place after the last link is the tip. The others have no
    lever.
    """
    first = c.digit_int[h.JOINTS_FIRST, d]
    end = c.digit_int[h.JOINTS_END, d]
    for j in range(first, end):
        lever[j] = 0.0
    touched = first + place
    if touched < end:
        write_levers(pose, first, touched, 0.5 * c.joint[h.LINK + LENGTH, touched], lever)
    elif touched == end:
        write_tip_levers(c, d, pose, lever)


@inner
def _write_digit_turn(
    x: Tables,
    c: ConstantTables,
    d: int,
    lever: Vector,
    torque: Vector,
    error: Vector,
    turns: Vector,
    doubt: Vector,
) -> None:
    """Write the turn of a digit by a contact with given levers.

    Args:
        x: state tables.
        c: constants of the hand.
        d: index of the digit.
        lever: (J,) [m].
        torque: (J,) torque of the contact [N m].
        error: (J,) standard deviation of the torque [N m].
        turns: (J,) result: turn [rad].
        doubt: (J,) result: standard deviation of the turn [rad].
    """
    first = c.digit_int[h.JOINTS_FIRST, d]
    end = c.digit_int[h.JOINTS_END, d]
    size = 0.0
    work = 0.0
    work_error = 0.0
    for j in range(first, end):
        work += lever[j] * torque[j]
        work_error += lever[j] * error[j]
        for other in range(first, end):
            size += lever[j] * c.joint_joint[h.SPREAD, j, other] * lever[other]
    size = max(size, MIN_SQUARED_LEVER_M2)
    for j in range(first, end):
        compliance = 0.0
        for other in range(first, end):
            compliance += lever[other] * c.joint_joint[h.COMPLIANCE, other, j]
        # Unexplained tension is positive where the object pushes the digit open.
        turns[j] = -work / size * compliance
        doubt[j] = work_error / size * compliance
    fraction = _range_fraction(x, c, d, turns, 1.0)
    for j in range(first, end):
        turns[j] *= fraction  # as a whole, so that its excursion stays


@inner
def _range_fraction(x: Tables, c: ConstantTables, d: int, turn: Vector, sign: float) -> float:
    """Return the fraction, 0 to 1, of a digit's turn (J,) [rad] within the joints' ranges at the free angles."""
    fraction = 1.0
    for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
        way = sign * turn[j]
        q = x.joint[s.Q, j]
        margin = max(c.joint[h.HIGH, j] - q if way > 0.0 else q - c.joint[h.LOW, j], 0.0)
        fraction = min(fraction, margin / max(abs(way), MIN_TURN_RAD))
    return fraction


@inner
def _write_free_errors(x: Tables, c: ConstantTables, turn: Matrix) -> None:
    """Write the turns of a free digit by friction, and by springs and gravity off the coupling, (2, J) [rad]."""
    joints = x.joint.shape[1]
    torque = np.zeros((2, joints))
    write_static_torque(c, x.joint[s.Q], torque[1])
    for n in range(x.tendon.shape[1]):
        d = c.tendon_int[h.DIGIT, n]
        wrapped = first_wrap(c, n, x.joint[s.Q])
        for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
            arm = c.tendon_joint[h.MOMENT_ARMS, n, j]
            if arm != 0.0:
                wrapped += x.joint[s.Q, j]
                rubbed = arm * c.tendon[h.CAPSTAN, n]
                torque[0, j] += FRICTION_FRACTION * x.tendon[s.TENSION, n] * rubbed * wrapped
    for row in range(2):
        for j in range(joints):
            turn[row, j] = 0.0
            for other in range(joints):
                turn[row, j] += torque[row, other] * c.joint_joint[h.COMPLIANCE, other, j]


@inner
def _fuse_encoders(x: Tables, c: ConstantTables, columns: Matrix, spread: Matrix, t_ns: int) -> None:
    """Correct the angles by joint encoders, one after the other, because their noises are independent.

    Args:
        x: state tables.
        c: constants of the hand.
        columns: (C, J) deviations, with the prior's covariance as sum of squares [rad].
        spread: (J, N) further deviations [rad].
        t_ns: present time [ns].

    Source: sequential measurement update of the Kalman filter (Bierman 1977).
    """
    joints = x.joint.shape[1]
    covariance = np.zeros((joints, joints))
    for a in range(joints):
        for b in range(joints):
            for row in range(len(columns)):
                covariance[a, b] += columns[row, a] * columns[row, b]
            for n in range(spread.shape[1]):
                covariance[a, b] += spread[a, n] * spread[b, n]
            covariance[a, b] *= c.joint_joint[h.SAME_DIGIT, a, b]
    used = False
    gain = np.zeros(joints)
    before = np.zeros(joints)
    for j in range(joints):
        if not c.joint_int[h.LOOSE, j]:
            continue
        heard_ns = x.group_int[s.GROUP_NS, c.joint_int[h.JOINT_GROUP, j]]
        age = (t_ns - heard_ns) / 1e9
        if heard_ns < 0 or age >= READING_LIMIT_S:
            continue
        used = True
        moved = x.joint[s.DQ, j] * age
        noise = c.joint[h.ENCODER_VARIANCE, j] + square(RATE_ERROR_FRACTION * moved)
        residual = x.joint[s.JOINT_ANGLE, j] + moved - x.joint[s.Q, j]
        for a in range(joints):
            # The row is copied, because the loop below overwrites the covariance.
            gain[a] = covariance[a, j] / (covariance[j, j] + noise)
            before[a] = covariance[j, a]
        for a in range(joints):
            x.joint[s.Q, a] += gain[a] * residual
            for b in range(joints):
                covariance[a, b] -= gain[a] * before[b]
    if used:
        for j in range(joints):
            if c.joint_int[h.LOOSE, j]:
                x.joint[s.Q_SIGMA, j] = math.sqrt(max(covariance[j, j], 0.0))


@inner
def estimate_tip_forces(x: Tables, c: ConstantTables) -> None:
    """Write tip-equivalent forces of all digits, and the standard deviations from those of angles and tensions.

    The tip-equivalent force is along y of the last link, at the tip, with the same torque. A
    one-tendon finger gives no information on the place of contact. The tip is then a convention.
    """
    joints = x.joint.shape[1]
    coordinates = x.coordinate.shape[1]
    torque = np.zeros(coordinates)
    lever = np.zeros(coordinates)
    turned = np.zeros(coordinates)
    about = np.zeros(joints)
    about_turned = np.zeros(joints)
    q = np.zeros(joints)
    for j in range(joints):
        q[j] = x.joint[s.Q, j]
    for k in range(coordinates):
        for n in range(x.tendon.shape[1]):
            torque[k] += x.tendon[s.EXTERNAL, n] * c.tendon_coordinate[h.REDUCED_ARMS, n, k]
    pose = link_poses_of_hand(c, q)
    for d in range(x.digit.shape[1]):
        first = c.digit_int[h.JOINTS_FIRST, d]
        last = c.digit_int[h.JOINTS_END, d] - 1
        length = c.joint[h.LINK + LENGTH, last]
        write_tip_levers(c, d, pose, about)
        _reduce_levers(c, d, about, lever)
        force = _dot_over_coordinates(c, d, lever, torque) / _dot_over_coordinates(c, d, lever, lever)
        x.digit[s.TIP_FORCE, d] = force
        x.digit[s.TIP_FORCE_SIGMA, d] = 0.0
        for j in range(first, last + 1):
            # Numerical derivative by a step of one standard deviation.
            for i in range(first, last + 1):
                about_turned[i] = about[i]
            write_turned_levers(pose, first, last, length, j, x.joint[s.Q_SIGMA, j], about_turned)
            _reduce_levers(c, d, about_turned, turned)
            change = _dot_over_coordinates(c, d, turned, torque) / _dot_over_coordinates(c, d, turned, turned) - force
            x.digit[s.TIP_FORCE_SIGMA, d] += square(change)
    for n in range(x.tendon.shape[1]):
        d = c.tendon_int[h.DIGIT, n]
        error = math.sqrt(
            square(x.tendon[s.SIGMA, n])
            + square(MODEL_ERROR_N)
            + square(MODEL_ERROR_FRACTION * x.tendon[s.EXTERNAL, n])
        )
        arms = c.tendon_coordinate[h.REDUCED_ARMS, n]
        change = _dot_over_coordinates(c, d, lever, arms) * error / _dot_over_coordinates(c, d, lever, lever)
        x.digit[s.TIP_FORCE_SIGMA, d] += square(change)
    for d in range(x.digit.shape[1]):
        x.digit[s.TIP_FORCE_SIGMA, d] = math.sqrt(x.digit[s.TIP_FORCE_SIGMA, d])


@inner
def _reduce_levers(c: ConstantTables, d: int, lever: Vector, result: Vector) -> None:
    """Write the levers of a digit about its coordinates (C,) from those about its joints (J,) [m]."""
    for k in range(c.digit_int[h.COORDINATES_FIRST, d], c.digit_int[h.COORDINATES_END, d]):
        result[k] = 0.0
        for j in range(c.digit_int[h.JOINTS_FIRST, d], c.digit_int[h.JOINTS_END, d]):
            result[k] += c.joint_coordinate[h.COUPLING, j, k] * lever[j]


@inner
def _dot_over_coordinates(c: ConstantTables, d: int, one: Vector, other: Vector) -> float:
    """Return the sum of products (C,) over the coordinates of a digit."""
    total = 0.0
    for k in range(c.digit_int[h.COORDINATES_FIRST, d], c.digit_int[h.COORDINATES_END, d]):
        total += one[k] * other[k]
    return total
