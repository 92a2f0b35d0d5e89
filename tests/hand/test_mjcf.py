"""Test the MJCF export.

MuJoCo reads the exported file. The tests compare the model in MuJoCo with the model of the hand in
handctl.
"""

import mujoco
import numpy as np
import pytest

from handctl.hand import dynamics
from handctl.hand.formats.mjcf import mjcf_text
from handctl.hand.kinematics import joint_points


@pytest.fixture
def mjcf_model(hand):
    return mujoco.MjModel.from_xml_string(mjcf_text(hand))


def random_angles(hand, rng):
    low = np.radians(np.concatenate([digit.joint_min_deg for digit in hand.digit]))
    high = np.radians(np.concatenate([digit.joint_max_deg for digit in hand.digit]))
    return rng.uniform(low, high)


def test_names_and_limits_are_the_hand_s(hand, mjcf_model):
    assert [mjcf_model.joint(i).name for i in range(mjcf_model.njnt)] == list(hand.joints)
    assert [mjcf_model.tendon(i).name for i in range(mjcf_model.ntendon)] == list(hand.tendon_names)
    assert [mjcf_model.actuator(i).name for i in range(mjcf_model.nu)] == [
        tendon.motor for tendon in hand.tendon
    ]
    limits = [
        (low, high)
        for d in hand.digit
        for low, high in zip(d.joint_min_deg, d.joint_max_deg, strict=True)
    ]
    assert np.degrees(mjcf_model.jnt_range) == pytest.approx(np.array(limits))


def test_tips_masses_and_torques_are_the_model_s(hand, digits, mjcf_model, rng):
    data, mass_matrix = mujoco.MjData(mjcf_model), np.zeros((mjcf_model.nv, mjcf_model.nv))
    for _ in range(20):
        data.qpos[:] = q = random_angles(hand, rng)
        data.ctrl[:] = tension = rng.uniform(0.0, [tendon.tension_max_N for tendon in hand.tendon])
        mujoco.mj_forward(mjcf_model, data)
        mujoco.mj_fullM(mjcf_model, data, mass_matrix)
        for digit in digits:
            angles_of_digit = q[digit.joints]
            tip = joint_points(digit, angles_of_digit)[-1]
            assert data.site(f"{digit.name}_tip").xpos == pytest.approx(tip, abs=1e-12)
            assert mass_matrix[digit.joints, digit.joints] == pytest.approx(
                dynamics.mass_matrix(digit, angles_of_digit), rel=1e-9
            )
            spring = -np.array(dynamics.spring_torque(digit, angles_of_digit))
            assert data.qfrc_spring[digit.joints] == pytest.approx(spring, rel=1e-9)
            assert data.qfrc_bias[digit.joints] == pytest.approx(
                dynamics.gravity_torque(digit, angles_of_digit), abs=1e-12
            )
        assert data.qfrc_actuator == pytest.approx(hand.moment_arms.T @ tension, rel=1e-9)


def test_the_springs_hold_the_free_hand_open(hand, mjcf_model):
    data = mujoco.MjData(mjcf_model)
    for _ in range(1000):
        mujoco.mj_step(mjcf_model, data)
    assert np.degrees(np.abs(data.qpos)).max() < 0.5
