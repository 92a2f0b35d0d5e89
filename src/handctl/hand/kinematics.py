"""Kinematics of a digit: positions of links and tip, and Jacobians, in the palm frame.

The frame of a digit is that of its mount. At joint angles of zero, x points along the digit and y
to the side of flexion.
"""

from typing import NamedTuple

import numpy as np

from handctl.hand import rigid_body
from handctl.hand.digit import Array, DigitModel, JointValues


class TipPose(NamedTuple):
    """Pose of the tip of a digit in the palm frame: its position (3,) [m] and the rotation (3, 3) of the last link."""

    position: Array
    rotation: Array


def link_poses(digit: DigitModel, q: JointValues) -> Array:
    """Return the poses of a digit's links, (n, rigid_body.POSE_COLUMN_COUNT), at joint angles q (n,) [rad]."""
    return rigid_body.link_poses(digit.table, digit.parent, np.asarray(q, dtype=np.float64))


def link_rotations(poses: Array) -> Array:
    """Return the rotations from the frames of the links to the palm frame, (n, 3, 3)."""
    return poses[:, rigid_body.ROTATION_COLUMN : rigid_body.ROTATION_COLUMN + 9].reshape(-1, 3, 3)


def joint_positions(poses: Array) -> Array:
    """Return the positions of the links' joints in the palm frame, (n, 3) [m]."""
    return poses[:, rigid_body.POSITION_COLUMN : rigid_body.POSITION_COLUMN + 3]


def joint_points(digit: DigitModel, q: JointValues) -> Array:
    """Return the positions of the joints from the palm outwards and of the tip, in the palm frame, (n + 1, 3) [m]."""
    poses = link_poses(digit, q)
    tip = joint_positions(poses)[-1] + digit.lengths[-1] * link_rotations(poses)[-1, :, 0]
    return np.vstack((joint_positions(poses), tip))


def forward_kinematics(digit: DigitModel, q: JointValues) -> TipPose:
    """Return the pose of the tip of a digit at joint angles q (n,) [rad]."""
    return TipPose(joint_points(digit, q)[-1], link_rotations(link_poses(digit, q))[-1])


def point_jacobian(digit: DigitModel, q: JointValues, link: int, along: float) -> Array:
    """Return the Jacobian of a point of a link: velocity of the point per joint velocity, (3, n) [m].

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        link: index of the link, from 0.
        along: distance of the point from the joint of the link, along the link [m].

    The column of a prismatic joint has no unit.
    """
    poses = link_poses(digit, q)
    point = joint_positions(poses)[link] + along * link_rotations(poses)[link, :, 0]
    axes = poses[:, rigid_body.DIRECTION_COLUMN : rigid_body.DIRECTION_COLUMN + 3]
    turning = np.cross(axes, point - joint_positions(poses))
    jacobian = np.where(digit.is_prismatic[:, None], axes, turning).T
    # Joints farther out than the link do not move the point.
    jacobian[:, link + 1 :] = 0.0
    return np.asarray(jacobian)


def tip_jacobian(digit: DigitModel, q: JointValues) -> Array:
    """Return the Jacobian of the tip of a digit: velocity of the tip per joint velocity, (3, n) [m]."""
    return point_jacobian(digit, q, digit.joint_count - 1, digit.lengths[-1])


def to_palm_frame(digit: DigitModel, positions: Array) -> Array:
    """Transform points (.., 3) [m] from the digit's frame to the palm frame."""
    return positions @ digit.mount_rotation.T + digit.mount_position


def from_palm_frame(digit: DigitModel, position: JointValues) -> Array:
    """Transform points (.., 3) [m] from the palm frame to the digit's frame."""
    return np.asarray((np.asarray(position) - digit.mount_position) @ digit.mount_rotation)
