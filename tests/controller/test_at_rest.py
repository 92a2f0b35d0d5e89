"""A hand that rests where it was to go, for a second or an hour, and is then touched."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from handctl.core.law.computed_torque import Command
from handctl.core.model import HandModel
from handctl.core.types import Mode
from handctl.programs.live import LiveProgram
from handctl.safety.watch import STUCK_GOAL_MM
from tests.controller.bench import controller


@pytest.mark.parametrize("rest_s", [0.2, 5.0])
def test_a_touch_does_not_bring_the_rest_of_the_way_as_if_the_goal_had_moved(jamia: HandModel, rest_s: float) -> None:
    """A way to 40 deg, well tracked, was left over: a motor at rest counted as stuck when the digit was touched."""
    desk = controller(jamia, LiveProgram())
    state, period = desk.initial(), jamia.period
    watch: Any = state.watch
    far = np.full(len(jamia.hand.joints), math.radians(40.0))

    def tick(goal: NDArray[np.float64], apart_m: float) -> NDArray[np.float64]:
        nonlocal watch
        command = Command.idle(jamia)._replace(q=goal, dq=np.zeros_like(goal))
        excursion = jamia.excursion_of(goal) + apart_m
        watch = desk.guard.commanded(watch, Mode.ACTIVE, command, state.drives, 0, excursion)
        return np.asarray(watch.goal)

    for t in np.arange(0.0, 1.0, period):
        tick(far * t, 0.05e-3)
    resting = tick(far, 0.05e-3)
    for _ in range(round(rest_s / period)):
        resting = tick(far, 0.05e-3)
    for _ in range(round(2.0 / period)):
        touched = tick(far, 0.4e-3)
    assert np.abs(touched - resting).max() < 0.5e-3 * STUCK_GOAL_MM
    for _ in range(round(0.5 / period)):
        away = tick(far * 1.2, 0.4e-3)
    assert np.abs(away - touched).min() > 1e-3 * STUCK_GOAL_MM, "a goal that does move is still seen"
