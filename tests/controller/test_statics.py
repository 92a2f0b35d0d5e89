"""Test the static forces of a hand model.

Static forces along the tendons must equal the derivatives of the potential energy. Static forces at
the fingertips must satisfy the principle of virtual work.
"""

import math

import numpy as np
import pytest

from handctl.compiled import kernel
from handctl.core import tick_stages
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import constant_tables
from handctl.core.estimation import statics
from handctl.core.estimation.filter_types import STATE_COUNT, S, V
from handctl.core.estimation.tip_force import reduced_tip_lever, tip_force
from handctl.core.hand_model import HandModel
from handctl.hand.dynamics import potential_energy, spring_energy, static_torque
from handctl.hand.kinematics import forward_kinematics, tip_jacobian
from tests.controller.synthetic_states import (
    NO_TELEMETRY,
    active_state,
    constant_args_of,
    static_tendon_forces,
    winding_efficiency_of,
)


@kernel("constants", "layout", "vector")
def _static_torque(block: BlockArray, constant_offsets: TableOffsets, q: np.ndarray) -> np.ndarray:
    torque = np.empty(len(q))
    statics.write_static_torque(constant_tables(block, constant_offsets), q, torque)
    return torque


def static_torque_of(model: HandModel, q: np.ndarray) -> np.ndarray:
    """Return the torque of gravity and springs at each joint [N m], as the estimator computes it."""
    return _static_torque(*constant_args_of(model), q)


def filter_states_at_angles(
    model: HandModel, joint_angles: list[np.ndarray], tendon_speed: float = 0.0
) -> np.ndarray:
    """Return filter states (tendons, 7) of a hand whose digits have the joint angles ``joint_angles``."""
    table = np.zeros((model.tendon_count, STATE_COUNT))
    for digit, tendons, joint_angle in zip(
        model.digits, model.digit_tendons, joint_angles, strict=True
    ):
        table[tendons, S] = digit.reduced_moment_arms @ joint_angle
    table[:, V] = tendon_speed
    return table


def test_resistance_is_the_slope_of_the_stored_energy(model: HandModel) -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        theta = [rng.uniform(0.1, 1.4, digit.coupling.shape[1]) for digit in model.digits]
        resistance = static_tendon_forces(
            model, filter_states_at_angles(model, theta), np.zeros(model.tendon_count)
        ).resistance
        for digit, tendons, angle in zip(model.digits, model.digit_tendons, theta, strict=True):
            h = 1e-6

            def energy(joint_coordinates: np.ndarray, digit=digit) -> float:  # type: ignore[no-untyped-def]
                q = digit.coupling @ joint_coordinates
                return potential_energy(digit, q) + spring_energy(digit, q)

            slope = np.array(
                [
                    (energy(angle + h * e) - energy(angle - h * e)) / (2 * h)
                    for e in np.eye(len(angle))
                ]
            )
            np.testing.assert_allclose(
                digit.reduced_moment_arms.T @ resistance[tendons], slope, rtol=1e-6, atol=1e-9
            )


def test_friction_takes_from_a_closing_tendon_and_gives_to_an_opening_one(model: HandModel) -> None:
    theta = [np.full(digit.coupling.shape[1], 0.6) for digit in model.digits]
    tension = np.full(model.tendon_count, 20.0)
    at_rest, closing, opening = (
        static_tendon_forces(model, filter_states_at_angles(model, theta, v), tension)
        for v in (0.0, 0.05, -0.05)
    )
    np.testing.assert_allclose(at_rest.force_at_joints, tension)
    assert (closing.force_at_joints < tension).all()
    assert (opening.force_at_joints > tension).all()
    np.testing.assert_allclose(
        closing.force_at_joints * opening.force_at_joints, tension**2, rtol=0.12
    )
    known_forces = static_tendon_forces(
        model,
        filter_states_at_angles(model, theta, -0.05),
        tension,
        np.full(model.tendon_count, 1.0),
    )
    np.testing.assert_allclose(
        known_forces.force_at_joints,
        closing.force_at_joints,
        err_msg="what is known of friction goes before the speed",
    )
    np.testing.assert_allclose(
        known_forces.driving_force,
        opening.force_at_joints,
        err_msg="but leaving a stop goes by the speed, or 0.5 deg are lost",
    )
    np.testing.assert_array_equal(at_rest.resistance, closing.resistance)


def test_pull_is_what_the_capstan_leaves_at_each_pulley(model: HandModel) -> None:
    """The force that reaches the joints is the tension minus the capstan friction at each pulley.

    The test covers small and large capstan friction in both directions.
    """
    rng = np.random.default_rng(7)
    theta = [rng.uniform(0.1, 1.4, digit.coupling.shape[1]) for digit in model.digits]
    q = np.concatenate(
        [digit.coupling @ angle for digit, angle in zip(model.digits, theta, strict=True)]
    )
    tension, developed_torque = (
        rng.uniform(5.0, 60.0, model.tendon_count),
        rng.uniform(-1.0, 1.0, model.tendon_count),
    )
    torque = np.zeros(len(q))
    for i, tendon in enumerate(model.hand.tendon):
        passed_angle = tendon.wrap_angle_rad
        for j, joint in enumerate(model.hand.joints):
            arm = tendon.moment_arm_m.get(joint, 0.0)
            passed_angle += q[j] if arm else 0.0
            torque[j] += (
                arm
                * tension[i]
                * math.exp(-tendon.friction_coefficient * developed_torque[i] * passed_angle)
            )
    load = static_tendon_forces(
        model, filter_states_at_angles(model, theta), tension, developed_torque
    )
    np.testing.assert_allclose(load.force_at_joints, model.torque_to_tension @ torque, rtol=1e-9)


def test_efficiency_is_the_mean_of_the_capstan_over_the_pulleys(model: HandModel) -> None:
    rng = np.random.default_rng(7)
    q = rng.uniform(0.0, 1.4, len(model.hand.joints))
    winding_efficiency = winding_efficiency_of(model, q)
    for i, tendon in enumerate(model.hand.tendon):
        passed_angle, shares, arms = tendon.wrap_angle_rad, 0.0, 0.0
        for joint, angle in zip(model.hand.joints, q, strict=True):
            arm = abs(tendon.moment_arm_m.get(joint, 0.0))
            passed_angle += angle if arm else 0.0
            shares += arm * math.exp(-tendon.friction_coefficient * passed_angle)
            arms += arm
        assert winding_efficiency[i] == pytest.approx(shares / arms, rel=1e-12)


def test_all_digits_at_once_are_the_digits_one_by_one(model: HandModel) -> None:
    rng = np.random.default_rng(8)
    for _ in range(50):
        q, external_tension = (
            rng.uniform(-0.2, 1.8, len(model.hand.joints)),
            rng.normal(size=model.tendon_count) * 20.0,
        )
        torque = static_torque_of(model, q)
        state = active_state(model)
        state.view("q")[...], state.view("external")[...] = q, external_tension
        tick_stages.store_commands(
            state.block, state.layout.offsets, *constant_args_of(model), *NO_TELEMETRY
        )
        force = state.view("tip_force")
        for d, digit in enumerate(model.digits):
            np.testing.assert_allclose(
                torque[digit.joints],
                static_torque(digit, q[digit.joints]),
                rtol=1e-12,
                atol=1e-15,
            )
            tip_force_of_digit = tip_force(digit, q[digit.joints], external_tension[digit.tendons])
            assert force[d] == pytest.approx(tip_force_of_digit, rel=1e-10, abs=1e-12)


def test_lever_is_the_jacobian_along_the_normal(model: HandModel) -> None:
    rng = np.random.default_rng(5)
    for digit in model.digits:
        for _ in range(20):
            q = rng.uniform(0.0, 1.6, digit.joint_count)
            expected = (
                digit.coupling.T
                @ tip_jacobian(digit, q).T
                @ forward_kinematics(digit, q).rotation[:, 1]
            )
            np.testing.assert_allclose(reduced_tip_lever(digit, q), expected, atol=1e-15)


def test_a_tip_force_is_recovered_from_its_tensions(model: HandModel) -> None:
    """Convert a normal force at the tip of a digit to the tensions that balance this force, and back.

    The estimator must compute the original tip force from the tensions.
    """
    rng = np.random.default_rng(6)
    for digit in model.digits:
        for force in (0.5, 6.0, 40.0):
            q = digit.coupling @ rng.uniform(0.1, 1.2, digit.coupling.shape[1])
            torque = force * reduced_tip_lever(digit, q)
            external_tension = np.linalg.lstsq(digit.reduced_moment_arms.T, torque, rcond=None)[0]
            assert tip_force(digit, q, external_tension) == pytest.approx(force, rel=1e-9)
            assert tip_force(digit, q, np.zeros(len(external_tension))) == 0.0
