"""Test that the exported URDF and MJCF contain the rigid couplings of joints, but no soft couplings."""

from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from handctl.hand.formats.mjcf import mjcf_text
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand
from tests.docs.code_blocks import REPOSITORY_ROOT

SHADOW_LIKE_HAND = load_hand(REPOSITORY_ROOT / "examples" / "hands" / "shadow_like.toml")
DRIVER_BY_COUPLED_JOINT = {
    "index_j4": "index_j3", "middle_j4": "middle_j3", "ring_j4": "ring_j3", "little_j5": "little_j4",
}  # fmt: skip
"""For each coupled joint of ``shadow_like``, the joint whose angle the coupled joint follows with the ratio 1."""


def test_the_urdf_has_a_mimic_for_each_rigidly_coupled_joint() -> None:
    robot = ET.fromstring(urdf_text(SHADOW_LIKE_HAND))
    mimic_by_joint = {
        str(joint.get("name")): mimic.attrib
        for joint in robot.iter("joint")
        if (mimic := joint.find("mimic")) is not None
    }
    assert {
        name: mimic["joint"] for name, mimic in mimic_by_joint.items()
    } == DRIVER_BY_COUPLED_JOINT
    assert {float(mimic["multiplier"]) for mimic in mimic_by_joint.values()} == {1.0}


def test_mujoco_keeps_rigidly_coupled_joints_together() -> None:
    model = mujoco.MjModel.from_xml_string(mjcf_text(SHADOW_LIKE_HAND))
    assert model.neq == len(DRIVER_BY_COUPLED_JOINT)
    data = mujoco.MjData(model)
    outer_actuator = model.actuator("index_outer").id
    data.ctrl[outer_actuator] = 2.0
    for _ in range(400):
        mujoco.mj_step(model, data)
    coupled_joint_angles = data.qpos[
        [model.joint(name).qposadr[0] for name in ("index_j3", "index_j4")]
    ]
    assert coupled_joint_angles[0] > 0.2
    assert coupled_joint_angles[1] == pytest.approx(coupled_joint_angles[0], abs=0.02)
    # A motor that drives two antagonistic tendons pulls in both directions.
    assert np.array_equal(model.actuator_ctrlrange[:, 0], -model.actuator_ctrlrange[:, 1])


@pytest.mark.parametrize("hand_name", ["jamia", "t42"])
def test_the_coupling_by_springs_is_no_constraint(hand_name: str) -> None:
    hand = load_hand(hand_name)
    assert "<mimic" not in urdf_text(hand)
    assert "<equality" not in mjcf_text(hand)
