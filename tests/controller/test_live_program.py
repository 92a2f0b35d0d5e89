"""Test targets and jog requests during a run: which requests the controller refuses, and when a motion ends."""

import math
from dataclasses import replace

import numpy as np
import pytest

from handctl.core.control_law.digit_goal import GoalKind
from handctl.core.hand_model import HandModel
from handctl.programs.live_session import JogProgram, LiveProgram, apply_goal
from handctl.programs.program import TIGHTEN_TIMEOUT_S, ProgramProgress
from handctl.programs.requests import HoldTensionRequest, MoveDigitsRequest, parse_request
from tests.controller.synthetic_states import (
    SyntheticEstimate,
    empty_readings,
    estimate_under_tension,
    slack_hand_estimate,
)


def goal_of_request(request_text: str) -> MoveDigitsRequest | HoldTensionRequest:
    request = parse_request(request_text)
    assert isinstance(request, MoveDigitsRequest | HoldTensionRequest)
    return request


def begin_live_program(
    model: HandModel, estimate: SyntheticEstimate
) -> tuple[LiveProgram, ProgramProgress]:
    """Run a program until it waits for requests of a client, and return the program and its progress."""
    program = LiveProgram()
    progress, t = program.initial_progress(model), 0.0
    while progress.phase != "live":
        t += model.period
        assert t < TIGHTEN_TIMEOUT_S
        progress, _ = program.advance(model, progress, estimate, empty_readings(model), t)
    return program, progress


def test_move_and_hold_requests_are_followed(model: HandModel) -> None:
    estimate = estimate_under_tension(model, 5.0, 0.3)
    _, progress = begin_live_program(model, estimate)
    names = model.hand.digit_names
    request = goal_of_request(
        '{"do": "move", "angle_deg": {"index": 40, "thumb": 10}, "duration_s": 2}'
    )
    moved, events = apply_goal(model, progress, request, estimate, 7.0)
    assert [event.level for event in events] == ["info"]
    for d, name in enumerate(names):
        if name not in ("index", "thumb"):
            assert moved.goals[d] is progress.goals[d]
            continue
        goal = moved.goals[d]
        assert goal.kind == GoalKind.MOTION
        assert goal.trajectory is not None
        np.testing.assert_allclose(goal.trajectory.start, 0.3, atol=1e-9)
        np.testing.assert_allclose(goal.trajectory.end, math.radians(40 if name == "index" else 10))
        assert (goal.since, goal.trajectory.duration) == (7.0, 2.0)
    held_progress, _ = apply_goal(
        model,
        moved,
        goal_of_request('{"do": "hold", "tension_N": {"index": 25}, "rate_N_per_s": 9}'),
        estimate,
        8.0,
    )
    goal = held_progress.goals[0]
    assert (goal.kind, goal.rate) == (GoalKind.TENSION, 9.0)
    np.testing.assert_array_equal(goal.tension, np.full(model.digit_tendons[0].stop, 25.0))
    assert held_progress.goals[-1] is moved.goals[-1]


def test_a_move_frees_a_digit_that_was_in_contact(model: HandModel) -> None:
    estimate = estimate_under_tension(model, 5.0)
    _, progress = begin_live_program(model, estimate)
    progress = replace(progress, contact=(True,) * len(model.digits))
    moved, _ = apply_goal(
        model, progress, goal_of_request('{"do": "move", "angle_deg": {"index": 0}}'), estimate, 1.0
    )
    assert moved.contact == (False, *[True] * (len(model.digits) - 1))


@pytest.mark.parametrize(
    ("request_text", "expected_message"),
    [
        ('{"do": "move", "angle_deg": {"index": 10, "pinky": 10}}', "pinky"),
        ('{"do": "hold", "tension_N": {"pinky": 10}}', "pinky"),
        ('{"do": "move", "angle_deg": {"middle": 10, "index": 100.1}}', "from 0 to 100 deg"),
        ('{"do": "move", "angle_deg": {"middle": 10, "index": -0.1}}', "from 0 to 100 deg"),
        ('{"do": "move", "angle_deg": {"index": 60}, "duration_s": 0.16}', "703 deg/s"),
        ('{"do": "hold", "tension_N": {"index": 10, "thumb": 110.1}}', "110"),
    ],
)
def test_a_request_with_one_mistake_changes_nothing(
    model: HandModel, request_text: str, expected_message: str
) -> None:
    estimate = estimate_under_tension(model, 5.0)
    _, progress = begin_live_program(model, estimate)
    progress_after, events = apply_goal(
        model, progress, goal_of_request(request_text), estimate, 1.0
    )
    assert progress_after is progress
    assert [event.level for event in events] == ["warn"]
    assert expected_message in events[0].text


def test_nothing_is_accepted_before_the_tendons_are_taut(model: HandModel) -> None:
    estimate, program = slack_hand_estimate(model), LiveProgram()
    progress = program.initial_progress(model)
    for t in (0.0, 0.1):
        progress_after, events = apply_goal(
            model,
            progress,
            goal_of_request('{"do": "move", "angle_deg": {"index": 0}}'),
            estimate,
            t,
        )
        assert progress_after is progress
        assert "not ready" in events[0].text
        progress, _ = program.advance(model, progress, estimate, empty_readings(model), t)
    assert progress.phase == "tighten"


def test_a_live_session_with_a_loose_tendon_gives_up(model: HandModel) -> None:
    slack_estimate, program, t = estimate_under_tension(model, 5.0), LiveProgram(), 0.0
    slack_estimate.is_slack[2] = True
    progress = program.initial_progress(model)
    while not progress.finished:
        t += model.period
        assert t < 2 * TIGHTEN_TIMEOUT_S
        progress, events = program.advance(
            model, progress, slack_estimate, empty_readings(model), t
        )
    assert model.hand.tendon_names[2] in progress.failure
    assert [event.level for event in events] == ["error"]


def test_a_live_session_never_ends_by_itself(model: HandModel) -> None:
    estimate = estimate_under_tension(model, 5.0)
    program, progress = begin_live_program(model, estimate)
    for t in (10.0, 1e3, 1e6):
        progress_after, events = program.advance(
            model, progress, estimate, empty_readings(model), t
        )
        assert (progress_after, events) == (progress, ())


def test_a_jog_keeps_its_goal_for_its_time(model: HandModel) -> None:
    estimate, jog, t = (
        estimate_under_tension(model, 5.0),
        JogProgram(goal_of_request('{"do": "hold", "tension_N": {"thumb": 8}}'), 0.5),
        0.0,
    )  # type: ignore[arg-type]
    progress, began = jog.initial_progress(model), -1.0
    while not progress.finished:
        t += model.period
        assert t < 10.0
        progress, _ = jog.advance(model, progress, estimate, empty_readings(model), t)
        if progress.phase == "jog" and began < 0:
            began = t
            np.testing.assert_array_equal(
                progress.goals[-1].tension, [8.0] * len(progress.goals[-1].tension)
            )
    assert t - began == pytest.approx(0.5, abs=1.5 * model.period)
    assert not progress.failure


def test_impossible_jog_fails(model: HandModel) -> None:
    estimate, jog, t = (
        estimate_under_tension(model, 5.0),
        JogProgram(goal_of_request('{"do": "move", "angle_deg": {"index": 101}}'), 0.5),
        0.0,
    )  # type: ignore[arg-type]
    progress = jog.initial_progress(model)
    while not progress.finished:
        t += model.period
        assert t < 2.0
        progress, _ = jog.advance(model, progress, estimate, empty_readings(model), t)
    assert "from 0 to 100 deg" in progress.failure
