"""Compare the models of twenty random hands with the models in pinocchio and MuJoCo.

The directions of joint axes and of gravity are random.
"""

from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest

from firmware_sim.description.hand_description import load_hand as simulated_hand
from firmware_sim.plant.mjcf import model_text
from firmware_sim.scene.scene import load_scene
from handctl.core.estimation.tip_force import joint_lever
from handctl.hand import dynamics, rigid_body
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.formats.mjcf import mjcf_text
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand
from handctl.hand.kinematics import forward_kinematics, joint_points, point_jacobian, tip_jacobian
from handctl.hand.link_frames import link_transforms
from handctl.hand.link_tree import LinkTree
from handctl.log.topics.transform_topics import (
    LinkFrame,
    link_frames,
    link_positions,
    link_quaternions,
    multiply_quaternions,
)
from tests.hand.random_chains import (
    RANDOM_CHAIN_SEEDS,
    SEEDS_WITH_PRISMATIC_JOINTS,
    build_random_hand_tree,
    random_hand,
)
from tests.hand.test_dynamics import (
    RELATIVE_TOLERANCE,
    arrays_agree,
    inverse_dynamics_of_hand,
    pinocchio_chain,
    random_motions,
)

EXAMPLE_HAND = str(Path(__file__).parents[2] / "examples" / "hands" / "shadow_like.toml")
"""Hand file of an example with 24 joints.

The wrist of the example hand carries the base of the thumb, and the base carries the thumb.
"""


@pytest.fixture(params=[*RANDOM_CHAIN_SEEDS, *SEEDS_WITH_PRISMATIC_JOINTS])
def random_hand_and_digits(request: pytest.FixtureRequest) -> tuple[Hand, tuple[DigitModel, ...]]:
    """Return a random hand and its digits.

    A test that uses this fixture runs once for each random hand.
    """
    hand = random_hand(request.param)
    return hand, tuple(DigitModel.from_hand(hand, name) for name in hand.digit_names)


def test_random_hands_have_all_counts_of_links():
    assert {len(random_hand(seed).digit[0].joints) for seed in RANDOM_CHAIN_SEEDS} == set(
        range(1, 9)
    )


def test_dynamics_and_kinematics_equal_those_of_pinocchio(random_hand_and_digits, rng):
    hand, digits = random_hand_and_digits
    for digit in digits:
        model = pinocchio_chain(digit, hand.mount.gravity_m_s2)
        tip = model.addFrame(
            pinocchio.Frame(
                "tip",
                digit.joint_count,
                pinocchio.SE3(np.eye(3), np.array([digit.lengths[-1], 0.0, 0.0])),
                pinocchio.FrameType.OP_FRAME,
            )
        )
        data = model.createData()
        model_without_armature = model.copy()
        model_without_armature.armature = np.zeros(digit.joint_count)
        model_data = model_without_armature.createData()
        world = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        for q, dq, ddq in random_motions(rng, digit.joint_count, 50):
            tau = pinocchio.rnea(model, data, q, dq, ddq)
            assert arrays_agree(dynamics.inverse_dynamics(digit, q, dq, ddq), tau)
            torque_at_rest = pinocchio.computeGeneralizedGravity(model, data, q)
            assert np.allclose(
                dynamics.gravity_torque(digit, q),
                torque_at_rest,
                rtol=0,
                atol=RELATIVE_TOLERANCE * 1e-3,
            )
            upper = np.triu(pinocchio.crba(model, data, q))
            assert arrays_agree(dynamics.mass_matrix(digit, q), upper + np.triu(upper, 1).T)
            assert arrays_agree(dynamics.forward_dynamics(digit, q, dq, tau), ddq)
            pinocchio.framesForwardKinematics(model, data, q)
            pose = forward_kinematics(digit, q)
            assert np.allclose(pose.position, data.oMf[tip].translation, atol=1e-13)
            assert np.allclose(pose.rotation, data.oMf[tip].rotation, atol=1e-13)
            jacobian = pinocchio.computeFrameJacobian(model, data, q, tip, world).reshape(6, -1)[:3]
            assert np.allclose(tip_jacobian(digit, q), jacobian, atol=1e-13)
            energy = pinocchio.computePotentialEnergy(model, data, q) + sum(digit.masses) * np.dot(
                hand.mount.gravity_m_s2, digit.mount_position
            )
            assert np.isclose(dynamics.potential_energy(digit, q), energy, rtol=1e-9, atol=1e-15)
            # The kinetic energy in pinocchio 3 includes the armature only for some joint types.
            kinetic_energy = pinocchio.computeKineticEnergy(
                model_without_armature, model_data, q, dq
            ) + 0.5 * np.dot(digit.armature, dq**2)
            assert np.isclose(dynamics.kinetic_energy(digit, q, dq), kinetic_energy, rtol=1e-9)


def inverse_by_mujoco(model, q, dq, ddq):
    """Return the inverse dynamics and the mass matrix of a MuJoCo model that has no constraints, damping or springs."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_damping[:] = model.jnt_stiffness[:] = model.tendon_damping[:] = 0.0
    data, mass_matrix = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
    mujoco.mj_inverse(model, data)
    mujoco.mj_fullM(model, data, mass_matrix)
    return np.array(data.qfrc_inverse), mass_matrix


def test_exports_and_the_simulator_s_own_model_are_the_same_hand(
    random_hand_and_digits, rng, tmp_path
):
    """The exported MJCF has the same dynamics as the hand.

    The model that the simulator makes with separate code has the same dynamics, too.
    """
    hand, digits = random_hand_and_digits
    path = tmp_path / "random.toml"
    path.write_text(hand.to_toml())
    for text in (mjcf_text(hand), model_text(simulated_hand(str(path)), load_scene(None))):
        model = mujoco.MjModel.from_xml_string(text)
        assert [model.joint(i).name for i in range(model.nv)] == list(hand.joints)
        for q, dq, ddq in random_motions(rng, model.nv, 10):
            pinocchio_result, mass_matrix = inverse_by_mujoco(model, q, dq, ddq)
            assert arrays_agree(inverse_dynamics_of_hand(digits, q, dq, ddq), pinocchio_result)
            for digit in digits:
                own_joints = digit.joints
                assert arrays_agree(
                    dynamics.mass_matrix(digit, q[own_joints]), mass_matrix[own_joints, own_joints]
                )


def test_the_urdf_describes_the_same_hand(random_hand_and_digits, rng):
    hand, digits = random_hand_and_digits
    model = pinocchio.buildModelFromXML(urdf_text(hand))
    model.gravity.linear = np.array(hand.mount.gravity_m_s2)
    order = [model.joints[model.getJointId(joint)].idx_v for joint in hand.joints]
    data = model.createData()
    for q, dq, ddq in random_motions(rng, len(hand.joints), 10):
        pinocchio_result = [np.zeros(model.nv) for _ in range(3)]
        for vector, own_vector in zip(pinocchio_result, (q, dq, ddq), strict=True):
            vector[order] = own_vector
        armature = np.concatenate([digit.armature for digit in digits]) * ddq
        assert arrays_agree(
            inverse_dynamics_of_hand(digits, q, dq, ddq) - armature,
            pinocchio.rnea(model, data, *pinocchio_result)[order],
        )
        pinocchio.framesForwardKinematics(model, data, pinocchio_result[0])
        for digit in digits:
            for transform in link_transforms(digit, q[digit.joints]):
                placement = data.oMf[model.getFrameId(transform.frame)]
                assert np.allclose(transform.position, placement.translation, atol=1e-12)
                turned_rotation = pinocchio.Quaternion(
                    np.array(transform.quaternion_xyzw)
                ).toRotationMatrix()
                assert np.allclose(turned_rotation, placement.rotation, atol=1e-12)


def link_position(link: LinkFrame, q: np.ndarray) -> np.ndarray:
    """Return the position of a link's origin in the frame of its parent link, from the transforms in the log."""
    return link_positions(link, q[[max(link.joint, 0)]])[0]


def frames_in_log(hand: Hand, q: np.ndarray) -> dict[str, tuple[np.ndarray, tuple[float, ...]]]:
    """Return the position and the orientation of each link frame in the palm frame, from the transforms in the log."""
    pose_by_frame = {"palm": (np.zeros(3), (0.0, 0.0, 0.0, 1.0))}
    for link in link_frames(hand.to_toml()):
        position, turn = pose_by_frame[link.parent]
        link_origin = (
            np.array(pinocchio.Quaternion(np.array(turn)).toRotationMatrix())
            @ link_position(link, q)
            + position
        )
        own_link_quaternion = (
            tuple(link_quaternions(link, q[[link.joint]])[0]) if link.joint >= 0 else link.rotation
        )
        pose_by_frame[link.child] = link_origin, multiply_quaternions(turn, own_link_quaternion)
    return pose_by_frame


def test_transforms_of_the_log_are_those_of_the_model(random_hand_and_digits, rng):
    """The transforms in the log are computed only from the text of the hand file.

    For each digit, the product of the transforms in the log equals the pose in the hand model.
    """
    hand, digits = random_hand_and_digits
    q = rng.uniform(-2.0, 2.0, len(hand.joints))
    pose_by_frame = frames_in_log(hand, q)
    for digit in digits:
        for transform in link_transforms(digit, q[digit.joints]):
            position, turn = pose_by_frame[transform.frame]
            assert np.allclose(transform.position, position, atol=1e-12)
            assert np.isclose(abs(np.dot(turn, transform.quaternion_xyzw)), 1.0, atol=1e-12)


def test_mixed_hands_have_joints_of_both_types_in_any_order():
    types = [
        digit.is_prismatic
        for seed in SEEDS_WITH_PRISMATIC_JOINTS
        for hand in (random_hand(seed), build_random_hand_tree(seed))
        for digit in hand.digit
    ]
    assert any(map(all, types))
    assert not all(map(any, types))
    pairs = {pair for digit in types for pair in pairwise(digit)}
    assert len(pairs) == 4


def test_jacobians_and_levers_are_derivatives(random_hand_and_digits, rng):
    _, digits = random_hand_and_digits
    h = 1e-6
    for digit in digits:
        steps = h * np.eye(digit.joint_count)
        q = rng.uniform(-2.0, 2.0, digit.joint_count)
        slope = [
            (joint_points(digit, q + s)[-1] - joint_points(digit, q - s)[-1]) / (2 * h)
            for s in steps
        ]
        assert np.allclose(tip_jacobian(digit, q), np.transpose(slope), atol=1e-9)
        side = forward_kinematics(digit, q).rotation[:, 1]
        assert np.allclose(joint_lever(digit, q), side @ tip_jacobian(digit, q), atol=1e-14)
        for link in range(digit.joint_count):
            middle_jacobian = point_jacobian(digit, q, link, 0.5 * digit.lengths[link])
            normal = np.array(rigid_body.link_poses(digit.table, digit.parent, q))[link, [1, 4, 7]]
            lever = rigid_body.tip_levers(
                digit.table, digit.parent, q, link, 0.5 * digit.lengths[link]
            )
            assert np.allclose(lever, normal @ middle_jacobian, atol=1e-14)


@pytest.fixture(
    params=[
        *RANDOM_CHAIN_SEEDS,
        *SEEDS_WITH_PRISMATIC_JOINTS,
        "orca_like",
        pytest.param(EXAMPLE_HAND, id="shadow_like"),
    ]
)
def random_hand_tree(request: pytest.FixtureRequest) -> tuple[Hand, LinkTree]:
    """Return a hand in which digits carry other digits.

    A test that uses this fixture runs with each random hand, with the packaged hand in which digits
    carry digits, and with the example ``shadow_like``.
    """
    hand = (
        load_hand(request.param)
        if isinstance(request.param, str)
        else build_random_hand_tree(request.param)
    )
    return hand, LinkTree.from_hand(hand)


def test_random_trees_have_digits_on_digits_on_digits():
    carried_digit_counts = [
        sum(digit.mount_on is not None for digit in build_random_hand_tree(seed).digit)
        for seed in RANDOM_CHAIN_SEEDS
    ]
    assert max(carried_digit_counts) >= 3
    is_on_carried_digit = [
        digit.mount_on is not None and hand.digit_named(digit.mount_on).mount_on is not None
        for hand in map(build_random_hand_tree, RANDOM_CHAIN_SEEDS)
        for digit in hand.digit
    ]
    assert any(is_on_carried_digit)


def test_a_tree_is_the_same_in_both_mujoco_models(random_hand_tree, rng, tmp_path):
    hand, tree = random_hand_tree
    path = tmp_path / "tree.toml"
    path.write_text(hand.to_toml())
    for text in (mjcf_text(hand), model_text(simulated_hand(str(path)), load_scene(None))):
        model = mujoco.MjModel.from_xml_string(text)
        assert [model.joint(i).name for i in range(model.nv)] == list(hand.joints)
        for q, dq, ddq in random_motions(rng, model.nv, 10):
            pinocchio_result, mass_matrix = inverse_by_mujoco(model, q, dq, ddq)
            assert arrays_agree(tree.inverse_dynamics(q, dq, ddq), pinocchio_result)
            assert arrays_agree(tree.mass_matrix(q), mass_matrix)


def test_the_dynamics_of_a_tree_equal_those_of_pinocchio(random_hand_tree, rng):
    hand, tree = random_hand_tree
    model = pinocchio.buildModelFromXML(urdf_text(hand))
    model.gravity.linear = np.array(hand.mount.gravity_m_s2)
    order = [model.joints[model.getJointId(joint)].idx_v for joint in hand.joints]
    data = model.createData()
    for q, dq, ddq in random_motions(rng, len(hand.joints), 10):
        pinocchio_result = [np.zeros(model.nv) for _ in range(3)]
        for vector, own_vector in zip(pinocchio_result, (q, dq, ddq), strict=True):
            vector[order] = own_vector
        armature = tree.table[rigid_body.JOINT_ARMATURE_ROW] * ddq
        assert arrays_agree(
            tree.inverse_dynamics(q, dq, ddq) - armature,
            pinocchio.rnea(model, data, *pinocchio_result)[order],
        )
        torque_at_rest = pinocchio.computeGeneralizedGravity(model, data, pinocchio_result[0])[
            order
        ]
        springs = tree.spring_stiffness * (q + tree.spring_preload)
        assert np.allclose(tree.static_torque(q) - springs, torque_at_rest, rtol=0.0, atol=1e-12)
        pinocchio.framesForwardKinematics(model, data, pinocchio_result[0])
        for digit, points_of_digit in zip(tree.digits, tree.points(q), strict=True):
            placement = data.oMf[model.getFrameId(f"{digit.name}_tip")]
            assert np.allclose(points_of_digit[-1], placement.translation, atol=1e-12)


def test_logged_transforms_of_a_tree_equal_the_model(random_hand_tree, rng):
    hand, tree = random_hand_tree
    q = rng.uniform(-2.0, 2.0, len(hand.joints))
    pose_by_frame = frames_in_log(hand, q)
    for digit, points_of_digit in zip(tree.digits, tree.points(q), strict=True):
        assert np.allclose(pose_by_frame[f"{digit.name}_tip"][0], points_of_digit[-1], atol=1e-12)


def test_a_digit_on_a_resting_carrier_moves_like_that_digit_alone(random_hand_tree, rng):
    """A digit that carries no other digit needs the same static torque in a hand as in a model of the digit alone.

    In this test, the digits that carry another digit are at angle zero.
    """
    hand, tree = random_hand_tree
    for digit in tree.digits:
        if digit.name in hand.carrier_digits:
            continue
        q = np.zeros(len(hand.joints))
        q[digit.joints] = rng.uniform(-2.0, 2.0, digit.joint_count)
        assert np.allclose(
            tree.static_torque(q)[digit.joints], dynamics.static_torque(digit, q[digit.joints])
        )


def test_each_number_of_a_table_matters(rng):
    """The comparisons with pinocchio would detect a change of 0.1 % in any property of the middle link."""
    hand = random_hand(3, 3)
    digit = DigitModel.from_hand(hand, "d0")
    q, dq, ddq = next(iter(random_motions(rng, 3, 1)))
    correct_torques = np.array(dynamics.inverse_dynamics(digit, q, dq, ddq))
    for row in range(rigid_body.LINK_LENGTH_ROW):
        table = digit.table.copy()
        table[row, 1] *= 1.001
        wrong_torques = rigid_body.rigid_body_torques(
            table, digit.parent, digit.gravity, q, dq, ddq
        )
        is_unused = table[row, 1] == 0.0
        assert is_unused != (not arrays_agree(wrong_torques, correct_torques)), row
