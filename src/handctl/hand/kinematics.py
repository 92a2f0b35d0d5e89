"""Kinematics of a digit: positions of links and tip, and Jacobians.

Planar functions use the digit's frame: x along the straight digit, y to the side of flexion.
"""

import math
from typing import NamedTuple

import numpy as np

from handctl.hand.digit import Array, DigitModel, Values


class TipPose(NamedTuple):
    """Tip of a digit in its plane: position [m] and direction of the last link [rad]."""

    x: float
    y: float
    angle: float


def points(digit: DigitModel, q: Values) -> Array:
    """Return the joints from the palm outwards, then the tip, (n + 1, 2) [m]."""
    angles = np.cumsum(q)
    steps = np.array(digit.lengths)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    return np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))


def forward(digit: DigitModel, q: Values) -> TipPose:
    """Return the tip pose at joint angles q (n,) [rad]."""
    x, y = points(digit, q)[-1].tolist()
    return TipPose(x, y, float(np.sum(q)))


def point_jacobian(digit: DigitModel, q: Values, link: int, along: float) -> Array:
    """Return the velocity of a point of a link per joint velocity, (2, n) [m].

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        link: index of the link, from 0.
        along: distance of the point from the link's own joint, along the link [m].
    """
    joints = points(digit, q)
    angle = float(np.sum(np.asarray(q)[: link + 1]))
    arm = joints[link] + along * np.array([math.cos(angle), math.sin(angle)]) - joints[: link + 1]
    jacobian = np.zeros((2, digit.joint_count))
    # Planar rotation about each joint: z cross arm.
    jacobian[0, : link + 1] = -arm[:, 1]
    jacobian[1, : link + 1] = arm[:, 0]
    return jacobian


def tip_jacobian(digit: DigitModel, q: Values) -> Array:
    """Return the velocity of the tip per joint velocity, (2, n) [m]."""
    return point_jacobian(digit, q, digit.joint_count - 1, digit.lengths[-1])


def to_palm(digit: DigitModel, planar: Array) -> Array:
    """Transform points (.., 2) [m] of the digit's plane to the palm frame, (.., 3) [m]."""
    return planar @ digit.mount_rotation[:, :2].T + digit.mount_position


def from_palm(digit: DigitModel, position: Values) -> Array:
    """Project points (.., 3) [m] of the palm frame on the digit's plane, (.., 2) [m]."""
    return (np.asarray(position) - digit.mount_position) @ digit.mount_rotation[:, :2]


def palm_jacobian(digit: DigitModel, q: Values) -> Array:
    """Return the velocity of the tip in the palm frame per joint velocity, (3, n) [m]."""
    return digit.mount_rotation[:, :2] @ tip_jacobian(digit, q)
