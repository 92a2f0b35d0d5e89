"""Compare the equations of motion of a digit with those of pinocchio and MuJoCo, and with general laws of mechanics."""

import mujoco
import numpy as np
import pinocchio
import pytest

from handctl.hand import dynamics, rigid_body
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.formats.urdf import urdf_text
from handctl.hand.hand_loading import load_hand

SAMPLE_COUNT = 1000
GRAVITIES_M_S2 = [(0.0, 0.0, -9.81), (0.0, -9.81, 0.0), (9.81, 0.0, 0.0), (3.1, -7.7, 5.2)]
RELATIVE_TOLERANCE = 1e-9


def random_motions(rng, joint_count, sample_count=SAMPLE_COUNT):
    """Return random angles, rates and accelerations (q, dq, ddq).

    The motions are so fast that every term of the dynamics has a measurable effect.
    """
    return zip(
        *(scale * rng.normal(size=(sample_count, joint_count)) for scale in (1.5, 15.0, 400.0)),
        strict=True,
    )


def arrays_agree(computed, reference):
    """Return True if two arrays agree within a tolerance that is relative to the largest entry."""
    return (
        np.abs(np.asarray(computed) - reference).max()
        <= RELATIVE_TOLERANCE * np.abs(reference).max()
    )


def pinocchio_chain(digit: DigitModel, gravity_m_s2) -> pinocchio.Model:
    """Build a digit in pinocchio as a chain of hinges and prismatic joints, without the URDF of the digit."""
    model, parent = pinocchio.Model(), 0
    placement = pinocchio.SE3(np.array(digit.mount_rotation), np.array(digit.mount_position))
    for i in range(digit.joint_count):
        turned_pose = pinocchio.SE3(joint_rotation(digit, i), np.zeros(3))
        kinds = (pinocchio.JointModelRevoluteUnaligned, pinocchio.JointModelPrismaticUnaligned)
        joint = kinds[int(digit.is_prismatic[i])](np.array(digit.axes[i]))
        parent = model.addJoint(parent, joint, placement * turned_pose, digit.joint_names[i])
        body = pinocchio.Inertia(
            digit.masses[i], np.array(digit.centres_of_mass[i]), np.array(digit.inertias[i])
        )
        model.appendBodyToJoint(parent, body, pinocchio.SE3.Identity())
        placement = pinocchio.SE3(np.eye(3), np.array([digit.lengths[i], 0.0, 0.0]))
    model.gravity.linear = np.array(gravity_m_s2)
    model.armature = np.array(digit.armature)
    return model


def joint_rotation(digit: DigitModel, link_index: int) -> np.ndarray:
    """Return the orientation of the link ``link_index`` at angle zero, relative to the frame of the previous link."""
    rotation_at_zero = (
        digit.table[rigid_body.FIXED_ROTATION_ROW : rigid_body.COSINE_ROTATION_ROW, link_index]
        + digit.table[rigid_body.COSINE_ROTATION_ROW : rigid_body.SINE_ROTATION_ROW, link_index]
    )
    rotation = rotation_at_zero.reshape(3, 3)
    return rotation if link_index else digit.mount_rotation.T @ rotation


@pytest.mark.parametrize("gravity_m_s2", GRAVITIES_M_S2)
def test_agrees_with_pinocchio_built_by_hand(digits, rng, gravity_m_s2):
    for digit in digits:
        digit = digit.with_gravity(gravity_m_s2)
        model = pinocchio_chain(digit, gravity_m_s2)
        data = model.createData()
        for q, dq, ddq in random_motions(rng, digit.joint_count):
            tau = pinocchio.rnea(model, data, q, dq, ddq)
            assert arrays_agree(dynamics.inverse_dynamics(digit, q, dq, ddq), tau)
            torque_at_rest = pinocchio.rnea(model, data, q, np.zeros_like(q), np.zeros_like(q))
            assert np.allclose(
                dynamics.gravity_torque(digit, q),
                torque_at_rest,
                rtol=0,
                atol=RELATIVE_TOLERANCE * 1e-3,
            )
            upper = np.triu(pinocchio.crba(model, data, q))
            assert arrays_agree(dynamics.mass_matrix(digit, q), upper + np.triu(upper, 1).T)
            assert arrays_agree(dynamics.forward_dynamics(digit, q, dq, tau), ddq)


@pytest.mark.parametrize("gravity_m_s2", GRAVITIES_M_S2)
def test_agrees_with_pinocchio_reading_our_urdf(hand, digits, rng, gravity_m_s2):
    model = pinocchio.buildModelFromXML(urdf_text(hand))
    model.gravity.linear = np.array(gravity_m_s2)
    order = [model.joints[model.getJointId(joint)].idx_v for joint in hand.joints]
    armature = np.zeros(model.nv)
    armature[order] = np.concatenate([digit.armature for digit in digits])
    model.armature = armature
    data = model.createData()
    digits = [digit.with_gravity(gravity_m_s2) for digit in digits]
    for q, dq, ddq in random_motions(rng, len(hand.joints)):
        pinocchio_result = [np.zeros(model.nv) for _ in range(3)]
        for vector, own_vector in zip(pinocchio_result, (q, dq, ddq), strict=True):
            vector[order] = own_vector
        assert arrays_agree(
            inverse_dynamics_of_hand(digits, q, dq, ddq),
            pinocchio.rnea(model, data, *pinocchio_result)[order],
        )


@pytest.mark.parametrize("gravity_m_s2", GRAVITIES_M_S2)
def test_agrees_with_mujoco_reading_our_urdf(hand, digits, rng, gravity_m_s2):
    model = mujoco.MjModel.from_xml_string(urdf_text(hand))
    assert [model.joint(i).name for i in range(model.nv)] == list(hand.joints)
    model.opt.gravity[:] = gravity_m_s2
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.dof_damping[:] = 0.0
    model.dof_armature[:] = np.concatenate([digit.armature for digit in digits])
    data = mujoco.MjData(model)
    digits = [digit.with_gravity(gravity_m_s2) for digit in digits]
    mass_matrix = np.zeros((model.nv, model.nv))
    for q, dq, ddq in random_motions(rng, model.nv):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        assert arrays_agree(inverse_dynamics_of_hand(digits, q, dq, ddq), data.qfrc_inverse)
        mujoco.mj_fullM(model, data, mass_matrix)
        for digit in digits:
            mass_matrix_of_digit = mass_matrix[digit.joints, digit.joints]
            assert arrays_agree(dynamics.mass_matrix(digit, q[digit.joints]), mass_matrix_of_digit)


def inverse_dynamics_of_hand(digits, q, dq, ddq):
    """Return the joint torques of all digits from the inverse dynamics, in the order of the digits."""
    return np.concatenate(
        [dynamics.inverse_dynamics(d, q[d.joints], dq[d.joints], ddq[d.joints]) for d in digits]
    )


def test_one_joint_is_a_pendulum(rng):
    content = load_hand("jamia").content
    thumb = dict(content["digit"][3])
    for key, value in thumb.items():
        if isinstance(value, tuple) and key not in ("mount_position_m", "mount_rpy_deg"):
            thumb[key] = value[:1]
    thumb["coupling"] = None
    tendon = {**content["tendon"][3], "moment_arm_m": {"thumb_j1": 0.003}}
    node = {**content["sensor_node"], "tendons": ["thumb_tendon"], "joints": []}
    joint_values = {
        **content,
        "digit": [thumb],
        "tendon": [tendon],
        "motor": [content["motor"][3]],
        "sensor_node": node,
    }
    digit = DigitModel.from_hand(Hand.model_validate(joint_values), "thumb").with_gravity(
        (0.0, -9.81, 0.0)
    )
    inertia = (
        digit.inertias[0, 2, 2]
        + digit.masses[0] * digit.centres_of_mass[0, 0] ** 2
        + digit.armature[0]
    )
    for q, dq, ddq in random_motions(rng, 1, 50):
        weight = digit.masses[0] * digit.centres_of_mass[0, 0] * 9.81 * np.cos(q)
        assert np.allclose(
            dynamics.inverse_dynamics(digit, q, dq, ddq), inertia * ddq + weight, rtol=1e-12
        )


def test_mass_matrix_is_symmetric_and_positive(digits, rng):
    for digit in digits:
        for q, _, _ in random_motions(rng, digit.joint_count, 200):
            mass = dynamics.mass_matrix(digit, q)
            assert np.array_equal(mass, mass.T)
            assert np.linalg.eigvalsh(mass).min() > 0.0


def test_coriolis_forces_do_no_work_of_their_own(digits, rng):
    """The matrix M' - 2 C is skew-symmetric, with the mass matrix M and the Coriolis matrix C.

    M' is the time derivative of the mass matrix, and q' are the joint rates.

    Because M' - 2 C is skew-symmetric, the power q'^T C q' equals q'^T M' q' / 2.
    """
    for digit in digits:
        for q, dq, _ in random_motions(rng, digit.joint_count, 200):
            step = 1e-6 * dq / np.linalg.norm(dq)
            mass = dynamics.mass_matrix(digit, q + step)
            change = mass - dynamics.mass_matrix(digit, q - step)
            rate = change / 2e-6 * np.linalg.norm(dq)
            power = np.dot(dynamics.bias_torque(digit, q, dq), dq)
            scale = np.abs(dq) @ np.abs(rate) @ np.abs(dq)
            rounding = np.finfo(float).eps * mass.max() / 1e-6 * np.linalg.norm(dq) ** 3
            assert abs(power - 0.5 * dq @ rate @ dq) <= 1e-7 * scale + rounding


def test_gravity_and_springs_are_gradients_of_their_energies(digits, rng):
    for digit in digits:
        digit = digit.with_gravity(rng.normal(size=3) * 6)
        for q, _, _ in random_motions(rng, digit.joint_count, 100):
            for energy, torque in (
                (dynamics.potential_energy, dynamics.gravity_torque),
                (dynamics.spring_energy, dynamics.spring_torque),
            ):
                steps = 1e-5 * np.eye(digit.joint_count)
                slope = [(energy(digit, q + h) - energy(digit, q - h)) / 2e-5 for h in steps]
                assert np.allclose(torque(digit, q), slope, rtol=1e-6, atol=1e-9)


def test_energy_is_conserved(digits):
    """The energy of a digit with springs and weight, but without damping, stays constant.

    The test integrates the motion of the digit with a Runge-Kutta method of fourth order.
    """
    for digit in digits[::3]:
        digit = digit.with_gravity((4.0, -8.0, 3.0))
        n, dt = digit.joint_count, 2e-5

        def state_derivative(state, digit=digit, n=n):
            torque = -np.array(dynamics.spring_torque(digit, state[:n]))
            return np.concatenate(
                (state[n:], dynamics.forward_dynamics(digit, state[:n], state[n:], torque))
            )

        def energy(state, digit=digit, n=n):
            q, dq = state[:n], state[n:]
            stored_energy = dynamics.potential_energy(digit, q) + dynamics.spring_energy(digit, q)
            return dynamics.kinetic_energy(digit, q, dq) + stored_energy

        state = np.concatenate((np.linspace(0.3, 0.9, n), np.linspace(25.0, -20.0, n)))
        start, kinetic_energies = energy(state), []
        for _ in range(2500):
            k1 = state_derivative(state)
            k2 = state_derivative(state + dt / 2 * k1)
            k3 = state_derivative(state + dt / 2 * k2)
            k4 = state_derivative(state + dt * k3)
            state = state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            kinetic_energies.append(dynamics.kinetic_energy(digit, state[:n], state[n:]))
        # A digit without springs exchanges kinetic energy only with its potential energy in
        # gravity.
        assert np.ptp(kinetic_energies) > (0.3 if any(digit.spring_stiffness) else 0.1) * start
        assert abs(energy(state) - start) < 1e-6 * start


def test_sums_are_sums_of_their_parts(digits, rng):
    for digit in digits:
        for q, dq, ddq in random_motions(rng, digit.joint_count, 100):
            rigid_body_torque = np.array(dynamics.inverse_dynamics(digit, q, dq, ddq))
            passive_torque = (
                np.array(digit.spring_stiffness) * (q + digit.spring_preload)
                + np.array(digit.joint_damping) * dq
            )
            assert arrays_agree(
                dynamics.required_torque(digit, q, dq, ddq), rigid_body_torque + passive_torque
            )
            assert arrays_agree(dynamics.passive_torque(digit, q, dq), passive_torque)
            weight = np.array(dynamics.gravity_torque(digit, q))
            assert np.allclose(
                dynamics.static_torque(digit, q),
                weight + dynamics.spring_torque(digit, q),
                rtol=1e-12,
            )
            sum_of_parts = (
                dynamics.mass_matrix(digit, q) @ ddq + dynamics.bias_torque(digit, q, dq) + weight
            )
            assert arrays_agree(rigid_body_torque, sum_of_parts)


def test_reduced_dynamics_is_the_projection(digits, rng):
    for digit in digits:
        coupling = digit.coupling
        for theta, dtheta, ddtheta in random_motions(rng, coupling.shape[1], 100):
            mass, bias_torque = dynamics.reduced_dynamics(digit, theta, dtheta)
            unprojected_torque = dynamics.required_torque(
                digit, coupling @ theta, coupling @ dtheta, coupling @ ddtheta
            )
            assert arrays_agree(
                mass @ ddtheta + bias_torque, coupling.T @ np.array(unprojected_torque)
            )


def test_lists_tuples_and_arrays_give_equal_results(digits, rng):
    for digit in digits:
        q, dq, ddq = next(iter(random_motions(rng, digit.joint_count, 1)))
        torque_from_arrays = dynamics.required_torque(digit, q, dq, ddq)
        assert torque_from_arrays == dynamics.required_torque(
            digit, q.tolist(), tuple(dq.tolist()), ddq.tolist()
        )
        assert all(type(value) is float for value in torque_from_arrays)


def test_known_numbers_of_the_paper_s_finger():
    """The weight torque and the inertia at joint 1 of a finger equal separately computed values.

    The weight torque is compared for a straight finger, and the inertia for a bent finger.
    """
    digit = DigitModel.from_hand(load_hand("jamia"), "index").with_gravity(
        (0.0, 9.81, 0.0)
    )  # gravity acts along -y of the digit
    m1, m2, m3 = digit.masses
    weight = 9.81 * (m1 * 0.015 + m2 * 0.0375 + m3 * 0.050)
    assert np.isclose(dynamics.gravity_torque(digit, (0.0, 0.0, 0.0))[0], weight, rtol=1e-12)
    assert np.isclose(weight, 3.16e-3, rtol=2e-3)
    mass, _ = dynamics.reduced_dynamics(digit, np.array([np.pi / 6]), np.zeros(1))
    assert np.isclose(mass[0, 0], 2.1e-5, rtol=0.2)
