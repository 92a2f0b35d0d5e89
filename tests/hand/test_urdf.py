"""Test the XML document of the URDF export.

The tests of another module compare dynamics and kinematics of the URDF with those of the hand.
"""

from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from handctl.hand.formats.urdf import urdf_text


def test_names_are_those_of_the_contract(hand):
    robot = ET.fromstring(urdf_text(hand))
    assert robot.get("name") == hand.name
    links = [link.get("name") for link in robot.findall("link")]
    assert links[0] == "palm"
    assert len(links) == len(set(links)) == 1 + len(hand.joints) + len(hand.digit)
    for digit in hand.digit:
        assert {
            f"{digit.name}_tip",
            *(joint.replace("_j", "_link") for joint in digit.joints),
        } <= set(links)
    moving = [
        joint.get("name") for joint in robot.findall("joint") if joint.get("type") == "revolute"
    ]
    assert moving == list(hand.joints)


def test_the_urdf_has_primitive_shapes_only(hand):
    shapes = {
        shape.tag
        for geometry in ET.fromstring(urdf_text(hand)).iter("geometry")
        for shape in geometry
    }
    assert shapes == {"box", "cylinder", "sphere"}


def test_limits_are_those_of_the_description(hand):
    model = mujoco.MjModel.from_xml_string(urdf_text(hand))
    low = np.concatenate([np.radians(digit.joint_min_deg) for digit in hand.digit])
    high = np.concatenate([np.radians(digit.joint_max_deg) for digit in hand.digit])
    assert np.allclose(model.jnt_range, np.column_stack((low, high)))
    assert np.allclose(
        model.dof_damping,
        np.concatenate([digit.joint_damping_N_m_s_per_rad for digit in hand.digit]),
    )
    assert np.isclose(model.body_mass.sum(), sum(sum(digit.link_mass_kg) for digit in hand.digit))


def test_effort_is_what_the_tendons_may_pull(hand):
    joints = {
        joint.get("name"): joint.find("limit")
        for joint in ET.fromstring(urdf_text(hand)).findall("joint")
    }
    max_joint_torque = np.abs(hand.moment_arms).T @ [tendon.tension_max_N for tendon in hand.tendon]
    assert np.allclose(
        [float(joints[name].get("effort")) for name in hand.joints], max_joint_torque
    )


def test_inertias_are_possible(hand):
    """The principal moments of inertia of each link obey the triangle inequality."""
    for inertia in ET.fromstring(urdf_text(hand)).iter("inertia"):
        x, y, z = (float(inertia.get(axis)) for axis in ("ixx", "iyy", "izz"))
        assert min(x, y, z) > 0.0
        assert max(x, y, z) <= (x + y + z) / 2 * (1 + 1e-12)


def test_the_urdf_text_is_reproducible(hand):
    assert urdf_text(hand) == urdf_text(hand)
    assert urdf_text(hand).isascii()
