"""Export of a hand as MJCF for MuJoCo: links, springs, stops, and tendons driven by tension.

The world frame is the palm frame. In the hand at rest all joint angles are zero. Positive angles
flex. Each control is the tension of one tendon at the joint pulleys [N]. The model has no tendon
elasticity, no friction, and no rotors.
"""

from collections.abc import Mapping
from xml.etree import ElementTree as ET

import numpy as np

from handctl.hand.description import Hand
from handctl.hand.file.sections import Digit
from handctl.hand.formats.meshes import LinkMesh
from handctl.hand.formats.numbers import number_text, numbers_text
from handctl.hand.formats.urdf import NO_MESHES, palm_box, shape_length
from handctl.hand.link_bodies import centre_of_mass, joint_axes, link_inertia, link_placement
from handctl.hand.link_frames import quaternion

STOP_SOLVER_PARAMETERS = ("0.002 1", "0.99 0.9999 0.001")
"""Solver parameters of stiff joint stops.

With MuJoCo's defaults, springs push these light links 16 degrees past their stops.
"""


VISUAL_GROUP = "2"
"""Group of the geoms of meshes. Viewers show the groups 0 to 2."""
HIDDEN_GROUP = "3"
"""Group of the collision shapes of links with a mesh."""


def mjcf_text(hand: Hand, meshes: Mapping[str, LinkMesh] = NO_MESHES) -> str:
    """Return the MJCF of a hand.

    Bodies are ``palm`` and ``index_link1``.., joints ``index_j1``.., sites ``index_tip``..

    Args:
        hand: description.
        meshes: meshes by link, with paths relative to the file. They have neither mass nor
            contacts.
    """
    root = ET.Element("mujoco", model=hand.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    gravity = numbers_text(hand.mount.gravity_m_s2)
    ET.SubElement(root, "option", gravity=gravity, timestep="0.0005", integrator="implicitfast", cone="elliptic")
    palm = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name="palm")
    _add_palm(palm, hand, None)
    _add_tendons(root, hand)
    _add_meshes(root, meshes)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add_palm(link: ET.Element, hand: Hand, carrier: str | None) -> None:
    """Add the digits that are mounted on a link, and a box behind them. These digits do not collide with the box."""
    centre, size = palm_box(hand, carrier)
    name = "palm" if carrier is None else f"{carrier}_palm"
    ET.SubElement(link, "geom", name=name, type="box", size=numbers_text(size / 2), pos=numbers_text(centre))
    for digit in hand.digit:
        if digit.mount_on == carrier:
            _add_digit(link, hand, digit)


def _add_digit(base: ET.Element, hand: Hand, digit: Digit) -> None:
    """Add nested bodies: each link along its x axis, its hinge at its origin."""
    parent = base
    for i, joint in enumerate(digit.joints):
        position, rotation = link_placement(digit, i)
        # MuJoCo's quaternions begin with w.
        x, y, z, w = quaternion(rotation)
        place = {"pos": numbers_text(position), "quat": numbers_text((w, x, y, z))}
        link = ET.SubElement(parent, "body", place, name=f"{digit.name}_link{i + 1}")
        _add_hinge(link, digit, i, joint)
        _add_link_body(link, digit, i, shape_length(hand, digit, i))
        parent = link
    ET.SubElement(parent, "site", name=f"{digit.name}_tip", pos=numbers_text((digit.link_length_m[-1], 0.0, 0.0)))
    if digit.name in hand.carriers:
        _add_palm(parent, hand, digit.name)


def _add_hinge(link: ET.Element, digit: Digit, i: int, joint: str) -> None:
    """Add the joint of link i."""
    ET.SubElement(
        link,
        "joint",
        name=joint,
        axis=numbers_text(joint_axes(digit)[i]),
        range=numbers_text(np.radians((digit.joint_min_deg[i], digit.joint_max_deg[i]))),
        damping=number_text(digit.joint_damping_N_m_s_per_rad[i]),
        armature=number_text(digit.joint_armature_kg_m2[i]),
        stiffness=number_text(digit.spring_stiffness_N_m_per_rad[i]),
        # MuJoCo's spring torque is -k (q - springref), the description's -k (q + preload).
        springref=number_text(-digit.spring_preload_rad[i]),
        solreflimit=STOP_SOLVER_PARAMETERS[0],
        solimplimit=STOP_SOLVER_PARAMETERS[1],
    )


def _add_link_body(link: ET.Element, digit: Digit, i: int, length: float) -> None:
    """Add inertia and collision shape of link i: a capsule of a length [m], or a ball without length."""
    moments = link_inertia(digit, i)
    ET.SubElement(
        link,
        "inertial",
        pos=numbers_text(centre_of_mass(digit, i)),
        mass=number_text(digit.link_mass_kg[i]),
        fullinertia=numbers_text([*np.diag(moments), moments[0, 1], moments[0, 2], moments[1, 2]]),
    )
    size = number_text(digit.link_radius_m)
    if length > 0.0:
        ET.SubElement(link, "geom", type="capsule", fromto=numbers_text((0, 0, 0, length, 0, 0)), size=size)
    else:
        ET.SubElement(link, "geom", type="sphere", size=size)


def _add_meshes(root: ET.Element, meshes: Mapping[str, LinkMesh]) -> None:
    """Add the meshes as assets and as geoms without mass and contacts. Shapes of the same bodies are hidden."""
    if not meshes:
        return
    assets = ET.Element("asset")
    root.insert(list(root).index(root.find("worldbody")), assets)  # type: ignore[arg-type]
    bodies = {str(body.get("name")): body for body in root.iter("body")}
    for link, mesh in meshes.items():
        # MuJoCo needs an inertia, and that of a shell is defined for open surfaces too. It has no
        # effect.
        ET.SubElement(assets, "mesh", name=link, file=mesh.file, scale=numbers_text(mesh.scale), inertia="shell")
        for geom in bodies[link].findall("geom"):
            geom.set("group", HIDDEN_GROUP)
        x, y, z, w = quaternion(mesh.rotation)
        place = {"pos": numbers_text(mesh.position), "quat": numbers_text((w, x, y, z))}
        free = {"contype": "0", "conaffinity": "0", "mass": "0", "group": VISUAL_GROUP}
        ET.SubElement(bodies[link], "geom", place | free, type="mesh", mesh=link)


def _add_tendons(root: ET.Element, hand: Hand) -> None:
    """Add fixed tendons by their moment arms, each with a motor that pulls only.

    The arms of a fixed tendon are constant. An arm that depends on the angle is replaced by its
    mean.
    """
    tendons = ET.SubElement(root, "tendon")
    actuators = ET.SubElement(root, "actuator")
    for tendon, arms in zip(hand.tendon, hand.moment_arms, strict=True):
        fixed = ET.SubElement(tendons, "fixed", name=tendon.name)
        for joint in tendon.moment_arm_m:
            ET.SubElement(fixed, "joint", joint=joint, coef=number_text(arms[hand.joints.index(joint)]))
        limits = numbers_text((0.0, tendon.tension_max_N))
        ET.SubElement(actuators, "motor", name=tendon.motor, tendon=tendon.name, ctrlrange=limits)
