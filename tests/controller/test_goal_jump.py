"""A goal that jumps: a motor that was at rest has not moved yet, which is not being stuck."""

import numpy as np
import pytest

from handctl.controller.state import State
from handctl.core import stages
from handctl.core.model import HandModel
from handctl.core.types import Vector
from tests.controller.synthetic import blank, constants


def arms_of(model: HandModel) -> np.ndarray:
    return np.asarray(model.hand.moment_arms.sum(axis=1))


def lasting(model: HandModel, goal: float | Vector, ticks: int) -> State:
    """A hand whose motors read the same for so many ticks, led to goals [m] by then."""
    state = blank(model)
    state.view("followed")[...] = goal
    state.view("motor_stuck")[...] = ticks
    return state


def commanded(model: HandModel, before: State, angle: float, there: float | Vector = np.nan) -> State:
    """After a command of that angle for every joint [rad] to digits that are there [m]."""
    state = before.copy()
    state.view("q_goal")[...] = angle
    state.view("excursion")[...] = there
    stages.store_commands(state.block, state.layout.places, *constants(model))
    return state


def goal(state: State) -> np.ndarray:
    return state.view("followed")


def goal_away(state: State) -> np.ndarray:
    """How far the goals have gone [m] since the motors' readings are constant."""
    return np.abs(goal(state) - state.view("motor_anchor")[0])


def test_filtered_goal_moves_as_fast_as_a_motor(jamia: HandModel) -> None:
    arms, armed = arms_of(jamia), lasting(jamia, np.nan, 1)

    def goals(angle: float, ticks: int, state: State = armed) -> State:
        for _ in range(ticks):
            state = commanded(jamia, state, angle)
        return state

    begun = goals(0.2, 1)
    assert goal(begun) == pytest.approx(arms * 0.2), "the first goal is taken as it is"
    seconds = 0.1
    after = goals(0.4, round(seconds / jamia.period), begun)
    assert goal(after) == pytest.approx(arms * (0.4 - 0.2 * np.exp(-1.0)), rel=0.02)
    assert goal(goals(0.4, 1000, after)) == pytest.approx(arms * 0.4, rel=1e-6)
    slow = goals(0.4 + 1e-5, 1, goals(0.4, 1000, after))
    assert goal(slow) == pytest.approx(arms * (0.4 + 1e-5), rel=1e-9), "what goes slowly is followed at once"
    limp = commanded(jamia, after, np.nan)
    assert np.isnan(goal(limp)).all()
    assert goal(goals(0.1, 1, limp)) == pytest.approx(arms * 0.1), "after a hold it begins anew"


def test_a_goal_that_went_ahead_while_the_motor_moved_is_no_reason_to_move_on(jamia: HandModel) -> None:
    """Friction stops it short of the goal: what counts is how far that has gone since."""
    arms = arms_of(jamia)
    then = commanded(jamia, lasting(jamia, arms * 0.1, 0), 0.4, arms * 0.3)
    np.testing.assert_allclose(goal(then), arms * 0.4)
    standing = then.copy()
    standing.view("motor_stuck")[...] = 1
    later = commanded(jamia, standing, 0.4, arms * 0.3)
    np.testing.assert_array_equal(goal(later), goal(then))


def test_motor_at_rest_at_its_goal_is_not_stuck(jamia: HandModel) -> None:
    """A quick motion is over before what follows it slowly: that must not go on while the motor rightly stands."""
    arms = arms_of(jamia)
    there, lagging = arms * 0.4, lasting(jamia, arms * 0.2, 0)
    lagging.view("motor_anchor")[...] = 1e-3
    resting = commanded(jamia, lagging, 0.4, there)
    np.testing.assert_array_equal(goal(resting), there, "while it still moves, as it arrives")
    np.testing.assert_allclose(goal_away(resting), goal_away(lagging), atol=1e-12, err_msg="a leap moved no motor")
    later = commanded(jamia, resting, 0.4, there)
    np.testing.assert_array_equal(goal(later), goal(resting))
    stuck = commanded(jamia, lagging, 0.4, arms * 0.1)
    assert (goal(stuck) > goal(lagging)).all(), "one that is elsewhere is judged as before"
