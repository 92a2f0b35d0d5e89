"""A warm drive is asked for less, linearly; while safety holds no tension grows and the goal stands still."""

import math

import numpy as np
import pytest

from handctl.campaign.scenarios import GRASP
from handctl.campaign.stage import bring, hand_in, started
from handctl.controller.monitor.derating import HELD_MARGIN_N, derated, restraints
from handctl.core.law.computed_torque import LawState, step
from handctl.core.model import HandModel
from handctl.core.types import Mode
from handctl.safety.action import Action
from handctl.safety.signals import Limits
from tests.controller.synthetic import under
from tests.controller.test_computed_torque import holding, moving

LIMITS = Limits(("a",) * 4, (140.0,) * 4, 240.0, ("m",) * 4, temperature_soft=70.0, temperature_hard=85.0)


@pytest.mark.parametrize(("temperature", "share"), [
    (70.1, 0.9933), (73.0, 0.8), (77.5, 0.5), (84.0, 0.0667), (85.0, 0.0), (200.0, 0.0),
])  # fmt: skip
def test_the_limit_falls_linearly_from_the_soft_to_the_hard_temperature(
    jamia: HandModel, temperature: float, share: float
) -> None:
    most = derated(jamia, LIMITS, (20.0, temperature, math.nan, 70.0))
    assert most is not None
    assert most[1] == pytest.approx(jamia.floor[1] + share * (jamia.ceiling[1] - jamia.floor[1]), rel=1e-3)
    assert most[[0, 2, 3]].tolist() == jamia.ceiling[[0, 2, 3]].tolist(), "cool, unknown, just at the limit"


@pytest.mark.parametrize("temperatures", [(20.0, 70.0, math.nan, 0.0), (math.nan,) * 4])
def test_a_cool_hand_is_not_restrained(jamia: HandModel, temperatures: tuple[float, ...]) -> None:
    assert derated(jamia, LIMITS, temperatures) is None


def test_neither_loop_asks_for_more_than_is_allowed(jamia: HandModel) -> None:
    most, estimate = np.array([9.0, 140.0, 140.0, 12.0]), under(jamia, 20.0)
    state = LawState.idle(estimate.tension)
    for _ in range(200):
        state, command = step(jamia, state, estimate, holding(jamia, 60.0), 0.0, most)
    assert command.tension.tolist() == [9.0, 60.0, 60.0, 12.0]
    force = command.torque / jamia.space.spool
    assert (force <= most + jamia.space.coulomb + 1e-12).all()
    assert force[1] > 30.0
    _, command = step(jamia, LawState.idle(estimate.tension), estimate, moving(jamia, 1.0, 1.0, 1.0), 2.0, most)
    assert command.tension[0] <= 9.0
    assert (command.torque / jamia.space.spool <= most + jamia.space.coulomb + 1e-12).all()


def test_where_time_stands_still_the_goal_has_no_speed(jamia: HandModel) -> None:
    estimate, goals = under(jamia, 20.0), moving(jamia, 0.0, 1.5, 1.0)
    law, held = step(jamia, LawState.idle(estimate.tension), estimate, goals, 0.5, None, np.full(4, 300.0))
    _, going = step(jamia, LawState.idle(estimate.tension), estimate, goals, 0.5)
    assert held.q.tolist() == going.q.tolist()
    assert (going.dq > 1.0).all()
    assert not held.dq.any()
    assert law.held is not None


@pytest.fixture(scope="module")
def course():
    """A hand of MIT drives that holds a cylinder."""
    with started(hand_in("jamia", "mit"), 250.0, 0) as begun:
        bring(begun, GRASP)
        yield begun


def test_a_warm_drive_pulls_less_and_the_others_as_before(course) -> None:
    """84 degC of 70 to 85: a fifteenth of the way from floor to ceiling, 14 N where 24 N were held."""
    course.until(lambda out: False, 0.6)
    before = course.peer.truth()["tension"]
    course.peer.inject("hot node=index_motor size=84 for=800ms")
    events = []
    for _ in range(190):
        events += course.tick().events
    after = course.peer.truth()["tension"]
    assert min(before) > 20.0
    assert after[0] < 14.0 + 2.0 * course.controller.model.space.coulomb[0]
    assert min(after[1:]) > 20.0
    assert any(event.text.startswith("N09a") for event in events)
    assert course.out.mode == Mode.ACTIVE


def test_while_safety_holds_no_tension_grows(course) -> None:
    """The limit is what there was when it began, whatever comes after; it ends with the hold."""
    state, controller = course.state, course.controller
    tension = np.array(course.peer.truth()["tension"])
    _warm, kept = restraints(controller.model, LIMITS, state, Action.HOLD, tension)
    assert kept == pytest.approx(np.maximum(tension, 5.0) + HELD_MARGIN_N)
    again = state._replace(law=state.law._replace(held=kept))
    assert restraints(controller.model, LIMITS, again, Action.HOLD, tension + 50.0)[1] is kept
    for action in (Action.PASS, Action.WARN, Action.RELAX):
        assert restraints(controller.model, LIMITS, again, action, tension)[1] is None
    assert restraints(controller.model, LIMITS, again._replace(mode=Mode.RELAX), Action.HOLD, tension)[1] is None


def test_a_hold_keeps_the_hand_as_it_is(course) -> None:
    """More than 20 of 100 answers lost hold the hand until they come again; its law says so meanwhile."""
    course.peer.inject("drop node=thumb_motor p=0.25 seed=3 for=700ms")
    before, seen = course.peer.truth()["tension"], []
    for _ in range(300):
        out = course.tick()
        seen.append((out.action, course.state.law.held is not None))
        if out.mode != Mode.ACTIVE:
            break
    held = [kept for action, kept in seen if action == Action.HOLD]
    assert held
    assert all(held)
    assert not any(kept for action, kept in seen if action < Action.HOLD)
    assert max(course.peer.truth()["tension"]) < max(before) + 5.0
