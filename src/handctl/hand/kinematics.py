"""Kinematics of a digit in the palm frame: positions of links and tip, and Jacobians.

The frame of a digit is the frame of its mount. At joint angles of zero, the x axis of the digit's
frame points along the digit, and the y axis points in the direction of flexion.
"""

from typing import NamedTuple

import numpy as np

from handctl.hand import rigid_body
from handctl.hand.digit import Array, DigitModel, JointValues


class TipPose(NamedTuple):
    """Pose of the tip of a digit in the palm frame: position (3,) [m], and rotation (3, 3) of the last link."""

    position: Array
    rotation: Array


def link_poses(digit: DigitModel, q: JointValues) -> Array:
    """Return the poses (n, rigid_body.POSE_COLUMN_COUNT) of a digit's links at joint angles q (n,) [rad]."""
    return rigid_body.link_poses(digit.table, digit.parent, np.asarray(q, dtype=np.float64))


def link_rotations(poses: Array) -> Array:
    """Return the rotations (n, 3, 3) from the frames of the links to the palm frame."""
    return poses[:, rigid_body.POSE_ROTATION_COLUMN : rigid_body.POSE_ROTATION_COLUMN + 9].reshape(
        -1, 3, 3
    )


def joint_positions(poses: Array) -> Array:
    """Return the positions (n, 3) [m] of the links' joints in the palm frame."""
    return poses[:, rigid_body.POSE_POSITION_COLUMN : rigid_body.POSE_POSITION_COLUMN + 3]


def joint_points(digit: DigitModel, q: JointValues) -> Array:
    """Return the positions (n + 1, 3) [m] of the joints and of the tip in the palm frame, in order from palm to tip."""
    poses = link_poses(digit, q)
    tip = joint_positions(poses)[-1] + digit.lengths[-1] * link_rotations(poses)[-1, :, 0]
    return np.vstack((joint_positions(poses), tip))


def forward_kinematics(digit: DigitModel, q: JointValues) -> TipPose:
    """Return the pose of the tip of a digit at joint angles q (n,) [rad]."""
    return TipPose(joint_points(digit, q)[-1], link_rotations(link_poses(digit, q))[-1])


def point_jacobian(
    digit: DigitModel, q: JointValues, link: int, distance_from_joint: float
) -> Array:
    """Return the Jacobian (3, n) [m] of a point on a link.

    Column j of the Jacobian is the velocity of the point for a unit velocity of joint j.

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        link: index of the link, counted from 0.
        distance_from_joint: distance between the joint of the link and the point, along the link [m].

    The column of a prismatic joint in the Jacobian has no unit.
    """
    poses = link_poses(digit, q)
    point_on_link = (
        joint_positions(poses)[link] + distance_from_joint * link_rotations(poses)[link, :, 0]
    )
    axes = poses[:, rigid_body.POSE_AXIS_COLUMN : rigid_body.POSE_AXIS_COLUMN + 3]
    revolute_columns = np.cross(axes, point_on_link - joint_positions(poses))
    jacobian = np.where(digit.is_prismatic[:, None], axes, revolute_columns).T
    # Joints beyond the link ``link`` do not move the point.
    jacobian[:, link + 1 :] = 0.0
    return np.asarray(jacobian)


def tip_jacobian(digit: DigitModel, q: JointValues) -> Array:
    """Return the Jacobian (3, n) [m] of the tip of a digit.

    Column j of the Jacobian is the velocity of the tip for a unit velocity of joint j.
    """
    return point_jacobian(digit, q, digit.joint_count - 1, digit.lengths[-1])


def to_palm_frame(digit: DigitModel, positions: Array) -> Array:
    """Transform points (.., 3) [m] from the frame of a digit to the palm frame."""
    return positions @ digit.mount_rotation.T + digit.mount_position


def from_palm_frame(digit: DigitModel, position: JointValues) -> Array:
    """Transform points (.., 3) [m] from the palm frame to the frame of a digit."""
    return np.asarray((np.asarray(position) - digit.mount_position) @ digit.mount_rotation)
