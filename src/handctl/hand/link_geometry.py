"""Geometry and mass of a digit's links, in the frame of each link.

For each link, the module computes joint axis, orientation, centre of mass and inertia.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.hand.file.section_models import Digit

Array = NDArray[np.float64]

MIN_PITCH_COSINE = 1e-9
"""Cosine of the pitch below which roll and yaw cannot be separated."""


def joint_axes(digit: Digit) -> Array:
    """Return the unit vectors of the joints' axes in the links' frames, (n, 3)."""
    axes = np.array(digit.axes)
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def joint_rotations(digit: Digit) -> Array:
    """Return the rotation (n, 3, 3) from the frame of each link to the frame of the previous link.

    The rotation of a link is valid at a joint angle of zero. The rotation of the first link is
    relative to the frame of the mount.
    """
    turns = digit.joint_rpy_deg or [(0.0, 0.0, 0.0)] * len(digit.link_length_m)
    return np.array([rotation_of_rpy(*np.radians(turn)) for turn in turns])


def centre_of_mass(digit: Digit, i: int) -> Array:
    """Return the centre of mass (3,) [m] of link i in the frame of the link."""
    com = digit.link_com_m[i]
    return np.array([com, 0.0, 0.0] if isinstance(com, float) else com)


def link_inertia(digit: Digit, i: int) -> Array:
    """Return the inertia (3, 3) [kg m2] of link i about the centre of mass, in the frame of the link."""
    values = digit.link_inertia_kg_m2[i]
    if isinstance(values, float):
        # The inertia about the long axis of the link is that of a round bar. The triangle
        # inequality limits the inertia about the long axis to twice the inertia about an axis
        # across the link.
        axial_inertia = min(digit.link_mass_kg[i] * digit.link_radius_m**2 / 2, 2 * values)
        return np.diag([axial_inertia, values, values])
    xx, yy, zz, xy, xz, yz = values if len(values) == 6 else (*values, 0.0, 0.0, 0.0)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def link_placement(digit: Digit, i: int) -> tuple[Array, Array]:
    """Return the position (3,) [m] and the rotation (3, 3) of link i in the frame of the previous link.

    Position and rotation are valid at a joint angle of zero. The position of the first link is
    relative to the palm, or to the link that carries the digit.
    """
    rotation = joint_rotations(digit)[i]
    if i > 0:
        return np.array([digit.link_length_m[i - 1], 0.0, 0.0]), rotation
    mount = rotation_of_rpy(*np.radians(digit.mount_rpy_deg))
    return np.array(digit.mount_position_m), np.asarray(mount @ rotation)


def rpy_of_rotation(rotation: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw [rad] of a rotation (3, 3).

    This function is the inverse of ``rotation_of_rpy``. At a pitch of 90 degrees, only the sum or
    the difference of roll and yaw is defined. At a pitch of 90 degrees, the function sets the yaw
    to 0.
    """
    cosine_of_pitch = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], cosine_of_pitch)
    if cosine_of_pitch < MIN_PITCH_COSINE:
        return math.atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    return (
        math.atan2(rotation[2, 1], rotation[2, 2]),
        pitch,
        math.atan2(rotation[1, 0], rotation[0, 0]),
    )


def rotation_of_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Return the rotation (3, 3) for successive turns about the fixed axes x, y and z [rad].

    The rotation is the product Rz(yaw) Ry(pitch) Rx(roll), as in URDF.
    """
    cr = math.cos(roll)
    sr = math.sin(roll)
    cp = math.cos(pitch)
    sp = math.sin(pitch)
    cy = math.cos(yaw)
    sy = math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
