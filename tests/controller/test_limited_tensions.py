"""Test the control law with limits on the tensions.

The tensions of a hand are limited while a drive is warm, and while the safety monitor holds the
hand (HOLD). Further tests check the motor force that the control law adds after a change of gains,
so that the command has no step.
"""

import numpy as np
import pytest

from handctl.core.control_law.computed_torque import MIN_TRIM_N, TRIM_DECAY_TIME_S
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.hand_model import HandModel
from tests.controller.control_law_runs import ControlLawState, run_control_law_tick
from tests.controller.digit_goals import holding_goals, moving_goals
from tests.controller.synthetic_states import estimate_under_tension

HIGH_TENSION_N = 60.0


IMMEDIATE_RATE_N_PER_S = 1e6
"""Rate of change with which the setpoint of a tension reaches its goal within one tick [N/s]."""


def idle_control_law_state(model: HandModel) -> ControlLawState:
    return ControlLawState.initial_state_at_tensions(np.full(model.tendon_count, 20.0))


@pytest.mark.parametrize(
    ("temperature_limit", "held_limit", "expected_limit"),
    [(15.0, None, 15.0), (None, 12.0, 12.0), (15.0, 12.0, 12.0), (9.0, 12.0, 9.0)],
)
def test_the_lower_limit_counts_for_tension_and_for_torque(
    jamia: HandModel,
    temperature_limit: float | None,
    held_limit: float | None,
    expected_limit: float,
) -> None:
    n = jamia.tendon_count
    tension_limits, hold_limits = (
        None if value is None else np.full(n, value) for value in (temperature_limit, held_limit)
    )
    law, command = run_control_law_tick(
        jamia,
        idle_control_law_state(jamia),
        estimate_under_tension(jamia, 0.0),
        holding_goals(jamia, HIGH_TENSION_N, IMMEDIATE_RATE_N_PER_S),
        0.0,
        tension_limits,
        hold_limits,
    )
    np.testing.assert_allclose(command.tension, expected_limit)
    requested_force = command.torque / jamia.tendon_constants.spool_radius
    np.testing.assert_allclose(
        requested_force, expected_limit + jamia.tendon_constants.coulomb_friction
    )
    np.testing.assert_allclose(law.setpoint, expected_limit)
    np.testing.assert_array_equal(law.held, hold_limits)


def test_without_a_limit_the_goal_is_not_changed(jamia: HandModel) -> None:
    law, command = run_control_law_tick(
        jamia,
        idle_control_law_state(jamia),
        estimate_under_tension(jamia, 0.0),
        holding_goals(jamia, HIGH_TENSION_N, IMMEDIATE_RATE_N_PER_S),
        0.0,
    )
    np.testing.assert_allclose(command.tension, HIGH_TENSION_N)
    assert (command.torque / jamia.tendon_constants.spool_radius > HIGH_TENSION_N).all()
    assert law.held is None


def test_on_its_way_a_digit_pulls_no_more_than_its_limit_and_stands_while_safety_holds(
    jamia: HandModel,
) -> None:
    n = jamia.tendon_count
    free = run_control_law_tick(
        jamia,
        idle_control_law_state(jamia),
        estimate_under_tension(jamia, 5.0),
        moving_goals(jamia, 0.0, 1.2, 0.2),
        0.1,
    )[1]
    limited_command = run_control_law_tick(
        jamia,
        idle_control_law_state(jamia),
        estimate_under_tension(jamia, 5.0),
        moving_goals(jamia, 0.0, 1.2, 0.2),
        0.1,
        None,
        np.full(n, 6.0),
    )[1]
    assert (
        free.torque / jamia.tendon_constants.spool_radius
        > 6.0 + jamia.tendon_constants.coulomb_friction
    ).all()
    np.testing.assert_array_less(
        limited_command.torque / jamia.tendon_constants.spool_radius,
        6.0 + jamia.tendon_constants.coulomb_friction + 1e-9,
    )
    np.testing.assert_allclose(limited_command.q, free.q)
    assert (np.abs(free.dq) > 0.1).all()
    assert not limited_command.dq.any(), "the place on the way is the goal then, its speed is not"


@pytest.mark.parametrize("held_limit", [True, False])
def test_a_trim_is_added_and_fades(jamia: HandModel, held_limit: bool) -> None:
    requested_force = (
        holding_goals(jamia, 20.0, IMMEDIATE_RATE_N_PER_S)
        if held_limit
        else moving_goals(jamia, 0.0, 1.2, 0.2)
    )
    plain = run_control_law_tick(
        jamia,
        idle_control_law_state(jamia),
        estimate_under_tension(jamia, 20.0),
        requested_force,
        0.0,
    )[1]
    state_with_trim = idle_control_law_state(jamia)._replace(trim=np.full(jamia.tendon_count, 2.0))
    law, command = run_control_law_tick(
        jamia, state_with_trim, estimate_under_tension(jamia, 20.0), requested_force, 0.0
    )
    np.testing.assert_allclose(
        (command.torque - plain.torque) / jamia.tendon_constants.spool_radius, 2.0
    )
    assert law.trim is not None
    np.testing.assert_allclose(law.trim, 2.0 * np.exp(-jamia.period / TRIM_DECAY_TIME_S), rtol=1e-3)
    state_with_small_trim = state_with_trim._replace(
        trim=np.full(jamia.tendon_count, MIN_TRIM_N / 2)
    )
    assert (
        run_control_law_tick(
            jamia, state_with_small_trim, estimate_under_tension(jamia, 20.0), requested_force, 0.0
        )[0].trim
        is None
    )


def test_limp_digits_have_no_trim(jamia: HandModel) -> None:
    goals = (*holding_goals(jamia, 20.0, IMMEDIATE_RATE_N_PER_S)[:3], DigitGoal(GoalKind.LIMP))
    state_with_trim = idle_control_law_state(jamia)._replace(trim=np.full(jamia.tendon_count, 2.0))
    _, command = run_control_law_tick(
        jamia, state_with_trim, estimate_under_tension(jamia, 20.0), goals, 0.0
    )
    assert command.torque[3] == 0.0
    assert np.isnan(command.tension[3])
