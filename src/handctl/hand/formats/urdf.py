"""Export of a hand as URDF with simple shapes, for viewers and dynamics libraries.

At joint angles of zero, the hand is open. Positive angles flex the digits. Each link is a bar along
the x axis of its frame.
"""

from collections.abc import Mapping
from xml.etree import ElementTree as ET

import numpy as np

from handctl.hand.description import Hand
from handctl.hand.digit import Array
from handctl.hand.file.section_models import PRISMATIC, Digit
from handctl.hand.formats.link_meshes import LinkMesh
from handctl.hand.formats.number_text import number_text, numbers_text
from handctl.hand.link_geometry import (
    centre_of_mass,
    joint_axes,
    link_inertia,
    link_placement,
    rpy_of_rotation,
)

INDICES_BY_INERTIA_ATTRIBUTE = {
    "xx": (0, 0),
    "yy": (1, 1),
    "zz": (2, 2),
    "xy": (0, 1),
    "xz": (0, 2),
    "yz": (1, 2),
}
"""Row and column in the inertia matrix of each attribute of URDF's ``inertia``."""
NO_MESHES: Mapping[str, LinkMesh] = {}
"""Empty dictionary of meshes, for a hand that is exported with simple shapes only."""
PALM_THICKNESS_M = 0.010
"""Depth of the box that represents the palm [m]. The front of the palm box is at x = 0."""
PALM_BOX_MARGIN_M = 0.010
"""Extent of the palm box beyond the mounts of the outermost digits [m]."""


def urdf_text(hand: Hand, mesh_of_link: Mapping[str, LinkMesh] = NO_MESHES) -> str:
    """Return the text of the URDF file of a hand.

    The root link is named ``palm``. The links have names such as ``index_link1``, the joints such
    as ``index_j1``, and the tips such as ``index_tip``.

    Args:
        hand: description of the hand.
        mesh_of_link: meshes by the name of the link, with paths relative to the URDF file. A mesh
            replaces the visual shape of its link.
    """
    robot = ET.Element("robot", name=hand.name)
    if mesh_of_link:
        # Without the option ``strippath``, MuJoCo would remove the folders from the paths of
        # meshes, and leave the meshes out.
        extension = ET.SubElement(robot, "mujoco")
        ET.SubElement(extension, "compiler", strippath="false", discardvisual="false")
    _add_palm(ET.SubElement(robot, "link", name="palm"), hand, None, mesh_of_link.get("palm"))
    for digit in hand.digit:
        for i in range(len(digit.link_length_m)):
            _add_joint(robot, hand, digit, i)
            _add_link(
                robot,
                digit,
                i,
                shape_length(hand, digit, i),
                mesh_of_link.get(f"{digit.name}_link{i + 1}"),
            )
        if digit.name in hand.carrier_digits:
            _add_palm(robot[-1], hand, digit.name, mesh_of_link.get(robot[-1].get("name", "")))
        _add_tip_frame(robot, digit)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def palm_box(hand: Hand, carrier: str | None) -> tuple[Array, Array]:
    """Return centre (3,) [m] and side lengths (3,) [m] of the box behind all digits that are mounted on a link.

    Args:
        hand: description of the hand.
        carrier: digit whose last link carries the digits, None for the palm.
    """
    mounts = np.array([digit.mount_position_m for digit in hand.digit if digit.mount_on == carrier])
    low = mounts.min(axis=0) - PALM_BOX_MARGIN_M
    high = mounts.max(axis=0) + PALM_BOX_MARGIN_M
    high[0] = 0.0 if carrier is None else mounts[:, 0].min()
    low[0] = high[0] - PALM_THICKNESS_M
    return (low + high) / 2, high - low


def shape_length(hand: Hand, digit: Digit, i: int) -> float:
    """Return the length [m] of the simple shape for link i.

    If the link carries digits, its shape is shorter by the radius of the shape. The round end of
    the shape then ends where the link ends.
    """
    length = digit.link_length_m[i]
    is_last = i == len(digit.link_length_m) - 1
    return (
        max(length - digit.link_radius_m, 0.0)
        if is_last and digit.name in hand.carrier_digits
        else length
    )


def _add_palm(
    link_element: ET.Element, hand: Hand, carrier: str | None, mesh: LinkMesh | None
) -> None:
    """Add a box behind all digits that a link carries.

    The box needs no mass, because the palm does not move.
    """
    centre, size = palm_box(hand, carrier)
    if mesh and carrier is None:
        _add_mesh(link_element, mesh)
    for element in _shape_elements(mesh):
        shape_element = ET.SubElement(link_element, element)
        ET.SubElement(shape_element, "origin", xyz=numbers_text(centre), rpy="0 0 0")
        ET.SubElement(ET.SubElement(shape_element, "geometry"), "box", size=numbers_text(size))


def _add_joint(robot_element: ET.Element, hand: Hand, digit: Digit, i: int) -> None:
    """Add the joint before link i.

    The torque and speed limits of the joint are computed from the tendons and motors.
    """
    name = digit.joints[i]
    joint_type = PRISMATIC if digit.is_prismatic[i] else "revolute"
    joint = ET.SubElement(robot_element, "joint", name=name, type=joint_type)
    ET.SubElement(
        joint, "parent", link=hand.base_link(digit) if i == 0 else f"{digit.name}_link{i}"
    )
    ET.SubElement(joint, "child", link=f"{digit.name}_link{i + 1}")
    position, rotation = link_placement(digit, i)
    # The addition of 0.0 converts -0.0 to 0.0.
    ET.SubElement(
        joint,
        "origin",
        xyz=numbers_text(position),
        rpy=numbers_text(np.add(rpy_of_rotation(rotation), 0.0)),
    )
    ET.SubElement(joint, "axis", xyz=numbers_text(joint_axes(digit)[i]))
    crossing_tendons = [tendon for tendon in hand.tendon if name in tendon.arms]
    arms = [
        abs(float(hand.moment_arms[hand.tendon.index(tendon), hand.joints.index(name)]))
        for tendon in crossing_tendons
    ]
    max_effort = sum(
        arm * tendon.tension_max_N for arm, tendon in zip(arms, crossing_tendons, strict=True)
    )
    motors = [
        (hand.motor_of_tendon(tendon.name), arm)
        for arm, tendon in zip(arms, crossing_tendons, strict=True)
    ]
    # The joint speed is the spool speed times the spool radius, divided by the moment arm. The
    # slowest tendon determines the limit of the joint. A prismatic joint has an effort in N and a
    # speed in m/s.
    low, high = digit.joint_limits
    damping = digit.joint_values("joint_damping_N_m_s_per_rad")[i]
    speed = min(motor.velocity_range_rad_s * motor.spool_radius_m / arm for motor, arm in motors)
    ET.SubElement(
        joint,
        "limit",
        lower=number_text(low[i]),
        upper=number_text(high[i]),
        effort=number_text(max_effort),
        velocity=number_text(speed),
    )
    ET.SubElement(joint, "dynamics", damping=number_text(damping), friction="0")
    if i in (leader_by_joint := coupled_joints(hand, digit)):
        leading_joint, ratio = leader_by_joint[i]
        ET.SubElement(
            joint, "mimic", joint=digit.joints[leading_joint], multiplier=number_text(ratio)
        )


def coupled_joints(hand: Hand, digit: Digit) -> dict[int, tuple[int, float]]:
    """Return for each coupled joint of a digit the joint that it follows, and the ratio of the two joint angles.

    The keys of the result are the indices of the coupled joints. Each value of the result contains
    the index of the leading joint, and the ratio. The coupling of a digit with spool pairs is
    rigid. In a digit without spool pairs, the springs determine the coupling. A coupling by springs
    is valid only in free motion, so the function returns no coupled joints for this digit. The
    result omits a joint that depends on several coordinates, because it follows no single joint.
    """
    if digit.coupling is None or not hand.is_pair[hand.digit_tendons[digit.name]].any():
        return {}
    coupling = np.array(digit.coupling)
    leaders: dict[int, int] = {}
    mimic_joints = {}
    for i, row in enumerate(coupling):
        columns = np.flatnonzero(row)
        if len(columns) != 1:
            continue
        k = int(columns[0])
        leading_joint = leaders.setdefault(k, i)
        if leading_joint != i:
            mimic_joints[i] = (leading_joint, float(row[k] / coupling[leading_joint, k]))
    return mimic_joints


def _shape_elements(mesh: LinkMesh | None) -> tuple[str, ...]:
    """Return the names of the URDF elements that contain the simple shape of a link.

    The visual shape of a link with a mesh is the mesh.
    """
    return ("collision",) if mesh else ("visual", "collision")


def _add_mesh(link_element: ET.Element, mesh: LinkMesh) -> None:
    """Add a mesh as the visual shape of a link."""
    visual = ET.SubElement(link_element, "visual")
    ET.SubElement(
        visual,
        "origin",
        xyz=numbers_text(mesh.position),
        rpy=numbers_text(np.radians(mesh.rpy_deg)),
    )
    ET.SubElement(
        ET.SubElement(visual, "geometry"),
        "mesh",
        filename=mesh.file,
        scale=numbers_text(mesh.scale),
    )


def _add_link(
    robot_element: ET.Element, digit: Digit, i: int, length: float, mesh: LinkMesh | None
) -> None:
    """Add link i of a digit, with the inertia of the link, to the element of the robot.

    The simple shape of a link is a cylinder of the given length [m] with a ball at the far end.
    """
    radius = digit.link_radius_m
    link = ET.SubElement(robot_element, "link", name=f"{digit.name}_link{i + 1}")
    inertial_element = ET.SubElement(link, "inertial")
    ET.SubElement(
        inertial_element, "origin", xyz=numbers_text(centre_of_mass(digit, i)), rpy="0 0 0"
    )
    ET.SubElement(inertial_element, "mass", value=number_text(digit.link_mass_kg[i]))
    moments = link_inertia(digit, i)
    values = {
        f"i{key}": number_text(moments[matrix_index])
        for key, matrix_index in INDICES_BY_INERTIA_ATTRIBUTE.items()
    }
    ET.SubElement(inertial_element, "inertia", values)
    if mesh:
        _add_mesh(link, mesh)
    for element in _shape_elements(mesh):
        if length > 0.0:
            bar = ET.SubElement(link, element)
            ET.SubElement(
                bar,
                "origin",
                xyz=numbers_text((length / 2, 0.0, 0.0)),
                rpy=f"0 {number_text(np.pi / 2)} 0",
            )
            ET.SubElement(
                ET.SubElement(bar, "geometry"),
                "cylinder",
                radius=number_text(radius),
                length=number_text(length),
            )
        ball = ET.SubElement(link, element)
        ET.SubElement(ball, "origin", xyz=numbers_text((length, 0.0, 0.0)), rpy="0 0 0")
        ET.SubElement(ET.SubElement(ball, "geometry"), "sphere", radius=number_text(radius))


def _add_tip_frame(robot_element: ET.Element, digit: Digit) -> None:
    """Add a link without mass at the end of the digit's last link."""
    last_link = len(digit.link_length_m)
    ET.SubElement(robot_element, "link", name=f"{digit.name}_tip")
    joint = ET.SubElement(robot_element, "joint", name=f"{digit.name}_tip_joint", type="fixed")
    ET.SubElement(joint, "parent", link=f"{digit.name}_link{last_link}")
    ET.SubElement(joint, "child", link=f"{digit.name}_tip")
    ET.SubElement(
        joint, "origin", xyz=numbers_text((digit.link_length_m[-1], 0.0, 0.0)), rpy="0 0 0"
    )
