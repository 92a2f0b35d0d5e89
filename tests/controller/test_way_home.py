"""While a hand relaxes, no request and no fault can increase a tension."""

import numpy as np
import pytest

from handctl.controller.relaxing import (
    OVER_TENSION_RATE_N_PER_S,
    RELAX_RATE_N_PER_S,
    SETPOINT_MARGIN_N,
)
from handctl.core.control_law.computed_torque import RELAX_FLOOR_N
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import load_hand
from handctl.programs.commission import CommissionProgram
from handctl.programs.live_session import LiveProgram
from tests.controller.bench import Bench, bench

STOP, CUT = '{"do": "stop"}', '{"do": "cut"}'
QUICK = '{"do": "hold", "tension_N": {"index": 100}, "rate_N_per_s": 5000}'
MOVE = '{"do": "move", "angle_deg": {"index": 60}}'


@pytest.fixture(scope="module")
def quick() -> HandModel:
    """Return a model of ``jamia`` at a low control rate, which makes the tests fast."""
    return HandModel.from_hand(load_hand("jamia"), Gains(), 200.0)


def acting(model: HandModel) -> Bench:
    run = bench(model, LiveProgram())
    run.until(HandMode.ACTIVE)
    run.run(1.0)
    return run


def foreign(run: Bench) -> Frame:
    return Frame(run.peer.motors[0].node_id, bytes(8), t_ns=run.k * run.period_ns)


@pytest.mark.parametrize("request_", [QUICK, MOVE])
@pytest.mark.parametrize("fault", [False, True])
def test_no_request_raises_the_tension_during_relax(
    quick: HandModel, request_: str, fault: bool
) -> None:
    run = acting(quick)
    run.tick('{"do": "hold", "tension_N": {"index": 40}, "rate_N_per_s": 1000}')
    run.run(0.5)
    run.tick(*() if fault else (STOP,), extra=(foreign(run),) if fault else ())
    since, before = len(run.history), run.peer.tension.max()
    while run.state.mode == HandMode.RELAX:
        run.tick(request_)
        assert run.peer.tension.max() < before + 0.5
    goals = np.array(
        [
            out.telemetry.tension_goal
            for _, _, out in run.history[since:]
            if out.mode == HandMode.RELAX
        ]
    )
    assert (np.diff(goals, axis=0) <= 1e-9).all()
    assert len(goals) * quick.period < 0.2
    texts = [event.text for event in run.events if event.text.startswith("refused")]
    assert texts == ["refused: the hand is letting go"] * len(texts)
    run.until(HandMode.DONE)
    assert run.state.failure == ("fault H13 0x001" if fault else ""), (
        "a goal that comes too late is no fault"
    )


def test_a_tension_that_is_still_growing_is_not_waited_for(quick: HandModel) -> None:
    run = acting(quick)
    run.tick(QUICK)
    known = run.tick().telemetry.tension
    assert run.state.view("setpoint")[0] > known[0] + 30.0, "the set-point is far ahead"
    out = run.tick(STOP)
    present = np.maximum(out.telemetry.tension, RELAX_FLOOR_N) + SETPOINT_MARGIN_N
    assert (run.state.view("setpoint") <= present).all()
    while run.tick().mode == HandMode.RELAX:
        assert run.state.view("setpoint").max() <= present.max()


def fastest_setpoint_fall(run: Bench, index: int = 0) -> float:
    """Return how fast the set-point of a tendon falls at most while the hand relaxes [N/s]."""
    goals = [
        out.telemetry.tension_goal[index] for _, _, out in run.history if out.mode == HandMode.RELAX
    ]
    return float(-np.diff(goals).min() / run.controller.model.period)


@pytest.mark.parametrize("late", [False, True])
def test_over_tension_is_relaxed_four_times_as_fast(quick: HandModel, late: bool) -> None:
    """The faster ramp starts in the tick in which a load cell reads too much, even if the hand already relaxes."""
    run = acting(quick)
    run.tick('{"do": "hold", "tension_N": {"index": 60}, "rate_N_per_s": 1000}')
    run.run(0.5)
    if late:
        run.tick(STOP)
        run.run(0.02)
        assert fastest_setpoint_fall(run) == pytest.approx(RELAX_RATE_N_PER_S)
    run.peer.bias[0] = 150.0 - run.peer.tension[0]
    run.run(2 * quick.period)
    run.peer.bias[0] = 0.0
    run.until(HandMode.DISARM)
    assert next(event.text for event in run.events if event.name == "fault").startswith("T03 ")
    assert fastest_setpoint_fall(run) == pytest.approx(OVER_TENSION_RATE_N_PER_S)


@pytest.mark.parametrize("asked", [STOP, CUT])
def test_a_fault_during_relax_makes_the_run_fail(quick: HandModel, asked: str) -> None:
    run = acting(quick)
    run.tick('{"do": "hold", "tension_N": {"index": 40}, "rate_N_per_s": 1000}')
    run.run(0.5)
    if asked == STOP:
        run.tick(asked)
        run.tick(extra=(foreign(run),))
        assert run.state.mode == HandMode.RELAX
    else:
        run.tick(asked, extra=(foreign(run),))
    run.until(HandMode.DONE)
    assert run.state.failure == "fault H13 0x001"
    assert any(
        event.level == "error" and "fault H13" in event.text
        for event in run.events
        if event.name == "mode"
    )


def test_after_a_fault_during_arming_no_further_drive_is_enabled(quick: HandModel) -> None:
    run = bench(quick, LiveProgram())
    run.peer.motors[1].deaf.add(0xFC)
    run.until(HandMode.ARMING)
    run.tick(extra=(foreign(run),))
    assert run.state.mode == HandMode.DISARM
    since = len(run.history)
    run.until(HandMode.DONE)
    enable = b"\xff" * 7 + b"\xfc"
    assert not [
        frame
        for _, _, out in run.history[since - 1 :]
        for frame in out.frames
        if frame.data == enable
    ]
    assert run.state.failure == "fault H13 0x001"


@pytest.mark.parametrize("request_", [QUICK, MOVE])
def test_a_run_with_its_own_goals_refuses_goals_of_clients(quick: HandModel, request_: str) -> None:
    """Goals of a client are refused while a hand is commissioned.

    A tare under tension would shift readings of later runs.
    """
    run = bench(quick, CommissionProgram())
    run.until(HandMode.ACTIVE)
    run.run(0.05)
    goals = run.state.progress.goals
    out = run.tick(request_)
    assert run.state.progress.goals is goals
    assert "refused: this run has goals of its own" in [event.text for event in out.events]
    assert not out.telemetry.motor_torque_goal.any()


def test_a_hand_refuses_goals_before_active_mode(quick: HandModel) -> None:
    run = bench(quick, LiveProgram())
    for _ in range(60):
        out = run.tick()
    run.tick(QUICK)
    assert "refused: the hand is not ready yet" in [
        event.text for event in run.history[-1][2].events
    ]
    assert out.mode < HandMode.ACTIVE
