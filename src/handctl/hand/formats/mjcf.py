"""Export of a hand as MJCF for MuJoCo: links, springs, stops and tendons with a controlled tension.

The world frame of the exported model is the palm frame. At joint angles of zero, the hand is open.
Positive angles flex the digits. Each control input is the tension of one tendon at the joint
pulleys [N]. The exported model contains no tendon elasticity, no friction and no rotors.
"""

from collections.abc import Mapping
from xml.etree import ElementTree as ET

import numpy as np

from handctl.hand.description import Hand
from handctl.hand.file.section_models import Digit
from handctl.hand.formats.link_meshes import LinkMesh
from handctl.hand.formats.number_text import number_text, numbers_text
from handctl.hand.formats.urdf import NO_MESHES, coupled_joints, palm_box, shape_length
from handctl.hand.link_frames import quaternion_of_rotation
from handctl.hand.link_geometry import centre_of_mass, joint_axes, link_inertia, link_placement

STOP_SOLVER_PARAMETERS = ("0.002 1", "0.99 0.9999 0.001")
"""Values of ``solreflimit`` and ``solimplimit`` that make the joint stops stiff.

With MuJoCo's default values, return springs push the light links 16 degrees past the joint stops.
"""


VISUAL_GEOM_GROUP = "2"
"""Group of the geoms that show meshes. Viewers show the groups 0 to 2."""
COLLISION_GEOM_GROUP = "3"
"""Group of the collision shapes of links with a mesh. Viewers do not show the geoms of group 3."""


def mjcf_text(hand: Hand, mesh_of_link: Mapping[str, LinkMesh] = NO_MESHES) -> str:
    """Return the text of the MJCF file of a hand.

    The bodies have names such as ``palm`` and ``index_link1``. The joints have names such as
    ``index_j1``, and the sites have names such as ``index_tip``.

    Args:
        hand: description of the hand.
        mesh_of_link: meshes by the name of the link, with paths relative to the MJCF file. Meshes
            have neither mass nor contacts.
    """
    root = ET.Element("mujoco", model=hand.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    gravity = numbers_text(hand.mount.gravity_m_s2)
    ET.SubElement(
        root,
        "option",
        gravity=gravity,
        timestep="0.0005",
        integrator="implicitfast",
        cone="elliptic",
    )
    palm = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name="palm")
    _add_palm(palm, hand, None)
    _add_couplings(root, hand)
    _add_tendons(root, hand)
    _add_meshes(root, mesh_of_link)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add_palm(link_element: ET.Element, hand: Hand, carrier: str | None) -> None:
    """Add the digits that are mounted on a link, and a box behind these digits.

    A digit does not collide with the box behind the digits.
    """
    centre, size = palm_box(hand, carrier)
    name = "palm" if carrier is None else f"{carrier}_palm"
    ET.SubElement(
        link_element,
        "geom",
        name=name,
        type="box",
        size=numbers_text(size / 2),
        pos=numbers_text(centre),
    )
    for digit in hand.digit:
        if digit.mount_on == carrier:
            _add_digit(link_element, hand, digit)


def _add_digit(base_element: ET.Element, hand: Hand, digit: Digit) -> None:
    """Add the links of a digit as nested bodies.

    Each link lies along the x axis of its frame, and its hinge is at the origin.
    """
    parent = base_element
    for i, joint in enumerate(digit.joints):
        position, rotation = link_placement(digit, i)
        # In MuJoCo, a quaternion begins with w.
        x, y, z, w = quaternion_of_rotation(rotation)
        link_pose = {"pos": numbers_text(position), "quat": numbers_text((w, x, y, z))}
        link = ET.SubElement(parent, "body", link_pose, name=f"{digit.name}_link{i + 1}")
        _add_joint(link, digit, i, joint)
        _add_link_body(link, digit, i, shape_length(hand, digit, i))
        parent = link
    ET.SubElement(
        parent,
        "site",
        name=f"{digit.name}_tip",
        pos=numbers_text((digit.link_length_m[-1], 0.0, 0.0)),
    )
    if digit.name in hand.carrier_digits:
        _add_palm(parent, hand, digit.name)


def _add_joint(link_element: ET.Element, digit: Digit, i: int, joint: str) -> None:
    """Add the hinge or slide joint between link i and the link before it."""
    low, high = digit.joint_limits
    kind = {"type": "slide"} if digit.is_prismatic[i] else {}
    ET.SubElement(
        link_element,
        "joint",
        kind,
        name=joint,
        axis=numbers_text(joint_axes(digit)[i]),
        range=numbers_text((low[i], high[i])),
        damping=number_text(digit.joint_values("joint_damping_N_m_s_per_rad")[i]),
        armature=number_text(digit.joint_values("joint_armature_kg_m2")[i]),
        stiffness=number_text(digit.joint_values("spring_stiffness_N_m_per_rad")[i]),
        # In MuJoCo, the torque of a spring is -k (q - springref). In a hand file, the torque of a
        # spring is -k (q + preload).
        springref=number_text(-digit.joint_values("spring_preload_rad")[i]),
        solreflimit=STOP_SOLVER_PARAMETERS[0],
        solimplimit=STOP_SOLVER_PARAMETERS[1],
    )


def _add_link_body(link_element: ET.Element, digit: Digit, i: int, length: float) -> None:
    """Add the inertia and the collision shape of link i.

    The collision shape of a link is a capsule, or a ball if the length [m] is 0.
    """
    moments = link_inertia(digit, i)
    ET.SubElement(
        link_element,
        "inertial",
        pos=numbers_text(centre_of_mass(digit, i)),
        mass=number_text(digit.link_mass_kg[i]),
        fullinertia=numbers_text([*np.diag(moments), moments[0, 1], moments[0, 2], moments[1, 2]]),
    )
    size = number_text(digit.link_radius_m)
    if length > 0.0:
        ET.SubElement(
            link_element,
            "geom",
            type="capsule",
            fromto=numbers_text((0, 0, 0, length, 0, 0)),
            size=size,
        )
    else:
        ET.SubElement(link_element, "geom", type="sphere", size=size)


def _add_meshes(model_root: ET.Element, mesh_of_link: Mapping[str, LinkMesh]) -> None:
    """Add the meshes as assets, and as geoms without mass and contacts.

    The collision shapes of links with a mesh are hidden.
    """
    if not mesh_of_link:
        return
    assets = ET.Element("asset")
    model_root.insert(list(model_root).index(model_root.find("worldbody")), assets)  # type: ignore[arg-type]
    bodies = {str(body.get("name")): body for body in model_root.iter("body")}
    for link, mesh in mesh_of_link.items():
        # MuJoCo computes an inertia for each mesh. MuJoCo can compute the inertia of a mesh as a
        # shell even if the surface has holes. The inertia of a mesh has no effect in the exported
        # model.
        ET.SubElement(
            assets,
            "mesh",
            name=link,
            file=mesh.file,
            scale=numbers_text(mesh.scale),
            inertia="shell",
        )
        for geom in bodies[link].findall("geom"):
            geom.set("group", COLLISION_GEOM_GROUP)
        x, y, z, w = quaternion_of_rotation(mesh.rotation)
        mesh_pose = {"pos": numbers_text(mesh.position), "quat": numbers_text((w, x, y, z))}
        geom_attributes = {
            "contype": "0",
            "conaffinity": "0",
            "mass": "0",
            "group": VISUAL_GEOM_GROUP,
        }
        ET.SubElement(bodies[link], "geom", mesh_pose | geom_attributes, type="mesh", mesh=link)


def _add_couplings(model_root: ET.Element, hand: Hand) -> None:
    """Add an equality constraint for each joint that follows another joint, see ``coupled_joints``."""
    rows = [
        (digit.joints[follower], digit.joints[leading_joint], ratio)
        for digit in hand.digit
        for follower, (leading_joint, ratio) in coupled_joints(hand, digit).items()
    ]
    if not rows:
        return
    equality = ET.SubElement(model_root, "equality")
    for follower, leading_joint, ratio in rows:
        # The constraint is follower = 0 + ratio * leader. Both joint angles are measured from the
        # zero angle in the model.
        polynomial = numbers_text((0.0, ratio, 0.0, 0.0, 0.0))
        ET.SubElement(equality, "joint", joint1=follower, joint2=leading_joint, polycoef=polynomial)


def _add_tendons(model_root: ET.Element, hand: Hand) -> None:
    """Add two elements for each tendon: a fixed tendon of MuJoCo with constant moment arms, and a motor.

    The motor of a single tendon (not a spool pair) only pulls. The motor of a spool pair can pull
    in both directions. If a moment arm depends on the joint angle, the fixed tendon of MuJoCo gets
    the mean of this moment arm.
    """
    tendons = ET.SubElement(model_root, "tendon")
    actuators = ET.SubElement(model_root, "actuator")
    for tendon, arms in zip(hand.tendon, hand.moment_arms, strict=True):
        fixed_element = ET.SubElement(tendons, "fixed", name=tendon.name)
        for joint in tendon.arms:
            ET.SubElement(
                fixed_element,
                "joint",
                joint=joint,
                coef=number_text(arms[hand.joints.index(joint)]),
            )
        low = 0.0 if tendon.pretension_N is None else -tendon.tension_max_N
        limits = numbers_text((low, tendon.tension_max_N))
        ET.SubElement(actuators, "motor", name=tendon.motor, tendon=tendon.name, ctrlrange=limits)
