"""Test targets that jump. A motor that has not yet reacted to a new target does not count as stuck."""

import numpy as np
import pytest

from handctl.controller.controller_state import ControllerState
from handctl.core import tick_stages
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import Vector
from tests.controller.synthetic_states import NO_TELEMETRY, active_state, constant_args_of


def moment_arms_of(model: HandModel) -> np.ndarray:
    return np.asarray(model.hand.moment_arms.sum(axis=1))


def hand_with_equal_readings(
    model: HandModel, target_travel: float | Vector, tick_count: int
) -> ControllerState:
    """Return the state of a hand whose tendons have the targets ``target_travel`` [m].

    In the returned state, the readings of the motor encoders have not changed for ``tick_count``
    ticks.
    """
    state = active_state(model)
    state.view("followed")[...] = target_travel
    state.view("motor_stuck")[...] = tick_count
    return state


def targets_after_command(
    model: HandModel,
    previous_state: ControllerState,
    joint_angle: float,
    excursions: float | Vector = np.nan,
) -> ControllerState:
    """Return the state after a command that moves all joints to ``joint_angle`` [rad].

    The argument ``excursions`` contains the present excursions of the tendons [m].
    """
    state = previous_state.copy()
    state.view("q_goal")[...] = joint_angle
    state.view("excursion")[...] = excursions
    tick_stages.store_commands(
        state.block, state.layout.offsets, *constant_args_of(model), *NO_TELEMETRY
    )
    return state


def filtered_goal_of(state: ControllerState) -> np.ndarray:
    return state.view("followed")


def target_motion_of(state: ControllerState) -> np.ndarray:
    """Return how far the targets have moved [m] since the readings of the motors became constant."""
    return np.abs(filtered_goal_of(state) - state.view("motor_anchor")[0])


def test_filtered_goal_moves_as_fast_as_a_motor(jamia: HandModel) -> None:
    arms, armed = moment_arms_of(jamia), hand_with_equal_readings(jamia, np.nan, 1)

    def state_after_goals(
        angle: float, ticks: int, state: ControllerState = armed
    ) -> ControllerState:
        for _ in range(ticks):
            state = targets_after_command(jamia, state, angle)
        return state

    first_state = state_after_goals(0.2, 1)
    assert filtered_goal_of(first_state) == pytest.approx(arms * 0.2), (
        "the first goal is taken as it is"
    )
    seconds = 0.1
    state_after = state_after_goals(0.4, round(seconds / jamia.period), first_state)
    assert filtered_goal_of(state_after) == pytest.approx(
        arms * (0.4 - 0.2 * np.exp(-1.0)), rel=0.02
    )
    assert filtered_goal_of(state_after_goals(0.4, 1000, state_after)) == pytest.approx(
        arms * 0.4, rel=1e-6
    )
    state_after_small_step = state_after_goals(
        0.4 + 1e-5, 1, state_after_goals(0.4, 1000, state_after)
    )
    assert filtered_goal_of(state_after_small_step) == pytest.approx(
        arms * (0.4 + 1e-5), rel=1e-9
    ), "what goes slowly is followed at once"
    limp_state = targets_after_command(jamia, state_after, np.nan)
    assert np.isnan(filtered_goal_of(limp_state)).all()
    assert filtered_goal_of(state_after_goals(0.1, 1, limp_state)) == pytest.approx(arms * 0.1), (
        "after a hold it begins anew"
    )


def test_a_goal_that_went_ahead_while_the_motor_moved_is_no_reason_to_move_on(
    jamia: HandModel,
) -> None:
    """In this test, friction stops a motor before it reaches its target.

    The motor counts as stuck only if the target has moved since the motor stopped.
    """
    arms = moment_arms_of(jamia)
    state_after_command = targets_after_command(
        jamia, hand_with_equal_readings(jamia, arms * 0.1, 0), 0.4, arms * 0.3
    )
    np.testing.assert_allclose(filtered_goal_of(state_after_command), arms * 0.4)
    goal_at_rest = state_after_command.copy()
    goal_at_rest.view("motor_stuck")[...] = 1
    later_targets = targets_after_command(jamia, goal_at_rest, 0.4, arms * 0.3)
    np.testing.assert_array_equal(
        filtered_goal_of(later_targets), filtered_goal_of(state_after_command)
    )


def test_motor_at_rest_at_its_goal_is_not_stuck(jamia: HandModel) -> None:
    """After a quick motion, the filtered target lags behind the motor.

    The filtered target must not continue to move after the motor has come to rest at its goal.
    """
    arms = moment_arms_of(jamia)
    at_goal, lagging = arms * 0.4, hand_with_equal_readings(jamia, arms * 0.2, 0)
    lagging.view("motor_anchor")[...] = 1e-3
    resting_targets = targets_after_command(jamia, lagging, 0.4, at_goal)
    np.testing.assert_array_equal(
        filtered_goal_of(resting_targets), at_goal, "while it still moves, as it arrives"
    )
    np.testing.assert_allclose(
        target_motion_of(resting_targets),
        target_motion_of(lagging),
        atol=1e-12,
        err_msg="a leap moved no motor",
    )
    later_targets = targets_after_command(jamia, resting_targets, 0.4, at_goal)
    np.testing.assert_array_equal(
        filtered_goal_of(later_targets), filtered_goal_of(resting_targets)
    )
    stuck_targets = targets_after_command(jamia, lagging, 0.4, arms * 0.1)
    assert (filtered_goal_of(stuck_targets) > filtered_goal_of(lagging)).all(), (
        "one that is elsewhere is judged as before"
    )
