"""Names of joint positions in LeRobot datasets. Each name contains the unit.

The same names are used by the export of datasets, by the reader of datasets, and by the plug-in
``lerobot_robot_handctl``.
"""

from collections.abc import Collection, Iterable

ANGLE_SUFFIX = ".pos_rad"
"""End of the name of an element that contains the angle of a hinge [rad]."""
PRISMATIC_SUFFIX = ".pos_m"
"""End of the name of an element that contains the position of a prismatic joint [m]."""


def position_names(joints: Iterable[str], prismatic: Collection[str]) -> tuple[str, ...]:
    """Return the name of the element with the position of each joint, e.g.

    ``index_j1.pos_rad``.

    Args:
        joints: names of the joints, in order.
        prismatic: names of the prismatic joints among them.
    """
    return tuple(
        f"{joint}{PRISMATIC_SUFFIX if joint in prismatic else ANGLE_SUFFIX}" for joint in joints
    )
