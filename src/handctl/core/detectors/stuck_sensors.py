"""Detection of sensors whose readings are stuck at a constant value.

A reading is stuck if it stays constant although another measurement shows that the measured
quantity changes.

The other measurement is called the reference of the sensor. While the reference of a sensor is
constant, a constant reading of the sensor does not count as a fault. A motor encoder has two
references: the goal of the tendon's excursion, and the tension of the tendon. The reference of a
load cell is the range of the motor force since the last change of the reading. The range shows a
change even if the tension loop first raises the motor force and then lowers it again. The reference
of a joint encoder is the joint angle that is computed from the positions of the spools.
"""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import follows_streamed_angles
from handctl.core.detectors.residuals import QUICK_FORCE, TENSION
from handctl.core.estimation.varying_moment_arms import joint_excursion
from handctl.core.state_block import StateTables

MOTOR_FOLLOWING_TIME_CONSTANT_S = 0.1
"""Time constant that is assumed for a motor that follows a jump of its goal, with a large margin [s]."""
MAX_UNDELAYED_GOAL_SPEED_M_S = 2e-3
"""Speed of a goal below which the motor is assumed to follow without delay [m/s]."""
ARRIVAL_DISTANCE_M = 0.2e-3
"""Distance between excursion and goal below which a motor has reached its goal [m]."""
MIN_GOAL_JUMP_M = 2.0 * ARRIVAL_DISTANCE_M
"""Step of the filtered goal in a tick above which the step counts as a jump, and not as a motion of the digit [m]."""
MIN_PRESSING_TENSION_N = 8.0
"""Excess of a tension over its goal above which a digit with streamed targets counts as held by an object [N]."""


@kernel_helper
def update_stuck_counts(x: StateTables, c: ConstantTables, are_cells_tared: bool) -> None:
    """Update the number of ticks with a constant reading, for each sensor.

    If a reading is missing, the number of ticks with a constant reading does not change.

    Args:
        x: state tables.
        c: constants of the hand.
        are_cells_tared: True if the zeros of the load cells are known.
    """
    for n in range(x.tendon.shape[1]):
        # The position of the encoder is compared instead of the tendon travel, because the travel
        # also changes with the angle of a carrying joint.
        value = x.tendon[s.MEASURED_POSITION, n] * c.tendon[h.SPOOL_RADIUS, n]
        last_position = x.tendon[s.STUCK_TEST_POSITION, n]
        has_moved = not math.isnan(value) and value != last_position
        goal = x.tendon[s.FILTERED_GOAL, n]
        tension = reference_tension(x, c, n)
        if has_moved or math.isnan(x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE, n]):
            x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE, n] = goal
        if has_moved or math.isnan(x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE + 1, n]):
            x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE + 1, n] = tension
        if not math.isnan(value):
            x.tendon_int[s.MOTOR_UNCHANGED_COUNT, n] = (
                0 if has_moved else x.tendon_int[s.MOTOR_UNCHANGED_COUNT, n] + 1
            )
            x.tendon[s.STUCK_TEST_POSITION, n] = value
        cell_tension = x.tendon[s.MEASURED_TENSION, n] if are_cells_tared else math.nan
        last_position = x.tendon[s.STUCK_TEST_TENSION, n]
        has_moved = not math.isnan(cell_tension) and cell_tension != last_position
        force = x.tendon[s.RESIDUAL + QUICK_FORCE, n]
        if has_moved or math.isnan(x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE, n]):
            x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE, n] = x.tendon[
                s.FORCE_RANGE_SINCE_CELL_CHANGE + 1, n
            ] = force
        # A comparison with NaN is False, so an unknown motor force does not change the stored range
        # of the force.
        if force < x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE, n]:
            x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE, n] = force
        if force > x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE + 1, n]:
            x.tendon[s.FORCE_RANGE_SINCE_CELL_CHANGE + 1, n] = force
        if not math.isnan(cell_tension):
            x.tendon_int[s.CELL_UNCHANGED_COUNT, n] = (
                0 if has_moved else x.tendon_int[s.CELL_UNCHANGED_COUNT, n] + 1
            )
            x.tendon[s.STUCK_TEST_TENSION, n] = cell_tension
    for j in range(x.joint.shape[1]):
        value = x.joint[s.MEASURED_JOINT, j]
        last_position = x.joint[s.STUCK_TEST_ANGLE, j]
        has_moved = not math.isnan(value) and value != last_position
        reference = joint_angle_by_spools(x, c, j)
        if not are_tendons_of_joint_taut(x, c, j):
            x.joint[s.ANGLE_AT_LAST_JOINT_CHANGE, j] = math.nan
        if has_moved or math.isnan(x.joint[s.ANGLE_AT_LAST_JOINT_CHANGE, j]):
            x.joint[s.ANGLE_AT_LAST_JOINT_CHANGE, j] = reference
        if not math.isnan(value):
            x.joint_int[s.JOINT_UNCHANGED_COUNT, j] = (
                0 if has_moved else x.joint_int[s.JOINT_UNCHANGED_COUNT, j] + 1
            )
            x.joint[s.STUCK_TEST_ANGLE, j] = value


@kernel_helper
def reference_tension(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the tension that is the reference for the encoder of a motor [N].

    Return NaN if other motors also change the tension, as in every digit with several tendons and
    load cells. Another motor can turn a joint that the tendon crosses. The tension then changes
    although friction holds the tendon's own motor at rest.

    Without a load cell, the tension is computed from the torque of the tendon's own motor. The
    computed tension shows that a tendon has torn. In a digit with more tendons than coordinates,
    the result is NaN, because an antagonist also changes the computed tension.
    """
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    has_other_tendons = c.digit_int[h.END_TENDON, d] - c.digit_int[h.FIRST_TENDON, d] > 1
    has_cell = c.tendon_int[h.CELL_GROUP, n] >= 0
    if c.tendon_int[h.IS_REDUNDANT_DIGIT, n] or (has_other_tendons and has_cell):
        return math.nan
    return x.tendon[s.RESIDUAL + TENSION, n]


@kernel_helper
def are_tendons_of_joint_taut(x: StateTables, c: ConstantTables, j: int) -> bool:
    """Return True if all tendons that move a joint are taut.

    The spool of a slack tendon does not move the joint.
    """
    for n in range(x.tendon.shape[1]):
        if c.joint_tendon_table[h.MOVES_JOINT, j, n] != 0.0 and not x.tendon_int[s.IS_TAUT, n]:
            return False
    return True


@kernel_helper
def joint_angle_by_spools(x: StateTables, c: ConstantTables, j: int) -> float:
    """Return a joint angle computed from spool positions [rad], or NaN if a tendon of the joint is slack."""
    if not are_tendons_of_joint_taut(x, c, j):
        return math.nan
    angle = c.joint[h.ANGLE_OFFSET, j]
    for n in range(x.tendon.shape[1]):
        if c.joint_tendon_table[h.MOVES_JOINT, j, n] != 0.0:
            stretch = x.tendon[s.RESIDUAL + TENSION, n] / c.tendon[h.TENDON_STIFFNESS, n]
            angle += c.joint_tendon_table[h.EXCURSION_TO_JOINTS, j, n] * (
                x.tendon[s.MEASURED_TRAVEL, n] - stretch
            )
    return angle


@kernel_helper
def change_since_reading(reference: float, reference_at_reading: float) -> float:
    """Return the change of a sensor's reference since the reading of the sensor became constant.

    Return 0 if the change of the reference is unknown.
    """
    distance = abs(reference - reference_at_reading)
    return 0.0 if math.isnan(distance) else distance


@kernel_helper
def filter_goals(x: StateTables, c: ConstantTables) -> None:
    """Filter the goal of each motor.

    A filter of the goal is necessary because no motor can follow a sudden change of its goal. While
    the encoder's reading changes, the filtered goal equals the goal. The detector judges how far
    the filtered goal has moved since the reading became constant. The detector does not judge the
    distance of the motor from the goal, because friction can stop the motor before the goal. When a
    motor has reached its goal, the filtered goal is set to the estimated excursion. The jump of the
    filtered goal to the estimated excursion does not count as a motion of the motor's goal. A
    client that does not know an object can send targets that the object makes unreachable.
    Therefore, the detector ignores the motion of the goal while a digit that follows streamed
    targets presses on an object.
    """
    fraction = 1.0 - math.exp(-c.run[h.CONTROL_PERIOD] / MOTOR_FOLLOWING_TIME_CONSTANT_S)
    min_step = MAX_UNDELAYED_GOAL_SPEED_M_S * c.run[h.CONTROL_PERIOD]
    for n in range(x.tendon.shape[1]):
        goal = 0.0
        d = c.tendon_int[h.DIGIT_OF_TENDON, n]
        for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
            if c.tendon_joint_table[h.MOMENT_ARMS, n, j] != 0.0:
                goal += joint_excursion(c, n, j, x.joint[s.Q_GOAL, j])
        last_goal = x.tendon[s.FILTERED_GOAL, n]
        present_excursion = x.tendon[s.EXCURSION, n]
        x.tendon[s.FILTERED_GOAL, n] = goal
        if math.isnan(last_goal):
            continue
        change = goal - last_goal
        if abs(change) > min_step and x.tendon_int[s.MOTOR_UNCHANGED_COUNT, n] != 0:
            x.tendon[s.FILTERED_GOAL, n] = last_goal + math.copysign(
                max(fraction * abs(change), min_step), change
            )
        if abs(goal - present_excursion) < ARRIVAL_DISTANCE_M:
            x.tendon[s.FILTERED_GOAL, n] = present_excursion
            if abs(present_excursion - last_goal) > MIN_GOAL_JUMP_M:
                # The filtered goal jumps to the estimated excursion. No motor has to follow the
                # jump of the filtered goal, so the value from which the motion of the filtered goal
                # is counted jumps by the same amount.
                x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE, n] += present_excursion - last_goal
        elif _is_digit_pressing(x, c, n):
            x.tendon[s.REFERENCE_AT_LAST_MOTOR_CHANGE, n] += (
                x.tendon[s.FILTERED_GOAL, n] - last_goal
            )


@kernel_helper
def _is_digit_pressing(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if a tendon's tension shows that a digit presses on an object while it follows streamed targets.

    The tension of a digit that presses on an object is much larger than the tension goal.
    """
    return (
        follows_streamed_angles(x, c, n)
        and x.tendon[s.TENSION, n] - x.tendon[s.TENSION_GOAL, n] > MIN_PRESSING_TENSION_N
    )
