"""Names of joint positions in LeRobot datasets. Each name contains the unit.

The export of datasets, the reader of datasets, and the plug-in ``lerobot_robot_handctl`` use the
same names of joint positions.
"""

from collections.abc import Collection, Iterable

ANGLE_SUFFIX = ".pos_rad"
"""End of the name of an element that contains the angle of a hinge [rad]."""
PRISMATIC_SUFFIX = ".pos_m"
"""End of the name of an element that contains the position of a prismatic joint [m]."""


def position_names(joints: Iterable[str], prismatic_joints: Collection[str]) -> tuple[str, ...]:
    """Return the name of the vector element with the position of each joint, such as ``index_j1.pos_rad``.

    Args:
        joints: names of the joints, in order.
        prismatic_joints: names of those joints that are prismatic.
    """
    return tuple(
        f"{joint}{PRISMATIC_SUFFIX if joint in prismatic_joints else ANGLE_SUFFIX}"
        for joint in joints
    )
