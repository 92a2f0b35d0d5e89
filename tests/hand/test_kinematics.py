"""Compare the kinematics of a digit with finite differences, with the inverse kinematics, and with pinocchio.

The library pinocchio reads the exported URDF.
"""

import math

import numpy as np
import pinocchio
import pytest

from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand
from handctl.hand.inverse_kinematics import (
    coordinate_limits,
    inverse_kinematics,
    inverse_kinematics_coupled,
)
from handctl.hand.kinematics import (
    forward_kinematics,
    from_palm_frame,
    joint_points,
    point_jacobian,
    tip_jacobian,
    to_palm_frame,
)
from handctl.hand.link_frames import link_transforms, quaternion_of_rotation
from handctl.hand.link_geometry import rotation_of_rpy
from tests.hand.random_chains import random_hand


def planar_tip_pose(digit, q):
    """Return the tip position (x, y) of a planar digit, and the direction of the last link."""
    x, y, _ = from_palm_frame(digit, joint_points(digit, q)[-1])
    return x, y, float(np.sum(q))


def random_angles(rng, digit, sample_count=100):
    """Return random joint angles (count, joints) [rad], from below the lower limits to above the upper limits."""
    return rng.uniform(-2.5, 2.5, (sample_count, digit.joint_count))


def hand_with_general_mounts() -> Hand:
    """Return a hand whose digits are mounted on the palm with rotations about all three axes."""
    content = load_hand("jamia").content
    tilt_angles_deg = (
        (25.0, -40.0, 70.0),
        (-160.0, 15.0, 5.0),
        (90.0, 0.0, 90.0),
        (10.0, 85.0, -120.0),
    )
    digits = [
        {**digit, "mount_rpy_deg": tilt}
        for digit, tilt in zip(content["digit"], tilt_angles_deg, strict=True)
    ]
    return Hand.model_validate({**content, "digit": digits})


@pytest.mark.parametrize(
    "hand",
    [load_hand("jamia"), load_hand("jamia11"), hand_with_general_mounts()],
    ids=["jamia", "jamia11", "moved"],
)
def test_frames_and_jacobians_agree_with_pinocchio(hand, rng):
    model = pinocchio.buildModelFromXML(urdf_text(hand))
    data = model.createData()
    for digit in (DigitModel.from_hand(hand, name) for name in hand.digit_names):
        columns = [model.joints[model.getJointId(joint)].idx_v for joint in digit.joint_names]
        tip = model.getFrameId(f"{digit.name}_tip")
        for q in random_angles(rng, digit):
            configuration = np.zeros(model.nq)
            configuration[columns] = q
            pinocchio.framesForwardKinematics(model, data, configuration)
            for transform in link_transforms(digit, q):
                placement = data.oMf[model.getFrameId(transform.frame)]
                assert np.allclose(transform.position, placement.translation, atol=1e-14)
                turned_rotation = pinocchio.Quaternion(
                    np.array(transform.quaternion_xyzw)
                ).toRotationMatrix()
                assert np.allclose(turned_rotation, placement.rotation, atol=1e-13)
            world = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
            pinocchio_result = pinocchio.computeFrameJacobian(
                model, data, configuration, tip, world
            )[:3, columns]
            assert np.allclose(tip_jacobian(digit, q), pinocchio_result, atol=1e-14)


def test_straight_fingers_point_out_of_the_palm_and_flex_towards_each_other(digits):
    for digit in digits:
        straight_points = joint_points(digit, np.zeros(digit.joint_count))
        assert np.allclose(straight_points[-1] - straight_points[0], [sum(digit.lengths), 0.0, 0.0])
        bend_vector = joint_points(digit, np.full(digit.joint_count, 0.3))[-1] - straight_points[-1]
        assert bend_vector[1] * digit.mount_position[1] < 0.0
        assert abs(bend_vector[2]) < 1e-12


def test_jacobians_are_derivatives(digits, rng):
    h = 1e-6
    for digit in digits:
        for q in random_angles(rng, digit, 30):
            steps = h * np.eye(digit.joint_count)
            slope = [
                (joint_points(digit, q + s)[-1] - joint_points(digit, q - s)[-1]) / (2 * h)
                for s in steps
            ]
            assert np.allclose(tip_jacobian(digit, q), np.transpose(slope), atol=1e-10)
            for link in range(digit.joint_count):
                middle_slope = [
                    sum(
                        sign * joint_points(digit, q + sign * s)[link : link + 2].mean(axis=0)
                        for sign in (1, -1)
                    )
                    / (2 * h)
                    for s in steps
                ]
                jacobian = point_jacobian(digit, q, link, digit.lengths[link] / 2)
                assert np.allclose(jacobian, np.transpose(middle_slope), atol=1e-10)


def test_tip_pose_is_the_last_point_and_the_sum_of_angles(digits, rng):
    for digit in digits:
        q = random_angles(rng, digit, 1)[0]
        pose = forward_kinematics(digit, q)
        assert np.allclose(pose.position, joint_points(digit, q)[-1])
        assert np.allclose(pose.rotation, digit.mount_rotation @ rotation_of_rpy(0.0, 0.0, q.sum()))
        lengths = np.linalg.norm(np.diff(joint_points(digit, q), axis=0), axis=1)
        assert np.allclose(lengths, digit.lengths, rtol=1e-12)


def test_the_paper_s_finger_at_thirty_degrees():
    """With q1 = q2 = q3 = t, Eq. 1-2 of the paper give X = 30 cos(t) + 15 cos(2t) + 10 cos(3t) mm."""
    t = math.radians(30.0)
    pose = planar_tip_pose(DigitModel.from_hand(load_hand("jamia"), "index"), (t, t, t))
    x = 0.030 * math.cos(t) + 0.015 * math.cos(2 * t) + 0.010 * math.cos(3 * t)
    y = 0.030 * math.sin(t) + 0.015 * math.sin(2 * t) + 0.010 * math.sin(3 * t)
    assert np.allclose(pose, (x, y, 3 * t), rtol=1e-13)


def test_the_inverse_of_the_palm_frame_gives_the_points_back(digits, rng):
    for digit in digits:
        link_vectors = rng.normal(size=(20, 3))
        assert np.allclose(
            from_palm_frame(digit, to_palm_frame(digit, link_vectors)), link_vectors, atol=1e-14
        )


def test_quaternions_of_all_rotations(rng):
    for roll, pitch, yaw in [
        *rng.uniform(-4, 4, (200, 3)),
        (math.pi, 0, 0),
        (0, math.pi, 0),
        (0, 0, math.pi),
        (0, 0, 0),
    ]:
        q = quaternion_of_rotation(rotation_of_rpy(roll, pitch, yaw))
        assert math.isclose(sum(component * component for component in q), 1.0, rel_tol=1e-12)
        rotation_matrix = pinocchio.rpy.rpyToMatrix(roll, pitch, yaw)
        assert np.allclose(
            pinocchio.Quaternion(np.array(q)).toRotationMatrix(), rotation_matrix, atol=1e-13
        )


def test_inverse_finds_the_angles_that_were_given(digits, rng):
    for digit in digits:
        for q in random_angles(rng, digit):
            x, y, angle = planar_tip_pose(digit, q)
            solutions = inverse_kinematics(digit, x, y, angle)
            assert len(solutions) == 2
            assert solutions[0][1] > 0.0 > solutions[1][1]
            distance_errors = [
                np.abs(np.remainder(np.subtract(s, q) + np.pi, 2 * np.pi) - np.pi).max()
                for s in solutions
            ]
            assert min(distance_errors) < 1e-9
            for solution in solutions:
                assert np.allclose(planar_tip_pose(digit, solution)[:2], (x, y), atol=1e-15)


def test_inverse_near_the_edge_of_reach(digits):
    for digit in digits:
        max_reach = sum(digit.lengths)
        assert np.allclose(inverse_kinematics(digit, max_reach, 0.0, 0.0), 0.0, atol=1e-6)
        assert inverse_kinematics(digit, max_reach + 1e-6, 0.0, 0.0) == ()
        for bend in (1e-3, 1e-5):
            q = (0.2, bend, 0.1)[: digit.joint_count]
            x, y, angle = planar_tip_pose(digit, q)
            assert np.allclose(inverse_kinematics(digit, x, y, angle)[0], q, atol=1e-15 / bend)


def test_inverse_kinematics_near_a_folded_posture():
    thumb = DigitModel.from_hand(load_hand("jamia"), "thumb")
    assert inverse_kinematics(thumb, 0.004, 0.0) == ()
    assert np.allclose(np.abs(inverse_kinematics(thumb, 0.005, 0.0)[0]), (0.0, math.pi), atol=1e-6)


def test_inverse_kinematics_names_missing_input():
    with pytest.raises(ValueError, match="parallel hinges"):
        inverse_kinematics(DigitModel.from_hand(random_hand(1, 3), "d0"), 0.03, 0.01, 0.0)
    with pytest.raises(ValueError, match="a direction"):
        inverse_kinematics(DigitModel.from_hand(load_hand("jamia"), "index"), 0.03, 0.01)
    with pytest.raises(ValueError, match="needed: one"):
        inverse_kinematics_coupled(
            DigitModel.from_hand(load_hand("jamia11"), "index"), (0.03, 0.01, 0.0)
        )


def test_coupled_inverse_finds_the_coordinate_that_was_given(rng):
    hand = load_hand("jamia")
    for digit in (DigitModel.from_hand(hand, name) for name in hand.digit_names):
        low, high = coordinate_limits(digit)
        assert (low, high) == (digit.joint_min[0], digit.joint_max[0])
        for theta in [low, high, *rng.uniform(low, high, 50)]:
            coordinate, distance = inverse_kinematics_coupled(
                digit, joint_points(digit, digit.coupling[:, 0] * theta)[-1]
            )
            assert abs(coordinate - theta) < 1e-7
            assert distance < 1e-9


def test_coupled_inverse_comes_as_near_as_a_fine_scan(rng):
    digit = DigitModel.from_hand(load_hand("jamia"), "index")
    coordinate_grid = np.linspace(*coordinate_limits(digit), 4001)
    curve = np.array(
        [joint_points(digit, digit.coupling[:, 0] * theta)[-1] for theta in coordinate_grid]
    )
    for target in digit.mount_position + rng.uniform(-0.06, 0.06, (100, 3)):
        _, distance = inverse_kinematics_coupled(digit, target)
        nearest_distance = np.linalg.norm(curve - target, axis=1).min()
        assert nearest_distance - 1e-6 < distance < nearest_distance + 1e-12


def test_coordinate_limits_respect_the_tightest_joint():
    content = load_hand("jamia").content
    digit = {
        **content["digit"][0],
        "coupling": [[1.0], [2.0], [-0.5]],
        "joint_min_deg": [-10.0, -60.0, -20.0],
    }
    model = DigitModel.from_hand(
        Hand.model_validate({**content, "digit": [digit, *content["digit"][1:]]}), "index"
    )
    assert np.allclose(np.degrees(coordinate_limits(model)), (-10.0, 40.0))
