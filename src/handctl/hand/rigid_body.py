"""Rigid-body mechanics of trees of links in compiled code: poses, weight and inverse dynamics.

In a table of links, each column describes one link. The column of a link comes after the column of
its parent link. ``parent`` contains the column of each link's parent link, or -1 if the parent is
the palm. The origin of a link's frame is at the joint of the link, and its x axis is along the
link. The tip of a link lies on the x axis, at the length of the link. Gravity and poses are given
in the palm frame. The rates and forces in ``write_newton_euler`` are given in the frames of the
links.

A joint is a hinge or a prismatic joint. The link of a prismatic joint slides along the joint axis.
The position of a prismatic joint is in m, and not in rad. At a prismatic joint, a force along the
axis [N] replaces the torque, and lever arms have no unit. The frame of a sliding link moves with
the link.

Source: Featherstone, Rigid Body Dynamics Algorithms (2008), recursive Newton-Euler algorithm.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel, kernel_helper

Array = NDArray[np.float64]
IndexArray = NDArray[np.int64]

FIXED_ROTATION_ROW = 0
COSINE_ROTATION_ROW = 9
SINE_ROTATION_ROW = 18
"""First table row of each of the three matrices F, C and S. A matrix is stored row by row in the column of its link.

The rotation from the frame of a link to that of its parent is F + C cos q + S sin q, with the
matrices F, C and S in the order of their table rows.
"""
JOINT_ORIGIN_ROW = 27
"""First table row with the joint's position in the parent's frame [m]."""
JOINT_AXIS_ROW = 30
"""First table row with the joint's axis, a unit vector in the link's frame."""
LINK_MASS_ROW = 33
"""Table row with the link's mass [kg]."""
LINK_FIRST_MOMENT_ROW = 34
"""First table row with the link's first moment of mass, in the frame of the link [kg m]."""
LINK_INERTIA_ROW = 37
"""First table row with the link's inertia about its joint: xx, yy, zz, xy, xz, yz [kg m2]."""
JOINT_ARMATURE_ROW = 43
"""Table row with the armature of the joint: the inertia of its moving parts without the link [kg m2]."""
LINK_LENGTH_ROW = 44
"""Table row with the link's length [m]."""
IS_PRISMATIC_ROW = 45
"""Row in the table that is 1 for a prismatic joint, and 0 for a hinge."""
LINK_TABLE_ROW_COUNT = 46
"""Number of rows of a table of links."""

POSE_ROTATION_COLUMN = 0
"""First column of a pose with the rotation from the link's frame to the palm frame.

The rotation matrix is stored row by row.
"""
POSE_POSITION_COLUMN = 9
"""First column of a pose with the position of the link's joint in the palm frame [m]."""
POSE_AXIS_COLUMN = 12
"""First column of a pose with the joint's axis in the palm frame."""
CARRIED_MASS_COLUMN = 15
"""Column of a pose with the mass of the link and of all links that it carries [kg]."""
CARRIED_MOMENT_COLUMN = 16
"""First column of a pose with the first moment of the carried mass, in the palm frame [kg m]."""
POSE_PRISMATIC_COLUMN = 19
"""Column in a pose that is 1 for a prismatic joint, and 0 for a hinge."""
POSE_COLUMN_COUNT = 20
"""Number of columns of a pose."""

# Columns of the working memory of ``write_newton_euler``. The columns 0 to 8 contain the rotation
# from a link to its parent. Each of the following constants is the first column of a vector in the
# frame of the link. Only the position of the joint (_ORIGIN_COLUMN) is given in the frame of the
# parent link. The position of the joint includes the motion of a prismatic joint.
_ANGULAR_VELOCITY_COLUMN = 9
_ANGULAR_ACCELERATION_COLUMN = 12
_ACCELERATION_COLUMN = 15
_FORCE_COLUMN = 18
_TORQUE_COLUMN = 21
_ORIGIN_COLUMN = 24
_MOTION_TABLE_COLUMN_COUNT = 27


@kernel_helper
def write_link_poses(
    link_table: Array, first_row: int, parent: IndexArray, q: Array, pose: Array
) -> None:
    """Write the poses of all links into ``pose``, and leave the columns of ``pose`` for carried masses unchanged.

    Args:
        link_table: array that contains the table of links, see the docstring of the module.
        first_row: first row of the table in the array.
        parent: (n,) column of the parent of each link, or -1 if the parent is the palm.
        q: (n,) joint angles [rad].
        pose: (n, POSE_COLUMN_COUNT) array for the poses.
    """
    turn = np.empty(9)
    for j in range(len(q)):
        cosine = math.cos(q[j])
        sine = math.sin(q[j])
        for i in range(9):
            turn[i] = (
                link_table[first_row + FIXED_ROTATION_ROW + i, j]
                + cosine * link_table[first_row + COSINE_ROTATION_ROW + i, j]
                + sine * link_table[first_row + SINE_ROTATION_ROW + i, j]
            )
        parent_joint = parent[j]
        for a in range(3):
            if parent_joint < 0:
                pose[j, POSE_POSITION_COLUMN + a] = link_table[first_row + JOINT_ORIGIN_ROW + a, j]
                for b in range(3):
                    pose[j, POSE_ROTATION_COLUMN + 3 * a + b] = turn[3 * a + b]
            else:
                first_element = pose[parent_joint, POSE_ROTATION_COLUMN + 3 * a]
                second_element = pose[parent_joint, POSE_ROTATION_COLUMN + 3 * a + 1]
                third_element = pose[parent_joint, POSE_ROTATION_COLUMN + 3 * a + 2]
                for b in range(3):
                    pose[j, POSE_ROTATION_COLUMN + 3 * a + b] = (
                        first_element * turn[b]
                        + second_element * turn[3 + b]
                        + third_element * turn[6 + b]
                    )
                pose[j, POSE_POSITION_COLUMN + a] = (
                    pose[parent_joint, POSE_POSITION_COLUMN + a]
                    + first_element * link_table[first_row + JOINT_ORIGIN_ROW, j]
                    + second_element * link_table[first_row + JOINT_ORIGIN_ROW + 1, j]
                    + third_element * link_table[first_row + JOINT_ORIGIN_ROW + 2, j]
                )
            pose[j, POSE_AXIS_COLUMN + a] = _palm_frame_component(
                link_table, first_row + JOINT_AXIS_ROW, pose, j, a
            )
            if link_table[first_row + IS_PRISMATIC_ROW, j] != 0.0:
                pose[j, POSE_POSITION_COLUMN + a] += q[j] * pose[j, POSE_AXIS_COLUMN + a]
        pose[j, POSE_PRISMATIC_COLUMN] = link_table[first_row + IS_PRISMATIC_ROW, j]


@kernel_helper
def _palm_frame_component(
    link_table: Array, first_row: int, pose: Array, j: int, axis_index: int
) -> float:
    """Return one component, in the palm frame, of a vector that the table gives in the frame of link j."""
    x_product = pose[j, POSE_ROTATION_COLUMN + 3 * axis_index] * link_table[first_row, j]
    y_product = pose[j, POSE_ROTATION_COLUMN + 3 * axis_index + 1] * link_table[first_row + 1, j]
    z_product = pose[j, POSE_ROTATION_COLUMN + 3 * axis_index + 2] * link_table[first_row + 2, j]
    return x_product + y_product + z_product


@kernel_helper
def write_carried_masses(
    link_table: Array, first_row: int, parent: IndexArray, pose: Array
) -> None:
    """Write the mass that each link carries, and the first moment of this mass, for given poses."""
    for j in range(len(pose)):
        pose[j, CARRIED_MASS_COLUMN] = link_table[first_row + LINK_MASS_ROW, j]
        for a in range(3):
            moment = _palm_frame_component(
                link_table, first_row + LINK_FIRST_MOMENT_ROW, pose, j, a
            )
            pose[j, CARRIED_MOMENT_COLUMN + a] = (
                link_table[first_row + LINK_MASS_ROW, j] * pose[j, POSE_POSITION_COLUMN + a]
                + moment
            )
    # The loop goes through the links from the tips to the palm.
    for j in range(len(pose) - 1, -1, -1):
        parent_joint = parent[j]
        if parent_joint >= 0:
            for i in range(CARRIED_MASS_COLUMN, CARRIED_MOMENT_COLUMN + 3):
                pose[parent_joint, i] += pose[j, i]


@kernel_helper
def write_weight_torques(
    link_table: Array,
    first_row: int,
    parent: IndexArray,
    gravity: Array,
    pose: Array,
    torque: Array,
) -> None:
    """Write the joint torques (n,) [N m] that balance the weight of the links, for given poses.

    Args:
        link_table: array with the table of links, see ``write_link_poses``.
        first_row: see ``write_link_poses``.
        parent: see ``write_link_poses``.
        gravity: (3,) gravity in the palm frame [m/s2].
        pose: (n, POSE_COLUMN_COUNT) poses. The carried masses in the poses are overwritten.
        torque: (n,) array for the joint torques.
    """
    write_carried_masses(link_table, first_row, parent, pose)
    for j in range(len(pose)):
        mass = pose[j, CARRIED_MASS_COLUMN]
        x = pose[j, CARRIED_MOMENT_COLUMN] - mass * pose[j, POSE_POSITION_COLUMN]
        y = pose[j, CARRIED_MOMENT_COLUMN + 1] - mass * pose[j, POSE_POSITION_COLUMN + 1]
        z = pose[j, CARRIED_MOMENT_COLUMN + 2] - mass * pose[j, POSE_POSITION_COLUMN + 2]
        if pose[j, POSE_PRISMATIC_COLUMN] != 0.0:
            torque[j] = -mass * (
                pose[j, POSE_AXIS_COLUMN] * gravity[0]
                + pose[j, POSE_AXIS_COLUMN + 1] * gravity[1]
                + pose[j, POSE_AXIS_COLUMN + 2] * gravity[2]
            )
            continue
        # The weight of the carried links makes the torque (first moment) x gravity about the axis
        # of the joint. The torque with the opposite sign balances the weight.
        torque[j] = -(
            pose[j, POSE_AXIS_COLUMN] * (y * gravity[2] - z * gravity[1])
            + pose[j, POSE_AXIS_COLUMN + 1] * (z * gravity[0] - x * gravity[2])
            + pose[j, POSE_AXIS_COLUMN + 2] * (x * gravity[1] - y * gravity[0])
        )


@kernel_helper
def write_levers(
    pose: Array, first_joint: int, touched_link: int, distance_from_joint: float, levers_m: Array
) -> None:
    """Write the lever arms [m] of a force on a link, about each joint from ``first_joint`` to the joint of the link.

    The force on the link acts at a point on the link's x axis. The direction of the force is the
    link's y axis, which points in the direction of flexion.

    Args:
        pose: (n, POSE_COLUMN_COUNT) poses.
        first_joint: first joint of the chain.
        touched_link: index of the link on which the force acts.
        distance_from_joint: distance between the joint of the link and the point [m].
        levers_m: (n,) array for the lever arms, from ``first_joint`` to ``touched_link``.
    """
    px = (
        pose[touched_link, POSE_POSITION_COLUMN]
        + distance_from_joint * pose[touched_link, POSE_ROTATION_COLUMN]
    )
    py = (
        pose[touched_link, POSE_POSITION_COLUMN + 1]
        + distance_from_joint * pose[touched_link, POSE_ROTATION_COLUMN + 3]
    )
    pz = (
        pose[touched_link, POSE_POSITION_COLUMN + 2]
        + distance_from_joint * pose[touched_link, POSE_ROTATION_COLUMN + 6]
    )
    nx, ny, nz = (
        pose[touched_link, POSE_ROTATION_COLUMN + 1],
        pose[touched_link, POSE_ROTATION_COLUMN + 4],
        pose[touched_link, POSE_ROTATION_COLUMN + 7],
    )
    for j in range(first_joint, touched_link + 1):
        levers_m[j] = _lever_about_joint(pose, j, px, py, pz, nx, ny, nz)


@kernel_helper
def _lever_about_joint(
    pose: Array, j: int, px: float, py: float, pz: float, nx: float, ny: float, nz: float
) -> float:
    """Return the lever arm about joint j of a force that acts at the point p [m] in the direction of the unit vector n.

    With the position and the axis of a hinge, the lever arm is axis . ((p - position) x n) [m]. For
    a prismatic joint, the lever arm is axis . n, without unit.
    """
    if pose[j, POSE_PRISMATIC_COLUMN] != 0.0:
        return (
            pose[j, POSE_AXIS_COLUMN] * nx
            + pose[j, POSE_AXIS_COLUMN + 1] * ny
            + pose[j, POSE_AXIS_COLUMN + 2] * nz
        )
    x, y, z = (
        px - pose[j, POSE_POSITION_COLUMN],
        py - pose[j, POSE_POSITION_COLUMN + 1],
        pz - pose[j, POSE_POSITION_COLUMN + 2],
    )
    return (
        pose[j, POSE_AXIS_COLUMN] * (y * nz - z * ny)
        + pose[j, POSE_AXIS_COLUMN + 1] * (z * nx - x * nz)
        + pose[j, POSE_AXIS_COLUMN + 2] * (x * ny - y * nx)
    )


@kernel_helper
def write_levers_after_turn(
    pose: Array,
    first_joint: int,
    last_joint: int,
    distance_from_joint: float,
    turning_joint: int,
    angle: float,
    levers_m: Array,
) -> None:
    """Write the lever arms of a force on the last link of a chain, after one joint of the chain has turned.

    The docstring of ``write_levers`` defines the lever arms. The links beyond the turned joint turn
    together with the force. The lever arms about joints beyond the turned joint therefore stay the
    same.

    Args:
        pose: (n, POSE_COLUMN_COUNT) poses.
        first_joint: first joint of the chain.
        last_joint: index of the last link of the chain, on which the force acts.
        distance_from_joint: distance between the joint of the last link and the point [m].
        turning_joint: joint that turns.
        angle: angle of the turn [rad]. For a prismatic joint, the distance by which the joint
            slides [m].
        levers_m: (n,) lever arms before the turn, modified in place up to the turned joint.
    """
    ax, ay, az = (
        pose[turning_joint, POSE_AXIS_COLUMN],
        pose[turning_joint, POSE_AXIS_COLUMN + 1],
        pose[turning_joint, POSE_AXIS_COLUMN + 2],
    )
    nx, ny, nz = (
        pose[last_joint, POSE_ROTATION_COLUMN + 1],
        pose[last_joint, POSE_ROTATION_COLUMN + 4],
        pose[last_joint, POSE_ROTATION_COLUMN + 7],
    )
    x = (
        pose[last_joint, POSE_POSITION_COLUMN]
        + distance_from_joint * pose[last_joint, POSE_ROTATION_COLUMN]
        - pose[turning_joint, POSE_POSITION_COLUMN]
    )
    y = (
        pose[last_joint, POSE_POSITION_COLUMN + 1]
        + distance_from_joint * pose[last_joint, POSE_ROTATION_COLUMN + 3]
        - pose[turning_joint, POSE_POSITION_COLUMN + 1]
    )
    z = (
        pose[last_joint, POSE_POSITION_COLUMN + 2]
        + distance_from_joint * pose[last_joint, POSE_ROTATION_COLUMN + 6]
        - pose[turning_joint, POSE_POSITION_COLUMN + 2]
    )
    if pose[turning_joint, POSE_PRISMATIC_COLUMN] != 0.0:
        x, y, z = x + angle * ax, y + angle * ay, z + angle * az
    else:
        nx, ny, nz = _rotated_vector(ax, ay, az, angle, nx, ny, nz)
        x, y, z = _rotated_vector(ax, ay, az, angle, x, y, z)
    px, py, pz = (
        pose[turning_joint, POSE_POSITION_COLUMN] + x,
        pose[turning_joint, POSE_POSITION_COLUMN + 1] + y,
        pose[turning_joint, POSE_POSITION_COLUMN + 2] + z,
    )
    for j in range(first_joint, turning_joint + 1):
        levers_m[j] = _lever_about_joint(pose, j, px, py, pz, nx, ny, nz)


@kernel_helper
def _rotated_vector(
    ax: float, ay: float, az: float, angle: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return the vector (x, y, z) after a turn about a unit axis by an angle [rad].

    Source: Rodrigues' formula.
    """
    cosine = math.cos(angle)
    sine = math.sin(angle)
    axial_factor = (1.0 - cosine) * (ax * x + ay * y + az * z)
    return (
        x * cosine + (ay * z - az * y) * sine + ax * axial_factor,
        y * cosine + (az * x - ax * z) * sine + ay * axial_factor,
        z * cosine + (ax * y - ay * x) * sine + az * axial_factor,
    )


@kernel_helper
def write_newton_euler(
    link_table: Array,
    first_row: int,
    parent: IndexArray,
    gravity: Array,
    q: Array,
    dq: Array,
    ddq: Array,
    torque: Array,
) -> None:
    """Write the joint torques (n,) [N m] that a motion requires because of inertia and weight, M q'' + C q' + g.

    Args:
        link_table: array with the table of links, see ``write_link_poses``.
        first_row: see ``write_link_poses``.
        parent: see ``write_link_poses``.
        gravity: (3,) gravity in the palm frame [m/s2].
        q: (n,) joint angles [rad].
        dq: (n,) joint rates [rad/s].
        ddq: (n,) joint accelerations [rad/s2].
        torque: (n,) array for the joint torques.
    """
    motion_table = np.empty((len(q), _MOTION_TABLE_COLUMN_COUNT))
    for j in range(len(q)):
        _move_link(link_table, first_row, parent[j], gravity, q[j], dq[j], ddq[j], motion_table, j)
        _load_link(link_table, first_row, motion_table, j)
    # The loop goes through the links from the tips to the palm, because each joint carries the
    # forces of its link and of all links beyond it.
    for j in range(len(q) - 1, -1, -1):
        load = (
            _FORCE_COLUMN if link_table[first_row + IS_PRISMATIC_ROW, j] != 0.0 else _TORQUE_COLUMN
        )
        torque[j] = (
            link_table[first_row + JOINT_AXIS_ROW, j] * motion_table[j, load]
            + link_table[first_row + JOINT_AXIS_ROW + 1, j] * motion_table[j, load + 1]
            + link_table[first_row + JOINT_AXIS_ROW + 2, j] * motion_table[j, load + 2]
            + link_table[first_row + JOINT_ARMATURE_ROW, j] * ddq[j]
        )
        parent_joint = parent[j]
        if parent_joint >= 0:
            _add_load_to_parent(motion_table, j, parent_joint)


@kernel_helper
def _move_link(
    link_table: Array,
    first_row: int,
    parent_link: int,
    gravity: Array,
    q: float,
    dq: float,
    ddq: float,
    motion_table: Array,
    j: int,
) -> None:
    """Write the motion of link j, in the frame of the link.

    The motion of a link consists of the rotation to the parent link, the rate, the angular
    acceleration, and the acceleration minus gravity.
    """
    cosine = math.cos(q)
    sine = math.sin(q)
    for i in range(9):
        motion_table[j, i] = (
            link_table[first_row + FIXED_ROTATION_ROW + i, j]
            + cosine * link_table[first_row + COSINE_ROTATION_ROW + i, j]
            + sine * link_table[first_row + SINE_ROTATION_ROW + i, j]
        )
    ax, ay, az = (
        link_table[first_row + JOINT_AXIS_ROW, j],
        link_table[first_row + JOINT_AXIS_ROW + 1, j],
        link_table[first_row + JOINT_AXIS_ROW + 2, j],
    )
    prismatic = link_table[first_row + IS_PRISMATIC_ROW, j] != 0.0
    for a in range(3):
        motion_table[j, _ORIGIN_COLUMN + a] = link_table[first_row + JOINT_ORIGIN_ROW + a, j]
        if prismatic:
            motion_table[j, _ORIGIN_COLUMN + a] += q * (
                motion_table[j, 3 * a] * ax
                + motion_table[j, 3 * a + 1] * ay
                + motion_table[j, 3 * a + 2] * az
            )
    wx, wy, wz = 0.0, 0.0, 0.0
    tx, ty, tz = 0.0, 0.0, 0.0
    # An acceleration of the palm in the direction opposite to gravity has the same effect as
    # gravity.
    mx, my, mz = -gravity[0], -gravity[1], -gravity[2]
    if parent_link >= 0:
        wx, wy, wz = (
            motion_table[parent_link, _ANGULAR_VELOCITY_COLUMN],
            motion_table[parent_link, _ANGULAR_VELOCITY_COLUMN + 1],
            motion_table[parent_link, _ANGULAR_VELOCITY_COLUMN + 2],
        )
        tx, ty, tz = (
            motion_table[parent_link, _ANGULAR_ACCELERATION_COLUMN],
            motion_table[parent_link, _ANGULAR_ACCELERATION_COLUMN + 1],
            motion_table[parent_link, _ANGULAR_ACCELERATION_COLUMN + 2],
        )
        ox, oy, oz = (
            motion_table[j, _ORIGIN_COLUMN],
            motion_table[j, _ORIGIN_COLUMN + 1],
            motion_table[j, _ORIGIN_COLUMN + 2],
        )
        # The acceleration of the point o, at which the joint is, is a + t x o + w x (w x o).
        ux, uy, uz = wy * oz - wz * oy, wz * ox - wx * oz, wx * oy - wy * ox
        mx = (
            motion_table[parent_link, _ACCELERATION_COLUMN]
            + (ty * oz - tz * oy)
            + (wy * uz - wz * uy)
        )
        my = (
            motion_table[parent_link, _ACCELERATION_COLUMN + 1]
            + (tz * ox - tx * oz)
            + (wz * ux - wx * uz)
        )
        mz = (
            motion_table[parent_link, _ACCELERATION_COLUMN + 2]
            + (tx * oy - ty * ox)
            + (wx * uy - wy * ux)
        )
    for a in range(3):
        # The transposed rotation transforms a vector from the frame of the parent to the frame of
        # the link.
        motion_table[j, _ANGULAR_VELOCITY_COLUMN + a] = (
            motion_table[j, a] * wx + motion_table[j, 3 + a] * wy + motion_table[j, 6 + a] * wz
        )
        motion_table[j, _ANGULAR_ACCELERATION_COLUMN + a] = (
            motion_table[j, a] * tx + motion_table[j, 3 + a] * ty + motion_table[j, 6 + a] * tz
        )
        motion_table[j, _ACCELERATION_COLUMN + a] = (
            motion_table[j, a] * mx + motion_table[j, 3 + a] * my + motion_table[j, 6 + a] * mz
        )
    wx, wy, wz = (
        motion_table[j, _ANGULAR_VELOCITY_COLUMN],
        motion_table[j, _ANGULAR_VELOCITY_COLUMN + 1],
        motion_table[j, _ANGULAR_VELOCITY_COLUMN + 2],
    )
    if prismatic:
        # A link that slides in a turning frame has the additional acceleration a q'' + 2 w x (a
        # q').
        motion_table[j, _ACCELERATION_COLUMN] += ax * ddq + 2.0 * (wy * az - wz * ay) * dq
        motion_table[j, _ACCELERATION_COLUMN + 1] += ay * ddq + 2.0 * (wz * ax - wx * az) * dq
        motion_table[j, _ACCELERATION_COLUMN + 2] += az * ddq + 2.0 * (wx * ay - wy * ax) * dq
        return
    motion_table[j, _ANGULAR_ACCELERATION_COLUMN] += ax * ddq + (wy * az - wz * ay) * dq
    motion_table[j, _ANGULAR_ACCELERATION_COLUMN + 1] += ay * ddq + (wz * ax - wx * az) * dq
    motion_table[j, _ANGULAR_ACCELERATION_COLUMN + 2] += az * ddq + (wx * ay - wy * ax) * dq
    motion_table[j, _ANGULAR_VELOCITY_COLUMN] += ax * dq
    motion_table[j, _ANGULAR_VELOCITY_COLUMN + 1] += ay * dq
    motion_table[j, _ANGULAR_VELOCITY_COLUMN + 2] += az * dq


@kernel_helper
def _load_link(link_table: Array, first_row: int, motion_table: Array, j: int) -> None:
    """Write the force and the torque at the joint of link j that the motion of the link requires."""
    mass = link_table[first_row + LINK_MASS_ROW, j]
    hx, hy, hz = (
        link_table[first_row + LINK_FIRST_MOMENT_ROW, j],
        link_table[first_row + LINK_FIRST_MOMENT_ROW + 1, j],
        link_table[first_row + LINK_FIRST_MOMENT_ROW + 2, j],
    )
    wx, wy, wz = (
        motion_table[j, _ANGULAR_VELOCITY_COLUMN],
        motion_table[j, _ANGULAR_VELOCITY_COLUMN + 1],
        motion_table[j, _ANGULAR_VELOCITY_COLUMN + 2],
    )
    tx, ty, tz = (
        motion_table[j, _ANGULAR_ACCELERATION_COLUMN],
        motion_table[j, _ANGULAR_ACCELERATION_COLUMN + 1],
        motion_table[j, _ANGULAR_ACCELERATION_COLUMN + 2],
    )
    mx, my, mz = (
        motion_table[j, _ACCELERATION_COLUMN],
        motion_table[j, _ACCELERATION_COLUMN + 1],
        motion_table[j, _ACCELERATION_COLUMN + 2],
    )
    # The required force is m a + t x h + w x (w x h).
    ux, uy, uz = wy * hz - wz * hy, wz * hx - wx * hz, wx * hy - wy * hx
    motion_table[j, _FORCE_COLUMN] = mass * mx + (ty * hz - tz * hy) + (wy * uz - wz * uy)
    motion_table[j, _FORCE_COLUMN + 1] = mass * my + (tz * hx - tx * hz) + (wz * ux - wx * uz)
    motion_table[j, _FORCE_COLUMN + 2] = mass * mz + (tx * hy - ty * hx) + (wx * uy - wy * ux)
    xx, yy, zz = (
        link_table[first_row + LINK_INERTIA_ROW, j],
        link_table[first_row + LINK_INERTIA_ROW + 1, j],
        link_table[first_row + LINK_INERTIA_ROW + 2, j],
    )
    xy, xz, yz = (
        link_table[first_row + LINK_INERTIA_ROW + 3, j],
        link_table[first_row + LINK_INERTIA_ROW + 4, j],
        link_table[first_row + LINK_INERTIA_ROW + 5, j],
    )
    # The required torque is I t + w x (I w) + h x a.
    lx, ly, lz = (
        xx * wx + xy * wy + xz * wz,
        xy * wx + yy * wy + yz * wz,
        xz * wx + yz * wy + zz * wz,
    )
    motion_table[j, _TORQUE_COLUMN] = (
        xx * tx + xy * ty + xz * tz + (wy * lz - wz * ly) + (hy * mz - hz * my)
    )
    motion_table[j, _TORQUE_COLUMN + 1] = (
        xy * tx + yy * ty + yz * tz + (wz * lx - wx * lz) + (hz * mx - hx * mz)
    )
    motion_table[j, _TORQUE_COLUMN + 2] = (
        xz * tx + yz * ty + zz * tz + (wx * ly - wy * lx) + (hx * my - hy * mx)
    )


@kernel_helper
def _add_load_to_parent(motion_table: Array, j: int, parent_link: int) -> None:
    """Add the force and the torque of link j to the force and the torque of the parent link."""
    fx, fy, fz = (
        motion_table[j, _FORCE_COLUMN],
        motion_table[j, _FORCE_COLUMN + 1],
        motion_table[j, _FORCE_COLUMN + 2],
    )
    nx, ny, nz = (
        motion_table[j, _TORQUE_COLUMN],
        motion_table[j, _TORQUE_COLUMN + 1],
        motion_table[j, _TORQUE_COLUMN + 2],
    )
    gx = motion_table[j, 0] * fx + motion_table[j, 1] * fy + motion_table[j, 2] * fz
    gy = motion_table[j, 3] * fx + motion_table[j, 4] * fy + motion_table[j, 5] * fz
    gz = motion_table[j, 6] * fx + motion_table[j, 7] * fy + motion_table[j, 8] * fz
    ox, oy, oz = (
        motion_table[j, _ORIGIN_COLUMN],
        motion_table[j, _ORIGIN_COLUMN + 1],
        motion_table[j, _ORIGIN_COLUMN + 2],
    )
    motion_table[parent_link, _FORCE_COLUMN] += gx
    motion_table[parent_link, _FORCE_COLUMN + 1] += gy
    motion_table[parent_link, _FORCE_COLUMN + 2] += gz
    # The force f acts at the position o of the joint, so that the torque on the parent link is R n
    # + o x (R f).
    motion_table[parent_link, _TORQUE_COLUMN] += (
        motion_table[j, 0] * nx
        + motion_table[j, 1] * ny
        + motion_table[j, 2] * nz
        + (oy * gz - oz * gy)
    )
    motion_table[parent_link, _TORQUE_COLUMN + 1] += (
        motion_table[j, 3] * nx
        + motion_table[j, 4] * ny
        + motion_table[j, 5] * nz
        + (oz * gx - ox * gz)
    )
    motion_table[parent_link, _TORQUE_COLUMN + 2] += (
        motion_table[j, 6] * nx
        + motion_table[j, 7] * ny
        + motion_table[j, 8] * nz
        + (ox * gy - oy * gx)
    )


@kernel("matrix", "counts", "vector")
def link_poses(link_table: Array, parent: IndexArray, q: Array) -> Array:
    """Return the poses and the carried masses (n, POSE_COLUMN_COUNT) of all links at joint angles q (n,) [rad]."""
    pose = np.empty((len(q), POSE_COLUMN_COUNT))
    write_link_poses(link_table, 0, parent, q, pose)
    write_carried_masses(link_table, 0, parent, pose)
    return pose


@kernel("matrix", "counts", "vector", "vector")
def weight_torques(link_table: Array, parent: IndexArray, gravity: Array, q: Array) -> Array:
    """Return the joint torques (n,) [N m] that balance the weight of the links, see ``write_weight_torques``."""
    pose = np.empty((len(q), POSE_COLUMN_COUNT))
    torque = np.empty(len(q))
    write_link_poses(link_table, 0, parent, q, pose)
    write_weight_torques(link_table, 0, parent, gravity, pose, torque)
    return torque


@kernel("matrix", "counts", "vector", "vector", "vector", "vector")
def rigid_body_torques(
    link_table: Array, parent: IndexArray, gravity: Array, q: Array, dq: Array, ddq: Array
) -> Array:
    """Return the joint torques (n,) [N m] that inertia and weight require, see ``write_newton_euler``."""
    torque = np.empty(len(q))
    write_newton_euler(link_table, 0, parent, gravity, q, dq, ddq, torque)
    return torque


@kernel("matrix", "counts", "vector")
def inertia_matrix(link_table: Array, parent: IndexArray, q: Array) -> Array:
    """Return the mass matrix (n, n) at joint angles q (n,) [rad], including the armature [kg m2].

    Column k of the mass matrix contains the joint torques for a unit acceleration of joint k, at
    rest and without gravity. The mass matrix is exactly symmetric, because its lower triangle is a
    copy of its upper triangle.
    """
    n = len(q)
    zero_rates = np.zeros(max(n, 3))
    unit = np.zeros(n)
    mass_matrix = np.empty((n, n))
    for k in range(n):
        unit[k] = 1.0
        write_newton_euler(link_table, 0, parent, zero_rates, q, zero_rates, unit, mass_matrix[k])
        unit[k] = 0.0
    for k in range(n):
        for i in range(k):
            mass_matrix[k, i] = mass_matrix[i, k]
    return mass_matrix


@kernel("matrix", "counts", "vector", "count", "real")
def tip_levers(
    link_table: Array, parent: IndexArray, q: Array, touched_link: int, distance_from_joint: float
) -> Array:
    """Return the lever arms (n,) [m] of a force on a link about the joints of its chain, see ``write_levers``.

    The lever arms about joints beyond the touched link are 0.
    """
    pose = np.empty((len(q), POSE_COLUMN_COUNT))
    lever = np.zeros(len(q))
    write_link_poses(link_table, 0, parent, q, pose)
    write_levers(pose, 0, touched_link, distance_from_joint, lever)
    return lever
