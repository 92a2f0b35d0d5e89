"""Test the control law of the controller.

The torque of the control law is bounded for any input. The torque has no step when the control law
switches between its motion loop and its tension loop. With an exact model and estimate, the hand
follows the commanded motion and tension.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.core.control_law.computed_torque import INTEGRAL_LIMIT_N, MAX_UNWINDING_FORCE_FRACTION
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import MinimumJerk
from handctl.core.estimation.filter_types import STATE_COUNT, S, V, W, X
from handctl.core.gains.gains import Gains, MotionGains
from handctl.core.hand_model import HandModel, _torque_limit
from handctl.hand.hand_loading import load_hand
from handctl.safety.safety_action import SafetyAction
from tests.controller.control_law_runs import ControlLawState, run_control_law, run_control_law_tick
from tests.controller.digit_goals import holding_goals, moving_goals
from tests.controller.synthetic_states import (
    SyntheticEstimate,
    balanced_state,
    estimate_from_states,
    state_with_estimate,
    static_tendon_forces,
    winding_efficiency_of,
)


@pytest.mark.parametrize("torque_gain", [None, 0.5, 1.0, 1.7])
def test_a_saturated_law_asks_no_drive_for_more_than_its_limit(torque_gain: float | None) -> None:
    """The control law divides the torque limit of a motor by the spool radius and by the torque gain.

    After the division, a later computation multiplies the quotient by the spool radius and by the
    torque gain.

    Without a correction of the torque limit, rounding could make the commanded torque exceed this
    limit by one bit.
    """
    hand = load_hand("jamia")
    gains = None if torque_gain is None else np.full(len(hand.tendon), torque_gain)
    rounding_excess_count = 0
    for torque in np.arange(0.3, 1.6, 0.1).round(1).tolist():
        for spool in np.arange(4.0, 9.0, 0.5).tolist():
            motors = [motor.model_copy(update={"torque_max_N_m": torque}) for motor in hand.motor]
            limit = _torque_limit(hand.model_copy(update={"motor": tuple(motors)}), gains)
            requested_force = limit / (spool * 1e-3) * (spool * 1e-3)
            assert (requested_force / (1.0 if gains is None else gains) <= torque).all(), (
                torque,
                spool,
            )
            rounding_excess_count += torque / (spool * 1e-3) * (spool * 1e-3) > torque
    assert rounding_excess_count, "there are numbers that come out larger"


finite_numbers = st.floats(-1e4, 1e4, allow_nan=False)


@given(data=st.data())
def test_torque_is_within_its_limits_for_any_finite_input(
    data: st.DataObject, jamia: HandModel
) -> None:
    n = jamia.tendon_count
    column = st.lists(finite_numbers, min_size=n, max_size=n).map(np.array)
    names = (
        "tension", "travel", "tendon_speed", "excursion", "excursion_rate", "motor_disturbance", "external_tension",
        "stretch_offset",
    )  # fmt: skip
    estimate = estimate_from_states(jamia, np.zeros((n, STATE_COUNT)))._replace(
        **{name: data.draw(column) for name in names}
    )
    estimate = estimate._replace(
        is_slack=np.array(data.draw(st.lists(st.booleans(), min_size=n, max_size=n)))
    )
    state = ControlLawState(*(data.draw(column) for _ in range(5)))
    angle = st.floats(-0.5, 2.6)
    kinds = {
        GoalKind.LIMP: st.just(DigitGoal()),
        GoalKind.MOTION: st.builds(
            lambda a, b, d: DigitGoal(GoalKind.MOTION, MinimumJerk(np.array([a]), np.array([b]), d)),
            angle, angle, st.floats(1e-3, 10.0),
        ),
        GoalKind.TENSION: st.builds(
            lambda f, r: DigitGoal(GoalKind.TENSION, tension=np.array([f]), rate=r),
            finite_numbers, st.floats(0.0, 5000.0),
        ),
    }  # fmt: skip
    goals = tuple(data.draw(kinds[data.draw(st.sampled_from(GoalKind))]) for _ in jamia.digits)
    law, command = run_control_law_tick(
        jamia, state, estimate, goals, data.draw(st.floats(0.0, 100.0))
    )
    assert np.isfinite(command.torque).all()
    assert (command.torque <= jamia.torque_limit * (1 + 1e-12)).all()
    assert (
        command.torque >= -MAX_UNWINDING_FORCE_FRACTION * jamia.torque_limit * (1 + 1e-12)
    ).all()
    is_tension_goal = np.array([goal.kind == GoalKind.TENSION for goal in goals])
    assert (np.abs(law.integral) <= INTEGRAL_LIMIT_N).all()
    assert (law.integral[~is_tension_goal] == 0.0).all()
    assert np.isnan(command.q[: jamia.digits[0].joint_count]).all() == (
        goals[0].kind != GoalKind.MOTION
    )
    for d, goal in enumerate(goals):
        if goal.kind == GoalKind.LIMP:
            assert command.torque[d] == 0.0
            assert np.isnan(command.tension[d])
        if goal.kind == GoalKind.MOTION:
            assert jamia.floor[d] <= command.tension[d] <= jamia.ceiling[d]
        if goal.kind == GoalKind.TENSION:
            target = np.clip(goal.tension, 0.0, jamia.ceiling[d])
            setpoint_before, new_setpoint = state.setpoint[d], law.setpoint[d]
            assert abs(new_setpoint - setpoint_before) <= goal.rate * jamia.period + 1e-9
            assert abs(target - new_setpoint) <= abs(target - setpoint_before) + 1e-9, (
                "towards the target, never past it"
            )


def test_the_change_from_motion_to_tension_control_is_bumpless(model: HandModel) -> None:
    x = balanced_state(model, 0.8)
    estimate = estimate_from_states(model, x)
    law, moved = run_control_law_tick(
        model,
        ControlLawState.initial_state(len(x)),
        estimate,
        moving_goals(model, 0.2, 0.8, 1.0),
        2.0,
    )
    np.testing.assert_allclose(
        law.setpoint, estimate.tension, err_msg="ready to hold what is there"
    )
    for tension in (0.0, 30.0):
        _, hold_command = run_control_law_tick(
            model, law, estimate, holding_goals(model, tension), 2.0 + model.period
        )
        force = (hold_command.torque - moved.torque) / model.tendon_constants.spool_radius
        assert np.abs(force).max() < 2.5 * 200.0 * model.period + 0.2, (
            "one step of the ramp, times the gain"
        )


def test_from_limp_to_tension_the_present_tension_is_the_first_setpoint(model: HandModel) -> None:
    x = balanced_state(model, 0.8)
    estimate = estimate_from_states(model, x)
    law, command = run_control_law_tick(
        model,
        ControlLawState.initial_state(len(x)),
        estimate,
        (DigitGoal(),) * len(model.digits),
        0.0,
    )
    assert not command.torque.any()
    law_after, _ = run_control_law_tick(
        model, law, estimate, holding_goals(model, 0.0, tension_rate=10.0), model.period
    )
    np.testing.assert_allclose(law_after.setpoint, estimate.tension - 10.0 * model.period)


def test_a_pull_never_uses_more_force_than_its_limit(model: HandModel) -> None:
    """Reproduce a defect: the integral part of the tension loop grew without limit while a load cell was silent."""
    law = ControlLawState.initial_state(model.tendon_count)
    silent_estimate = estimate_from_states(model, np.zeros((model.tendon_count, STATE_COUNT)))
    for k in range(300):
        law, command = run_control_law_tick(
            model,
            law,
            silent_estimate,
            holding_goals(model, 50.0, tension_limit=12.0),
            k * model.period,
        )
        assert (
            np.abs(command.torque) <= 12.0 * model.tendon_constants.spool_radius * (1 + 1e-12)
        ).all()
    np.testing.assert_allclose(command.torque, 12.0 * model.tendon_constants.spool_radius)


def test_no_integral_while_the_tendon_is_slack(model: HandModel) -> None:
    law = ControlLawState.initial_state(model.tendon_count)
    slack = estimate_from_states(model, np.zeros((model.tendon_count, STATE_COUNT)))._replace(
        is_slack=np.ones(model.tendon_count, dtype=bool)
    )
    for k in range(50):
        law, _ = run_control_law_tick(
            model, law, slack, holding_goals(model, 20.0), k * model.period
        )
    assert not law.integral.any()
    law, _ = run_control_law_tick(
        model, law, slack._replace(is_slack=~slack.is_slack), holding_goals(model, 20.0), 0.0
    )
    assert (law.integral > 0).all()


def test_a_slack_tendon_is_wound_against_the_friction_of_its_motor(model: HandModel) -> None:
    """Even with a soft tension loop, a commanded tension of 3 N makes a slack tendon taut."""
    law = ControlLawState.initial_state_at_tensions(np.zeros(model.tendon_count))
    slack_estimate = estimate_from_states(
        model, np.zeros((model.tendon_count, STATE_COUNT))
    )._replace(is_slack=np.ones(model.tendon_count, dtype=bool))
    for k in range(round(0.1 / model.period)):
        law, command = run_control_law_tick(
            model, law, slack_estimate, holding_goals(model, 3.0), k * model.period
        )
    assert (
        command.torque / model.tendon_constants.spool_radius
        > model.tendon_constants.coulomb_friction + 2.0
    ).all()
    _, command = run_control_law_tick(
        model,
        ControlLawState.initial_state_at_tensions(np.zeros(model.tendon_count)),
        slack_estimate,
        holding_goals(model, 0.0),
        0.0,
    )
    assert not command.torque.any(), "nothing is wound for nothing"


def test_tension_goals_stay_below_the_ceiling(model: HandModel) -> None:
    law, estimate = (
        ControlLawState.initial_state(model.tendon_count),
        estimate_from_states(model, balanced_state(model, 0.5)),
    )
    for k in range(3000):
        law, command = run_control_law_tick(
            model,
            law,
            estimate,
            holding_goals(model, 5000.0, tension_rate=5000.0),
            k * model.period,
        )
    np.testing.assert_array_equal(law.setpoint, model.ceiling)
    np.testing.assert_array_equal(command.tension, model.ceiling)
    assert (law.integral == INTEGRAL_LIMIT_N).all()


class ClosedLoopPlant:
    """Simulation of rotors, tendons and digits in small time steps.

    The control law under test gets the exact state of this simulation instead of an estimate.

    Attributes:
        tendon_states: (tendons, 7) true states of the tendons.
        digits_fixed: True if the digits of the simulation cannot move.
    """

    STEPS_PER_TICK = 40
    """Number of integration steps that the simulation makes in a tick.

    Small integration steps are necessary because capstan friction reverses within 1 mm/s of tendon
    speed.
    """

    def __init__(self, model: HandModel, filter_states: np.ndarray, digits_are_fixed: bool) -> None:
        self.model, self.tendon_states, self.digits_fixed = (
            model,
            filter_states.copy(),
            digits_are_fixed,
        )
        self.law = ControlLawState.initial_state(model.tendon_count)

    def tick(self, goals: tuple[DigitGoal, ...], tick_index: int) -> None:
        model, space = self.model, self.model.tendon_constants
        self.law, self.command = run_control_law_tick(
            model,
            self.law,
            estimate_from_states(model, self.tendon_states),
            goals,
            tick_index * model.period,
        )
        force, dt = self.command.torque / space.spool_radius, model.period / self.STEPS_PER_TICK
        sliding = self.tendon_states.copy()
        sliding[:, V] = 1.0
        statics = static_tendon_forces(model, sliding, np.zeros(len(sliding)))
        q = model.excursion_to_joints @ sliding[:, S]
        loss, base = -np.log(winding_efficiency_of(model, q)), self.tendon_states[:, S].copy()
        x, v, s, w = (self.tendon_states[:, state_column].copy() for state_column in (X, V, S, W))
        for _ in range(self.STEPS_PER_TICK):
            tension = np.maximum(space.stiffness * (x - s) + space.damping * (v - w), 0.0)
            friction = space.coulomb_friction * np.tanh(v / 2.5e-3) + space.motor_damping * v
            v += dt * (force - tension - friction) / space.motor_mass
            x += dt * v
            if self.digits_fixed:
                continue
            tension_after_friction = tension * np.exp(-loss * np.tanh(w / 1e-3))
            resistance = statics.resistance + space.load_stiffness * (s - base)
            w += (
                dt
                * (tension_after_friction - resistance - space.load_damping * w)
                / space.load_mass
            )
            s += dt * w
        for state_column, value in zip((X, V, S, W), (x, v, s, w), strict=True):
            self.tendon_states[:, state_column] = value

    def joint_angles(self) -> np.ndarray:
        return estimate_from_states(self.model, self.tendon_states).q


def test_the_input_of_the_filter_is_the_force_that_acts(model: HandModel) -> None:
    """The filter gets the motor force minus the mean friction over the control period.

    The test integrates the motion of the rotor in small steps to find the expected mean friction.
    At a low control rate, friction stops the rotor within one control period. If the filter assumed
    constant friction over the period, it would predict that the rotor reverses.
    """
    rng, n, steps = np.random.default_rng(8), model.tendon_count, 400
    space, dt = model.tendon_constants, model.period / 400
    errors, naive = [], []
    for _ in range(50):
        x = balanced_state(model, 0.5)
        x[:, V] = rng.uniform(-0.01, 0.01, n)
        estimate = estimate_from_states(model, x)
        goals = holding_goals(
            model, float(estimate.tension.max()) + rng.uniform(-2.0, 2.0), tension_rate=1e6
        )
        law, command = run_control_law_tick(
            model, ControlLawState.initial_state(n), estimate, goals, 0.0
        )
        requested_force, v, friction_sum = (
            command.torque / space.spool_radius,
            x[:, V].copy(),
            np.zeros(n),
        )
        for _ in range(steps):
            friction = space.coulomb_friction * np.tanh(v / 2.5e-3)
            v += dt * (requested_force - estimate.tension - friction) / space.motor_mass
            friction_sum += friction / steps
        errors.append((law.force - (requested_force - friction_sum)) / space.coulomb_friction)
        naive.append(
            (friction_sum - space.coulomb_friction * np.tanh(x[:, V] / 2.5e-3))
            / space.coulomb_friction
        )
    assert np.abs(errors).max() < 0.5
    assert np.sqrt(np.mean(np.square(errors))) < 0.2
    assert np.sqrt(np.mean(np.square(errors))) < 0.5 * np.sqrt(np.mean(np.square(naive)))


def test_with_perfect_knowledge_the_digit_follows(jamia: HandModel) -> None:
    plant, goals, worst = (
        ClosedLoopPlant(jamia, balanced_state(jamia, 0.1), digits_are_fixed=False),
        moving_goals(jamia, 0.1, 1.0, 0.8),
        0.0,
    )
    for k in range(round(1.2 / jamia.period)):
        plant.tick(goals, k)
        expected = goals[0].trajectory.motion_at((k + 1) * jamia.period)[0][0]  # type: ignore[union-attr]
        worst = max(worst, float(np.abs(plant.joint_angles() - expected).max()))
        assert (plant.command.tension >= jamia.floor).all()
    assert math.degrees(worst) < 1.0
    assert np.degrees(np.abs(plant.joint_angles() - 1.0)).max() < 0.5, "and stays"


def test_with_perfect_knowledge_the_tension_is_held(model: HandModel) -> None:
    """In this test, the digits cannot move, and the control law gets the exact tensions as its estimate."""
    x = np.zeros((model.tendon_count, STATE_COUNT))
    x[:, X] = 10.0 / model.tendon_constants.stiffness
    plant = ClosedLoopPlant(model, x, digits_are_fixed=True)
    plant.law = ControlLawState.initial_state_at_tensions(np.full(len(x), 10.0))
    peak = 0.0
    for k in range(round(2.0 / model.period)):
        plant.tick(holding_goals(model, 30.0, tension_rate=60.0), k)
        tension = estimate_from_states(model, plant.tendon_states).tension
        peak = max(peak, float(tension.max()))
    np.testing.assert_allclose(tension, 30.0, atol=0.3)
    assert peak < 32.0


def test_arguments_are_not_changed(model: HandModel) -> None:
    estimate, state = (
        estimate_from_states(model, balanced_state(model, 0.5)),
        ControlLawState.initial_state(model.tendon_count),
    )
    copies_before = [getattr(estimate, name).copy() for name in SyntheticEstimate._fields]
    first_law_state = run_control_law_tick(model, state, estimate, holding_goals(model, 20.0), 0.0)
    second_law_state = run_control_law_tick(model, state, estimate, holding_goals(model, 20.0), 0.0)
    for name, copy in zip(SyntheticEstimate._fields, copies_before, strict=True):
        np.testing.assert_array_equal(getattr(estimate, name), copy)
    assert not state.setpoint.any()
    np.testing.assert_array_equal(first_law_state[1].torque, second_law_state[1].torque)


@pytest.mark.parametrize("goal_kind", [GoalKind.MOTION, GoalKind.TENSION])
def test_a_goal_without_values_leaves_the_digit_limp(jamia: HandModel, goal_kind: GoalKind) -> None:
    estimate = estimate_from_states(jamia, balanced_state(jamia, 0.5))
    _, command = run_control_law_tick(
        jamia, ControlLawState.initial_state(4), estimate, (DigitGoal(goal_kind),) * 4, 0.0
    )
    assert not command.torque.any()
    state = state_with_estimate(jamia, estimate)
    run_control_law(
        jamia, state, holding_goals(jamia, 30.0, tension_rate=1e6), 0.0, SafetyAction.PASS
    )
    assert (state.view("torque") > 0.0).all()
    run_control_law(jamia, state, (DigitGoal(goal_kind),) * 4, 0.0, SafetyAction.PASS)
    assert not state.view("torque").any(), "whatever was there before"


def test_motion_without_feedforward_has_only_feedback(model: HandModel) -> None:
    """In this test, the feedforward of digit torque, inertia and friction is switched off.

    The tension feedback is also switched off, so that the control law commands only the feedback of
    angle and rate.
    """
    zero_vector = {
        "inertia_share": 0.0,
        "friction_share": 0.0,
        "disturbance_rejection": 0.0,
        "tension_feedback": 0.0,
    }
    gains = Gains(motion=MotionGains(**zero_vector))
    bare_model = replace(
        model, gains=gains, inverse_dynamics=lambda digit, *way: (0.0,) * digit.joint_count
    )
    x = balanced_state(model, 0.5)
    goals = moving_goals(model, 0.2, 0.8, 0.4)
    _, command = run_control_law_tick(
        bare_model,
        ControlLawState.initial_state(len(x)),
        estimate_from_states(model, x),
        goals,
        0.13,
    )
    np.testing.assert_allclose(command.tension, model.floor)
    q, dq = command.q, command.dq
    excursion, rate = model.hand.moment_arms @ q - x[:, S], model.hand.moment_arms @ dq - x[:, V]
    mass = model.tendon_constants.motor_mass + model.tendon_constants.load_mass
    requested_force = model.floor + mass * (
        model.motion_design.stiffness * excursion + model.motion_design.damping * rate
    )
    limit = model.torque_limit / model.tendon_constants.spool_radius
    np.testing.assert_allclose(
        command.torque / model.tendon_constants.spool_radius,
        np.clip(requested_force, -MAX_UNWINDING_FORCE_FRACTION * limit, limit),
    )


def test_the_filter_gets_the_planned_change_of_tension(model: HandModel) -> None:
    """While the motor winds a tendon up against full friction, the tension changes as planned.

    The filter computes the direction of friction from the measured speed of the tendon, and not
    from the planned speed.
    """
    x = balanced_state(model, 0.5)
    x[:, V] = x[:, W] = 0.1
    estimate, goals, law = (
        estimate_from_states(model, x),
        moving_goals(model, 0.2, 0.8, 0.4),
        ControlLawState.initial_state(model.tendon_count),
    )
    law, first_command = run_control_law_tick(model, law, estimate, goals, 0.2)
    assert not law.rate.any(), "nothing was planned before"
    law, second_command = run_control_law_tick(model, law, estimate, goals, 0.2 + model.period)
    np.testing.assert_allclose(
        law.rate, (second_command.tension - first_command.tension) / model.period, rtol=0.1
    )
    assert law.rate.any()
    law, _ = run_control_law_tick(model, law, estimate, holding_goals(model, 20.0), 0.3)
    assert not law.rate.any()
    assert not law.planned.any()


def test_planned_friction_reverses_only_when_the_tendon_does(model: HandModel) -> None:
    x = balanced_state(model, 0.5)
    x[:, V] = x[:, W] = 0.1
    estimate, law = (
        estimate_from_states(model, x),
        ControlLawState.initial_state(model.tendon_count),
    )
    for t, goals in (
        (0.2, moving_goals(model, 0.2, 0.8, 0.4)),
        (0.1, moving_goals(model, 0.5, 0.0, 0.4)),
    ):
        law, _ = run_control_law_tick(model, law, estimate, goals, t)
    later_state, _ = run_control_law_tick(model, law, estimate, goals, 0.1 + model.period)
    assert np.abs((later_state.planned - law.planned) / law.planned).max() < 0.05, (
        "still the friction of a winding cable"
    )
