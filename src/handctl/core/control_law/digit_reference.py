"""Motion of each digit on its trajectory in a tick, and the required joint torques and tensions."""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_goal import GoalKind
from handctl.core.control_law.streamed_motion import advance_reference
from handctl.core.estimation.statics import subtract_torque_of_passing_tendons
from handctl.core.estimation.varying_moment_arms import motor_speed
from handctl.core.state_block import StateTables
from handctl.hand.rigid_body import write_newton_euler
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED_M_S

Matrix = NDArray[np.float64]

LIMP = int(GoalKind.LIMP)
MOTION = int(GoalKind.MOTION)
TENSION = int(GoalKind.TENSION)
"""Values of ``digit_goal.GoalKind``, and of the field ``state_block.GOAL_KIND``."""
NO_TRAJECTORY, MINIMUM_JERK, SAMPLED, STREAMED = 0, 1, 2, 3
"""Values of the field ``state_block.TRAJECTORY_KIND``."""


@kernel_helper
def follow_trajectories(x: StateTables, c: ConstantTables, is_time_frozen: bool) -> None:
    """Write position, rate and acceleration of each coordinate on its trajectory.

    For a coordinate without a trajectory, position, rate and acceleration are 0.

    Args:
        x: state tables.
        c: constants of the hand.
        is_time_frozen: True while the safety monitor makes the hand hold its position. During such
            a hold, the digits rest at their present positions on the trajectories.

    Source: Flash & Hogan (1985), with the position 10 s^3 - 15 s^4 + 6 s^5, where s is the fraction
        of the duration.
    """
    t = x.run[s.GOAL_TIME]
    x.run_int[s.LIMITED_COORDINATE_COUNT] = 0
    for d in range(x.digit.shape[1]):
        first_coordinate = c.digit_int[h.FIRST_COORDINATE, d]
        end = c.digit_int[h.END_COORDINATE, d]
        if x.digit_int[s.TRAJECTORY_KIND, d] == NO_TRAJECTORY:
            for k in range(first_coordinate, end):
                for order in range(3):
                    x.coordinate[s.TRAJECTORY + order, k] = 0.0
        if x.digit_int[s.TRAJECTORY_KIND, d] == MINIMUM_JERK:
            duration = x.digit[s.TRAJECTORY_DURATION, d]
            elapsed_time = t - x.digit[s.TRAJECTORY_START_TIME, d]
            u = min(max(elapsed_time / duration, 0.0), 1.0)
            position = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
            rate = 30.0 * u * u * (1.0 - u) * (1.0 - u) / duration
            acceleration = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / (duration * duration)
            for k in range(first_coordinate, end):
                length = x.coordinate[s.TRAJECTORY_END, k] - x.coordinate[s.TRAJECTORY_START, k]
                x.coordinate[s.TRAJECTORY, k] = (
                    x.coordinate[s.TRAJECTORY_START, k] + position * length
                )
                x.coordinate[s.TRAJECTORY + 1, k] = rate * length
                x.coordinate[s.TRAJECTORY + 2, k] = acceleration * length
                _add_blend(x, k, elapsed_time, x.digit[s.TRAJECTORY_BLEND_TIME, d])
        if x.digit_int[s.TRAJECTORY_KIND, d] == STREAMED and not is_time_frozen:
            for k in range(first_coordinate, end):
                advance_reference(x, c, d, k)
        if is_time_frozen and is_digit_moving(x, c, d):
            for k in range(first_coordinate, end):
                x.coordinate[s.TRAJECTORY + 1, k] = x.coordinate[s.TRAJECTORY + 2, k] = 0.0


@kernel_helper
def _add_blend(x: StateTables, k: int, elapsed: float, blend_duration: float) -> None:
    """Add the blend of a minimum-jerk move. In the blend, the earlier motion of the digit fades out.

    ``trajectory.BlendTrajectory`` describes the polynomials of the blend.

    Args:
        x: state tables.
        k: index of the coordinate.
        elapsed: time since the start of the move [s].
        blend_duration: time in which the earlier motion fades out [s].
    """
    speed = x.coordinate[s.TRAJECTORY_START_SPEED, k]
    start_acceleration = x.coordinate[s.TRAJECTORY_START_ACCELERATION, k]
    if speed == 0.0 and start_acceleration == 0.0:
        return
    u = min(max(elapsed / blend_duration, 0.0), 1.0)
    x.coordinate[s.TRAJECTORY, k] += (
        blend_duration * u * (1.0 + u * u * (-6.0 + u * (8.0 - 3.0 * u))) * speed
    )
    x.coordinate[s.TRAJECTORY, k] += (
        0.5
        * blend_duration
        * blend_duration
        * u
        * u
        * (1.0 + u * (-3.0 + u * (3.0 - u)))
        * start_acceleration
    )
    x.coordinate[s.TRAJECTORY + 1, k] += (1.0 + u * u * (-18.0 + u * (32.0 - 15.0 * u))) * speed
    x.coordinate[s.TRAJECTORY + 1, k] += (
        0.5 * blend_duration * u * (2.0 + u * (-9.0 + u * (12.0 - 5.0 * u))) * start_acceleration
    )
    x.coordinate[s.TRAJECTORY + 2, k] += (
        u * (-36.0 + u * (96.0 - 60.0 * u)) / blend_duration * speed
    )
    x.coordinate[s.TRAJECTORY + 2, k] += (
        1.0 + u * (-9.0 + u * (18.0 - 10.0 * u))
    ) * start_acceleration


@kernel_helper
def joint_trajectories(x: StateTables, c: ConstantTables) -> Matrix:
    """Return the angles, rates and accelerations of all joints on their trajectories (3, J)."""
    joints = x.joint.shape[1]
    trajectory = np.zeros((3, joints))
    for j in range(joints):
        for k in range(x.coordinate.shape[1]):
            coupling = c.joint_coordinate_table[h.JOINT_COUPLING, j, k]
            if coupling != 0.0:
                for order in range(3):
                    trajectory[order, j] += coupling * x.coordinate[s.TRAJECTORY + order, k]
    return trajectory


@kernel_helper
def is_digit_moving(x: StateTables, c: ConstantTables, d: int) -> bool:
    """Return True if at least one tendon of a digit follows a trajectory."""
    for n in range(c.digit_int[h.FIRST_TENDON, d], c.digit_int[h.END_TENDON, d]):
        if x.tendon_int[s.GOAL_KIND, n] == MOTION:
            return True
    return False


@kernel_helper
def follows_streamed_angles(x: StateTables, c: ConstantTables, n: int) -> bool:
    """Return True if the digit of a tendon follows streamed angles."""
    return bool(x.digit_int[s.TRAJECTORY_KIND, c.tendon_int[h.DIGIT_OF_TENDON, n]] == STREAMED)


@kernel_helper
def is_target_stream_running(x: StateTables) -> bool:
    """Return True if a stream of targets is running, for any digit or tendon of the hand."""
    return bool(x.run_int[s.STREAM_STATE] == s.RUNNING_STREAM)


@kernel_helper
def write_required_torque(x: StateTables, c: ConstantTables, trajectory: Matrix) -> None:
    """Write the joint torques that the trajectories require.

    The required joint torques overcome inertia, gravity, springs and damping.

    Args:
        x: state tables.
        c: constants of the hand.
        trajectory: (3, J) angles [rad], rates [rad/s] and accelerations [rad/s2].
    """
    joints = x.joint.shape[1]
    is_any_digit_moving = False
    motion = np.zeros((3, joints))
    torque = np.empty(joints)
    for d in range(x.digit.shape[1]):
        first_joint = c.digit_int[h.FIRST_JOINT, d]
        end = c.digit_int[h.END_JOINT, d]
        if is_digit_moving(x, c, d):
            is_any_digit_moving = True
            for order in range(3):
                for j in range(first_joint, end):
                    motion[order, j] = trajectory[order, j]
        else:
            # A digit without a trajectory is assumed to rest at its estimated angles.
            for j in range(first_joint, end):
                motion[0, j] = x.joint[s.Q, j]
    if not is_any_digit_moving:
        return
    parent = c.joint_int[h.PARENT_JOINT]
    gravity = c.run[h.GRAVITY : h.GRAVITY + 3]
    write_newton_euler(
        c.joint, h.LINK_TABLE, parent, gravity, motion[0], motion[1], motion[2], torque
    )
    if c.run_int[h.HAS_CARRIER_ARMS]:
        winding_directions = np.zeros(x.tendon.shape[1])
        for n in range(len(winding_directions)):
            winding_directions[n] = math.tanh(motor_speed(x, c, n) / CAPSTAN_FRICTION_SPEED_M_S)
        subtract_torque_of_passing_tendons(
            c, motion[0], x.tendon[s.TENSION], winding_directions, torque
        )
    for d in range(x.digit.shape[1]):
        if is_digit_moving(x, c, d):
            for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
                spring = c.joint[h.SPRING_STIFFNESS, j] * (
                    motion[0, j] + c.joint[h.SPRING_PRELOAD, j]
                )
                x.joint[s.REQUIRED_JOINT_TORQUE, j] = (
                    torque[j] + spring + c.joint[h.JOINT_DAMPING, j] * motion[1, j]
                )


@kernel_helper
def write_required_tensions(x: StateTables, c: ConstantTables) -> int:
    """Write the tensions that make the required joint torques.

    The written tensions are the tensions at the joints, after the friction of the pulleys.

    Returns:
        A number with one bit for each digit. The bit of a digit is 1 if the required tensions of
        the digit are out of bounds or not unique. For a digit whose bit is 1, the caller must solve
        the bounded least-squares problem of ``tension_allocation``. In a digit with a single
        tendon, a required tension out of bounds is replaced by the bound, and the bit of the digit
        is 0.
    """
    unsolved_digits = 0
    for d in range(x.digit.shape[1]):
        first_tendon = c.digit_int[h.FIRST_TENDON, d]
        end = c.digit_int[h.END_TENDON, d]
        is_solved = True
        for n in range(first_tendon, end):
            x.tendon[s.REQUIRED_TENSION, n] = 0.0
            if not is_digit_moving(x, c, d):
                continue
            for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
                x.tendon[s.REQUIRED_TENSION, n] += (
                    c.tendon_joint_table[h.TORQUE_TO_TENSION, n, j]
                    * x.joint[s.REQUIRED_JOINT_TORQUE, j]
                )
            low = c.tendon[h.TENSION_FLOOR, n]
            high = c.tendon[h.TENSION_CEILING, n]
            is_solved &= (
                c.tendon_int[h.HAS_UNIQUE_TENSIONS, n] == 1
                and low <= x.tendon[s.REQUIRED_TENSION, n] <= high
            )
            if end - first_tendon == 1:
                x.tendon[s.REQUIRED_TENSION, n] = min(
                    max(x.tendon[s.REQUIRED_TENSION, n], low), high
                )
        if not is_solved and end - first_tendon > 1:
            unsolved_digits |= 1 << d
    return unsolved_digits
