"""Test the limits that the controller sets on tensions.

The tension limit of a warm drive falls linearly as the drive gets warmer. While the safety monitor
holds the hand (HOLD), no tension rises and no goal moves.
"""

import math

import numpy as np
import pytest

from handctl.campaign.fault_matrix import GRASP_STAGE
from handctl.campaign.run_stages import advance_to_stage, hand_with_protocol, homed_run
from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.control_law.computed_torque import HOLD_MARGIN_N
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.safety.safety_action import SafetyAction
from tests.controller.control_law_runs import (
    ControlLawState,
    run_control_law_tick,
    tension_limits_of,
)
from tests.controller.digit_goals import holding_goals, moving_goals
from tests.controller.synthetic_states import active_state, estimate_under_tension


def tension_limits_at(model: HandModel, temperatures_degC: tuple[float, ...]) -> np.ndarray:
    """Return the tension limit of each tendon [N] if the drives have given temperatures [degC].

    The tension limit of a drive that is not warm is infinite.
    """
    state = active_state(model)
    state.view("temperature")[...] = temperatures_degC
    return tension_limits_of(model, state)


@pytest.mark.parametrize(("temperature_degC", "limit_fraction"), [
    (70.1, 0.9933), (73.0, 0.8), (77.5, 0.5), (84.0, 0.0667), (85.0, 0.0), (200.0, 0.0),
])  # fmt: skip
def test_the_limit_falls_linearly_from_the_soft_to_the_hard_temperature(
    jamia: HandModel, temperature_degC: float, limit_fraction: float
) -> None:
    tension_limits = tension_limits_at(jamia, (20.0, temperature_degC, math.nan, 70.0))
    assert tension_limits[1] == pytest.approx(
        jamia.floor[1] + limit_fraction * (jamia.ceiling[1] - jamia.floor[1]), rel=1e-3
    )
    assert tension_limits[[0, 2, 3]].tolist() == jamia.ceiling[[0, 2, 3]].tolist(), (
        "cool, unknown, just at the limit"
    )


@pytest.mark.parametrize("temperatures_degC", [(20.0, 70.0, math.nan, 0.0), (math.nan,) * 4])
def test_a_cool_hand_is_not_restrained(
    jamia: HandModel, temperatures_degC: tuple[float, ...]
) -> None:
    assert np.isinf(tension_limits_at(jamia, temperatures_degC)).all()


def test_neither_loop_commands_more_than_the_allowed_tension(jamia: HandModel) -> None:
    tension_limits, estimate = (
        np.array([9.0, 140.0, 140.0, 12.0]),
        estimate_under_tension(jamia, 20.0),
    )
    state = ControlLawState.initial_state_at_tensions(estimate.tension)
    for _ in range(200):
        state, command = run_control_law_tick(
            jamia, state, estimate, holding_goals(jamia, 60.0), 0.0, tension_limits
        )
    assert command.tension.tolist() == pytest.approx([9.0, 60.0, 60.0, 12.0], abs=1e-9)
    force = command.torque / jamia.tendon_constants.spool_radius
    assert (force <= tension_limits + jamia.tendon_constants.coulomb_friction + 1e-9).all()
    assert force[1] > 30.0
    _, command = run_control_law_tick(
        jamia,
        ControlLawState.initial_state_at_tensions(estimate.tension),
        estimate,
        moving_goals(jamia, 1.0, 1.0, 1.0),
        2.0,
        tension_limits,
    )
    assert command.tension[0] <= 9.0 + 1e-9
    assert (
        command.torque / jamia.tendon_constants.spool_radius
        <= tension_limits + jamia.tendon_constants.coulomb_friction + 1e-9
    ).all()


def test_a_goal_has_no_speed_while_its_time_is_stopped(jamia: HandModel) -> None:
    estimate, goals = estimate_under_tension(jamia, 20.0), moving_goals(jamia, 0.0, 1.5, 1.0)
    law, held_command = run_control_law_tick(
        jamia,
        ControlLawState.initial_state_at_tensions(estimate.tension),
        estimate,
        goals,
        0.5,
        None,
        np.full(4, 300.0),
    )
    _, moving_command = run_control_law_tick(
        jamia, ControlLawState.initial_state_at_tensions(estimate.tension), estimate, goals, 0.5
    )
    assert held_command.q.tolist() == moving_command.q.tolist()
    assert (moving_command.dq > 1.0).all()
    assert not held_command.dq.any()
    assert law.held is not None


@pytest.fixture(scope="module")
def warm_grasp():
    """Yield the run of a hand with drives in MIT mode. The hand holds a cylinder."""
    with homed_run(hand_with_protocol("jamia", "mit"), 250.0, 0) as run:
        advance_to_stage(run, GRASP_STAGE)
        run.run_until(lambda out: False, 0.6)  # the tensions settle
        yield run


def test_derating_affects_the_warm_drive_only(warm_grasp) -> None:
    """The tension limit of a drive falls while the drive warms from 70 to 85 degC.

    At a drive temperature of 84 degC, the tension limit of the drive is 14 N instead of 24 N.
    """
    tension_before = warm_grasp.simulated_hand.truth()["tension"]
    warm_grasp.simulated_hand.inject("hot node=index_motor size=84 for=800ms")
    events = []
    for _ in range(190):
        events += warm_grasp.run_tick().events
    tension_after = warm_grasp.simulated_hand.truth()["tension"]
    assert min(tension_before) > 20.0
    assert (
        tension_after[0]
        < 14.0 + 2.0 * warm_grasp.controller.model.tendon_constants.coulomb_friction[0]
    )
    assert min(tension_after[1:]) > 20.0
    assert any(event.text.startswith("N09a") for event in events)
    assert warm_grasp.last_output.mode == HandMode.ACTIVE


def test_no_tension_grows_during_a_hold_by_safety(warm_grasp) -> None:
    """While the safety monitor holds the hand (HOLD), no tension exceeds the value that it had when the HOLD began.

    After the HOLD, the tensions are no longer limited to their values at the start of the HOLD.
    """
    state, controller = warm_grasp.state.copy(), warm_grasp.controller
    tension = np.array(warm_grasp.simulated_hand.truth()["tension"])

    def state_after_goal_evaluation(
        state_before: ControllerState,
        action: SafetyAction,
        tension: np.ndarray,
        mode: HandMode = HandMode.ACTIVE,
    ) -> ControllerState:
        state_after = state_before.copy()
        state_after.mode = mode
        state_after.view("tension")[...] = tension
        tick_stages.evaluate_goals(
            state_after.block,
            *controller.derived_constants.kernel_args,
            int(action),
        )
        return state_after

    held_state = state_after_goal_evaluation(state, SafetyAction.HOLD, tension)
    assert held_state.run_integers[s.SAFETY_HOLD_ACTIVE]
    assert held_state.view("limit_held") == pytest.approx(np.maximum(tension, 5.0) + HOLD_MARGIN_N)
    repeated_state = state_after_goal_evaluation(held_state, SafetyAction.HOLD, tension + 50.0)
    np.testing.assert_array_equal(repeated_state.view("limit_held"), held_state.view("limit_held"))
    assert (
        tension_limits_of(controller.model, repeated_state) <= held_state.view("limit_held")
    ).all()
    for action in (SafetyAction.PASS, SafetyAction.WARN, SafetyAction.RELAX):
        assert not state_after_goal_evaluation(repeated_state, action, tension).run_integers[
            s.SAFETY_HOLD_ACTIVE
        ]
    assert not state_after_goal_evaluation(
        repeated_state, SafetyAction.HOLD, tension, HandMode.RELAX
    ).run_integers[s.SAFETY_HOLD_ACTIVE]


def test_a_hold_keeps_the_hand_as_it_is(warm_grasp) -> None:
    """The safety monitor holds the hand (HOLD) while more than 20 of the last 100 replies of a drive are lost.

    The state of the control law contains a flag that is True during the HOLD.
    """
    warm_grasp.simulated_hand.inject("drop node=thumb_motor p=0.25 seed=3 for=700ms")
    tension_before, actions_and_holds = warm_grasp.simulated_hand.truth()["tension"], []
    for _ in range(300):
        out = warm_grasp.run_tick()
        actions_and_holds.append(
            (out.action, bool(warm_grasp.state.run_integers[s.SAFETY_HOLD_ACTIVE]))
        )
        if out.mode != HandMode.ACTIVE:
            break
    hold_flags = [
        is_hold_active
        for action, is_hold_active in actions_and_holds
        if action == SafetyAction.HOLD
    ]
    assert hold_flags
    assert all(hold_flags)
    assert not any(
        is_hold_active for action, is_hold_active in actions_and_holds if action < SafetyAction.HOLD
    )
    assert max(warm_grasp.simulated_hand.truth()["tension"]) < max(tension_before) + 5.0
