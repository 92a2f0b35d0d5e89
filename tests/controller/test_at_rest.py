"""Test a hand that rests at its target for a short or a long time, and is then touched."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from handctl.core import tick_stages
from handctl.core.hand_model import HandModel
from handctl.safety.faults.node import STUCK_SENSOR_GOAL_CHANGE_M
from tests.controller.synthetic_states import NO_TELEMETRY, active_state, constant_args_of


@pytest.mark.parametrize("rest_s", [0.2, 5.0])
def test_contact_does_not_move_the_filtered_goal(jamia: HandModel, rest_s: float) -> None:
    """Reproduce a defect: the controller reported a resting motor as stuck after an object had touched its digit.

    The digit rested after a move to 40 deg. The contact moved the filtered goal, but not the motor.
    """
    state, period = active_state(jamia), jamia.period
    far_angles = np.full(len(jamia.hand.joints), math.radians(40.0))

    def tick(goal: NDArray[np.float64], excursion_error_m: float) -> NDArray[np.float64]:
        state.view("q_goal")[...] = goal
        state.view("excursion")[...] = jamia.hand.moment_arms @ goal + excursion_error_m
        tick_stages.store_commands(
            state.block, state.layout.offsets, *constant_args_of(jamia), *NO_TELEMETRY
        )
        return state.view("followed").copy()

    for t in np.arange(0.0, 1.0, period):
        tick(far_angles * t, 0.05e-3)
    resting = tick(far_angles, 0.05e-3)
    for _ in range(round(rest_s / period)):
        resting = tick(far_angles, 0.05e-3)
    for _ in range(round(2.0 / period)):
        goal_in_contact = tick(far_angles, 0.4e-3)
    assert np.abs(goal_in_contact - resting).max() < 0.5 * STUCK_SENSOR_GOAL_CHANGE_M
    for _ in range(round(0.5 / period)):
        moved_goal = tick(far_angles * 1.2, 0.4e-3)
    assert np.abs(moved_goal - goal_in_contact).min() > STUCK_SENSOR_GOAL_CHANGE_M, (
        "a goal that does move is still seen"
    )
