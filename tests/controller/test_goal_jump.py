"""A goal that jumps: a motor that was at rest has not moved yet, which is not being stuck."""

import numpy as np
import pytest

from handctl.core.law.computed_torque import Command
from handctl.core.model import HandModel
from handctl.core.types import Mode, Vector
from handctl.programs.live import LiveProgram
from handctl.safety.watch import WatchState
from tests.controller.bench import Bench, bench


def at(bench: Bench, angle: float) -> Command:
    """A command of that angle for every joint [rad]."""
    idle = Command.idle(bench.controller.model)
    return idle._replace(q=np.full(len(idle.q), angle))


def goal_away(watch: WatchState) -> Vector:
    """How far the goals have gone [m] since the motors' readings stand."""
    return np.abs(watch.goal - watch.stuck.anchor[0, : len(watch.goal)])


def test_what_safety_takes_for_the_goal_goes_where_a_motor_can_follow(jamia: HandModel) -> None:
    active = bench(jamia, LiveProgram())
    guard, state = active.controller.guard, active.state
    arms = np.asarray(active.controller.model.hand.moment_arms.sum(axis=1))

    standing = state.watch.stuck._replace(ticks=np.ones_like(state.watch.stuck.ticks))
    armed = state.watch._replace(goal=np.full(4, np.nan), stuck=standing)

    def goals(angle: float, ticks: int, watch: object = armed) -> object:
        for _ in range(ticks):
            watch = guard.commanded(watch, Mode.ACTIVE, at(active, angle), state.drives, state.k)
        return watch

    begun = goals(0.2, 1)
    assert begun.goal == pytest.approx(arms * 0.2), "the first goal is taken as it is"
    seconds = 0.1
    after = goals(0.4, round(seconds / active.controller.model.period), begun)
    assert after.goal == pytest.approx(arms * (0.4 - 0.2 * np.exp(-1.0)), rel=0.02)
    assert goals(0.4, 1000, after).goal == pytest.approx(arms * 0.4, rel=1e-6)
    slow = goals(0.4 + 1e-5, 1, goals(0.4, 1000, after))
    assert slow.goal == pytest.approx(arms * (0.4 + 1e-5), rel=1e-9), "what goes slowly is followed at once"
    limp = guard.commanded(after, Mode.ACTIVE, Command.idle(active.controller.model), state.drives, state.k)
    assert np.isnan(limp.goal).all()
    assert goals(0.1, 1, limp).goal == pytest.approx(arms * 0.1), "after a hold it begins anew"


def test_a_goal_that_went_ahead_while_the_motor_moved_is_no_reason_to_move_on(jamia: HandModel) -> None:
    """Friction stops it short of the goal: what counts is how far that has gone since."""
    active = bench(jamia, LiveProgram())
    guard, state = active.controller.guard, active.state
    arms = np.asarray(active.controller.model.hand.moment_arms.sum(axis=1))
    moving = state.watch._replace(goal=arms * 0.1)
    assert not moving.stuck.ticks.any()
    then = guard.commanded(moving, Mode.ACTIVE, at(active, 0.4), state.drives, state.k, arms * 0.3)
    np.testing.assert_allclose(then.goal, arms * 0.4)
    standing = then._replace(stuck=then.stuck._replace(ticks=np.ones_like(then.stuck.ticks)))
    later = guard.commanded(standing, Mode.ACTIVE, at(active, 0.4), state.drives, state.k, arms * 0.3)
    np.testing.assert_array_equal(later.goal, then.goal)


def test_a_motor_that_rests_where_it_was_to_go_is_not_stuck(jamia: HandModel) -> None:
    """A quick motion is over before what follows it slowly: that must not go on while the motor rightly stands."""
    active = bench(jamia, LiveProgram())
    guard, state = active.controller.guard, active.state
    arms = np.asarray(active.controller.model.hand.moment_arms.sum(axis=1))
    command, there = at(active, 0.4), arms * 0.4
    since = state.watch.stuck._replace(anchor=np.full_like(state.watch.stuck.anchor, 1e-3))
    lagging = state.watch._replace(goal=arms * 0.2, stuck=since)
    resting = guard.commanded(lagging, Mode.ACTIVE, command, state.drives, state.k, there)
    np.testing.assert_array_equal(resting.goal, there, "while it still moves, as it arrives")
    np.testing.assert_allclose(goal_away(resting), goal_away(lagging), atol=1e-12, err_msg="a leap moved no motor")
    later = guard.commanded(resting, Mode.ACTIVE, command, state.drives, state.k, there)
    np.testing.assert_array_equal(later.goal, resting.goal)
    stuck = guard.commanded(lagging, Mode.ACTIVE, command, state.drives, state.k, arms * 0.1)
    assert (stuck.goal > lagging.goal).all(), "one that is elsewhere is judged as before"
