"""Test how each term of the control law makes the motor force depend on the estimate and on the trajectory."""

from dataclasses import replace

import numpy as np
import pytest

from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.control_law.computed_torque import MOTOR_FRICTION_SPEED_M_S
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import MinimumJerk
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from tests.controller.control_law_runs import (
    ControlLawState,
    control_law_command_of,
    control_law_state_of,
    run_control_law_tick,
)
from tests.controller.digit_goals import holding_goals, moving_goals
from tests.controller.synthetic_states import (
    SyntheticEstimate,
    active_state,
    balanced_state,
    constant_args_of,
    estimate_from_states,
    estimate_under_tension,
    slack_hand_estimate,
)

EVALUATION_TIME_S = 0.25
"""Time at which the control law is evaluated [s].

At ``EVALUATION_TIME_S``, the motion of one second still accelerates.
"""


def motor_force_of(
    model: HandModel, estimate: SyntheticEstimate, goals: tuple[DigitGoal, ...]
) -> np.ndarray:
    """Return the force of each motor [N] that the control law commands for an estimate and for goals."""
    state = ControlLawState.initial_state_at_tensions(estimate.tension)
    return (
        run_control_law_tick(model, state, estimate, goals, EVALUATION_TIME_S)[1].torque
        / model.tendon_constants.spool_radius
    )


@pytest.fixture
def motion_goals(model: HandModel) -> tuple[DigitGoal, ...]:
    return moving_goals(model, 0.4, 0.6, 1.0)


@pytest.fixture
def estimate(model: HandModel) -> SyntheticEstimate:
    return estimate_from_states(model, balanced_state(model, 0.42))


def test_motion_feedback_applies_each_gain(
    model: HandModel, motion_goals: tuple[DigitGoal, ...], estimate: SyntheticEstimate
) -> None:
    space, gains, design = model.tendon_constants, model.gains.motion, model.motion_design
    mass = space.motor_mass + space.load_mass
    motor_force_before = motor_force_of(model, estimate, motion_goals)
    for name, size, slope in (
        ("motor_disturbance", 0.5, -gains.disturbance_rejection),
        ("tension", 0.4, -gains.tension_feedback),
        ("tendon_speed", 1e-3, gains.friction_share * space.motor_damping - mass * design.damping),
        ("excursion", 2e-5, -mass * design.stiffness),
    ):
        motor_force_after = motor_force_of(
            model, estimate._replace(**{name: getattr(estimate, name) + size}), motion_goals
        )
        np.testing.assert_allclose(
            motor_force_after - motor_force_before, slope * size, rtol=1e-6, atol=1e-9, err_msg=name
        )


def test_the_planned_acceleration_is_fed_forward(
    model: HandModel, motion_goals: tuple[DigitGoal, ...], estimate: SyntheticEstimate
) -> None:
    """Without inertia feedforward, the commanded force is smaller by the inertia times the planned acceleration."""
    gains_without_inertia = model.gains.motion.model_copy(update={"inertia_share": 0.0})
    other_model = replace(
        model, gains=model.gains.model_copy(update={"motion": gains_without_inertia})
    )
    acceleration = np.zeros(model.tendon_count)
    for digit, tendons, goal in zip(model.digits, model.digit_tendons, motion_goals, strict=True):
        acceleration[tendons] = (
            digit.reduced_moment_arms @ goal.trajectory.motion_at(EVALUATION_TIME_S)[2]
        )
    force_difference = motor_force_of(model, estimate, motion_goals) - motor_force_of(
        other_model, estimate, motion_goals
    )
    assert (acceleration > 0.0).all()
    np.testing.assert_allclose(
        force_difference,
        model.gains.motion.inertia_share * model.tendon_constants.motor_mass * acceleration,
        rtol=1e-9,
    )


def test_the_disturbance_estimate_is_subtracted_in_a_hold(model: HandModel) -> None:
    estimate = estimate_under_tension(model, 20.0)
    off = estimate._replace(motor_disturbance=np.full(model.tendon_count, 0.5))
    change = motor_force_of(model, off, holding_goals(model, 20.0)) - motor_force_of(
        model, estimate, holding_goals(model, 20.0)
    )
    np.testing.assert_allclose(change, -0.5 * model.gains.motion.disturbance_rejection, rtol=1e-9)


def test_an_idle_control_law_forgets_earlier_commands(model: HandModel) -> None:
    """After a tick without torque, the tension loop starts at the present tension.

    Commands before the tick without torque have no effect on the tension loop.
    """
    state, tension = active_state(model), np.linspace(3.0, 4.0, model.tendon_count)
    for name in (
        "setpoint",
        "integral",
        "force",
        "planned",
        "rate",
        "trim",
        "torque",
        "friction_state",
        "friction_slider",
    ):
        state.view(name)[...] = 7.0
    state.view("tension")[...] = tension
    state.run_integers[s.TRIM_ACTIVE] = 1
    state.run_integers[s.SAFETY_HOLD_ACTIVE] = 1
    state.mode = HandMode.READY
    tick_stages.compute_motor_torques(
        state.block, state.layout.offsets, *constant_args_of(model), 0.0, 0, 1
    )
    law, command = control_law_state_of(state), control_law_command_of(state)
    np.testing.assert_array_equal(law.setpoint, tension)
    for law_field in law[1:5]:
        assert not law_field.any()
    assert (law.trim, law.held) == (None, None)
    assert np.isnan(law.friction_state).all()
    assert np.isnan(law.friction_slider).all()
    for name, size, value in (
        ("torque", model.tendon_count, 0.0), ("tension", model.tendon_count, np.nan),
        ("joint_torque", len(model.hand.joints), 0.0), ("q", len(model.hand.joints), np.nan),
        ("dq", len(model.hand.joints), np.nan),
    ):  # fmt: skip
        np.testing.assert_array_equal(getattr(command, name), np.full(size, value), err_msg=name)


def test_a_holding_hand_has_no_goal_angles(model: HandModel) -> None:
    estimate = estimate_under_tension(model, 20.0)
    command = run_control_law_tick(
        model,
        ControlLawState.initial_state_at_tensions(estimate.tension),
        estimate,
        holding_goals(model, 20.0),
        EVALUATION_TIME_S,
    )[1]
    joints = len(model.hand.joints)
    assert [np.isnan(goal).tolist() for goal in (command.q, command.dq)] == [[True] * joints] * 2


def test_the_hold_law_opposes_speed_and_tension_error(model: HandModel) -> None:
    """In a digit that holds a tension, the control law opposes tension errors and damps the motion of the motor."""
    estimate, goals, design = (
        estimate_under_tension(model, 20.0),
        holding_goals(model, 20.0),
        model.motion_design,
    )
    state = ControlLawState.initial_state_at_tensions(estimate.tension)
    force_before = (
        run_control_law_tick(model, state, estimate, goals, EVALUATION_TIME_S)[1].torque
        / model.tendon_constants.spool_radius
    )
    integral = 1.0 + model.gains.tension.integral_per_s * model.period / design.tension
    for name, size, slope in (
        ("tendon_speed", 1e-3, -design.tension_speed),
        ("tension", 0.4, -design.tension * integral),
    ):
        off = estimate._replace(**{name: getattr(estimate, name) + size})
        force_after = (
            run_control_law_tick(model, state, off, goals, EVALUATION_TIME_S)[1].torque
            / model.tendon_constants.spool_radius
        )
        np.testing.assert_allclose(
            force_after - force_before, slope * size, rtol=1e-6, err_msg=name
        )


def test_rotor_forces_of_a_planned_motion_are_fed_forward_in_a_hold(model: HandModel) -> None:
    estimate, space = estimate_under_tension(model, 20.0), model.tendon_constants
    goals_at_rest = holding_goals(model, 20.0)
    start, end, since = 0.4, 0.7, 0.1
    trajectories = [
        MinimumJerk(np.full(d.coupling.shape[1], start), np.full(d.coupling.shape[1], end), 1.0)
        for d in model.digits
    ]
    goals = tuple(
        replace(goal, trajectory=trajectory, since=since)
        for goal, trajectory in zip(goals_at_rest, trajectories, strict=True)
    )
    speed, acceleration = np.zeros((2, model.tendon_count))
    for digit, tendons, trajectory in zip(
        model.digits, model.digit_tendons, trajectories, strict=True
    ):
        speed[tendons], acceleration[tendons] = (
            trajectory.motion_at(EVALUATION_TIME_S - since)[1:] @ digit.reduced_moment_arms.T
        )
    required_force = (
        space.coulomb_friction * np.tanh(speed / MOTOR_FRICTION_SPEED_M_S)
        + space.motor_mass * acceleration
    )
    required_force += (model.motion_design.tension_speed + space.motor_damping) * speed
    np.testing.assert_allclose(
        motor_force_of(model, estimate, goals) - motor_force_of(model, estimate, goals_at_rest),
        required_force,
        rtol=1e-9,
    )
    goals_with_one_motion = (goals[0], *goals_at_rest[1:])
    change = motor_force_of(model, estimate, goals_with_one_motion) - motor_force_of(
        model, estimate, goals_at_rest
    )
    first_tendons = model.digit_tendons[0]
    np.testing.assert_allclose(change[first_tendons], required_force[first_tendons], rtol=1e-9)
    assert not np.delete(change, first_tendons).any(), "no other digit is in motion"


def test_a_slack_tendon_with_a_small_setpoint_still_gets_friction_compensation(
    model: HandModel,
) -> None:
    slack_estimate = slack_hand_estimate(model)
    estimate_of_taut_tendons = slack_estimate._replace(
        is_slack=np.zeros(model.tendon_count, dtype=bool)
    )
    state = ControlLawState.initial_state_at_tensions(np.full(model.tendon_count, 0.5))
    goals = holding_goals(model, 0.5)
    slack_torque = run_control_law_tick(model, state, slack_estimate, goals, EVALUATION_TIME_S)[
        1
    ].torque
    taut_torque = run_control_law_tick(
        model, state, estimate_of_taut_tendons, goals, EVALUATION_TIME_S
    )[1].torque
    np.testing.assert_allclose(
        (slack_torque - taut_torque) / model.tendon_constants.spool_radius,
        model.tendon_constants.coulomb_friction,
        rtol=0.02,
    )


def test_the_goal_tension_of_a_motion_stays_within_its_limit(
    model: HandModel, motion_goals: tuple[DigitGoal, ...], estimate: SyntheticEstimate
) -> None:
    free_tension = run_control_law_tick(
        model,
        ControlLawState.initial_state_at_tensions(estimate.tension),
        estimate,
        motion_goals,
        EVALUATION_TIME_S,
    )[1].tension
    state, tension_limits = (
        ControlLawState.initial_state_at_tensions(estimate.tension),
        np.maximum(0.5 * free_tension, model.floor),
    )
    held_tension = run_control_law_tick(
        model, state, estimate, motion_goals, EVALUATION_TIME_S, tension_limits
    )[1].tension
    np.testing.assert_allclose(held_tension, tension_limits)


def test_a_limp_hand_has_no_joint_torque_and_no_goal_tension(model: HandModel) -> None:
    estimate = estimate_under_tension(model, 10.0)
    command = run_control_law_tick(
        model,
        ControlLawState.initial_state_at_tensions(estimate.tension),
        estimate,
        (DigitGoal(),) * len(model.digits),
        EVALUATION_TIME_S,
    )[1]
    assert not command.joint_torque.any()
    assert np.isnan(command.tension).all()


def test_only_moving_digits_have_goal_angles(model: HandModel, estimate: SyntheticEstimate) -> None:
    goals = (*moving_goals(model, 0.4, 0.6, 1.0)[:2], *holding_goals(model, 12.0)[2:])
    law, command = run_control_law_tick(
        model,
        ControlLawState.initial_state_at_tensions(estimate.tension),
        estimate,
        goals,
        EVALUATION_TIME_S,
    )
    tendons, joints = model.digit_tendons[1].stop, model.digits[1].joints.stop
    for angles in (command.q, command.dq):
        assert np.isfinite(angles[:joints]).all()
        assert np.isnan(angles[joints:]).all()
    assert law.friction_state is not None
    assert np.isnan(law.friction_state[tendons:]).all()
    expected_joint_torque = (
        np.where(np.arange(model.tendon_count) < tendons, 0.0, law.setpoint)
        @ model.hand.moment_arms
    )
    np.testing.assert_allclose(
        command.joint_torque[joints:], expected_joint_torque[joints:], rtol=1e-12
    )
    assert goals[2].kind == GoalKind.TENSION
