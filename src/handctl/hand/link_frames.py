"""Frames of a digit's links, given in the palm frame, for viewers and ROS."""

import math
from typing import NamedTuple

import numpy as np

from handctl.hand.digit import Array, DigitModel, JointValues
from handctl.hand.kinematics import joint_points, link_poses, link_rotations


class FrameTransform(NamedTuple):
    """Pose of a link frame, given in the palm frame.

    The position of the frame is in m. The components of the unit quaternion have the order of ROS
    (x, y, z, w).
    """

    frame: str
    position: tuple[float, float, float]
    quaternion_xyzw: tuple[float, float, float, float]


def link_transforms(digit: DigitModel, q: JointValues) -> tuple[FrameTransform, ...]:
    """Return the frames of all links and of the tip of a digit, in the palm frame.

    The origin of the frame ``<digit>_link1`` is at the first joint, and its x axis is along the
    first link. The frames of all further links are defined in the same way as the frame of the
    first link. The last frame is ``<digit>_tip``.
    """
    poses = link_poses(digit, q)
    # The frame of the tip has the same rotation as the last link.
    names = [*(f"{digit.name}_link{i + 1}" for i in range(digit.joint_count)), f"{digit.name}_tip"]
    turned_quaternions = [quaternion_of_rotation(rotation) for rotation in link_rotations(poses)]
    return tuple(
        FrameTransform(name, (position[0], position[1], position[2]), turn)
        for name, position, turn in zip(
            names,
            joint_points(digit, q).tolist(),
            [*turned_quaternions, turned_quaternions[-1]],
            strict=True,
        )
    )


def quaternion_of_rotation(rotation: Array) -> tuple[float, float, float, float]:
    """Return the unit quaternion (x, y, z, w) of a rotation matrix (3, 3).

    The function calculates the largest component first, so that no number is divided by a number
    near zero. Source: Shepperd (1978).
    """
    trace = float(np.trace(rotation))
    # The entries of ``squared_components`` are four times the squares of x, y, z and w.
    squared_components = [*(1.0 - trace + 2.0 * np.diag(rotation)).tolist(), 1.0 + trace]
    largest = max(range(4), key=squared_components.__getitem__)
    (_, xy, xz), (yx, _, yz), (zx, zy, _) = rotation.tolist()
    rows = (
        (squared_components[0], xy + yx, xz + zx, zy - yz),
        (xy + yx, squared_components[1], yz + zy, xz - zx),
        (xz + zx, yz + zy, squared_components[2], yx - xy),
        (zy - yz, xz - zx, yx - xy, squared_components[3]),
    )
    x, y, z, w = (entry / (2.0 * math.sqrt(squared_components[largest])) for entry in rows[largest])
    return x, y, z, w
