"""Test that neither a request nor a fault can raise a tension while a hand relaxes."""

import numpy as np
import pytest

from handctl.controller.relaxation import (
    MAX_SETPOINT_EXCESS_N,
    OVER_TENSION_RATE_N_PER_S,
    RELAX_RATE_N_PER_S,
)
from handctl.core.control_law.computed_torque import MIN_RELAXED_TENSION_N
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import load_hand
from handctl.programs.commission import CommissionProgram
from handctl.programs.live_session import LiveProgram
from tests.controller.controller_bench import ControllerBench, make_controller_bench

STOP_REQUEST, CUT_REQUEST = '{"do": "stop"}', '{"do": "cut"}'
FAST_HOLD_REQUEST = '{"do": "hold", "tension_N": {"index": 100}, "rate_N_per_s": 5000}'
MOVE_REQUEST = '{"do": "move", "angle_deg": {"index": 60}}'


@pytest.fixture(scope="module")
def jamia_at_low_rate() -> HandModel:
    """Return a model of ``jamia`` at a low control rate, which makes the tests fast."""
    return HandModel.from_hand(load_hand("jamia"), Gains(), 200.0)


def bench_holding_hand(model: HandModel) -> ControllerBench:
    run = make_controller_bench(model, LiveProgram())
    run.run_until_mode(HandMode.ACTIVE)
    run.run(1.0)
    return run


def command_of_other_host(bench: ControllerBench) -> Frame:
    return Frame(bench.toy_hand.motors[0].node_id, bytes(8), t_ns=bench.k * bench.period_ns)


@pytest.mark.parametrize("request_text", [FAST_HOLD_REQUEST, MOVE_REQUEST])
@pytest.mark.parametrize("with_fault", [False, True])
def test_no_request_raises_the_tension_during_relax(
    jamia_at_low_rate: HandModel, request_text: str, with_fault: bool
) -> None:
    run = bench_holding_hand(jamia_at_low_rate)
    run.tick('{"do": "hold", "tension_N": {"index": 40}, "rate_N_per_s": 1000}')
    run.run(0.5)
    run.tick(
        *() if with_fault else (STOP_REQUEST,),
        extra_frames=(command_of_other_host(run),) if with_fault else (),
    )
    first_tick_index, tension_before = len(run.tick_history), run.toy_hand.tension.max()
    while run.state.mode == HandMode.RELAX:
        run.tick(request_text)
        assert run.toy_hand.tension.max() < tension_before + 0.5
    goals = np.array(
        [
            out.telemetry.tension_goal
            for _, _, out in run.tick_history[first_tick_index:]
            if out.mode == HandMode.RELAX
        ]
    )
    assert (np.diff(goals, axis=0) <= 1e-9).all()
    assert len(goals) * jamia_at_low_rate.period < 0.2
    texts = [event.text for event in run.events if event.text.startswith("refused")]
    assert texts == ["refused: the hand is letting go"] * len(texts)
    run.run_until_mode(HandMode.DONE)
    assert run.state.failure == ("fault H13 0x001" if with_fault else ""), (
        "a goal that comes too late is no fault"
    )


def test_a_tension_that_is_still_growing_is_not_waited_for(jamia_at_low_rate: HandModel) -> None:
    run = bench_holding_hand(jamia_at_low_rate)
    run.tick(FAST_HOLD_REQUEST)
    known_tension = run.tick().telemetry.tension
    assert run.state.view("setpoint")[0] > known_tension[0] + 30.0, "the set-point is far ahead"
    out = run.tick(STOP_REQUEST)
    present = np.maximum(out.telemetry.tension, MIN_RELAXED_TENSION_N) + MAX_SETPOINT_EXCESS_N
    assert (run.state.view("setpoint") <= present).all()
    while run.tick().mode == HandMode.RELAX:
        assert run.state.view("setpoint").max() <= present.max()


def fastest_setpoint_fall(bench: ControllerBench, tendon_index: int = 0) -> float:
    """Return the highest rate [N/s] at which the setpoint of a tendon falls while the hand relaxes."""
    goals = [
        out.telemetry.tension_goal[tendon_index]
        for _, _, out in bench.tick_history
        if out.mode == HandMode.RELAX
    ]
    return float(-np.diff(goals).min() / bench.controller.model.period)


@pytest.mark.parametrize("was_relaxing_before", [False, True])
def test_over_tension_is_relaxed_four_times_as_fast(
    jamia_at_low_rate: HandModel, was_relaxing_before: bool
) -> None:
    """As soon as a load cell reads a tension above the limit, the hand relaxes four times as fast as usual.

    The hand also relaxes faster if it was already relaxing before the high load-cell reading.
    """
    run = bench_holding_hand(jamia_at_low_rate)
    run.tick('{"do": "hold", "tension_N": {"index": 60}, "rate_N_per_s": 1000}')
    run.run(0.5)
    if was_relaxing_before:
        run.tick(STOP_REQUEST)
        run.run(0.02)
        assert fastest_setpoint_fall(run) == pytest.approx(RELAX_RATE_N_PER_S)
    run.toy_hand.cell_bias[0] = 150.0 - run.toy_hand.tension[0]
    run.run(2 * jamia_at_low_rate.period)
    run.toy_hand.cell_bias[0] = 0.0
    run.run_until_mode(HandMode.DISARM)
    assert next(event.text for event in run.events if event.name == "fault").startswith("T03 ")
    assert fastest_setpoint_fall(run) == pytest.approx(OVER_TENSION_RATE_N_PER_S)


@pytest.mark.parametrize("ending_request", [STOP_REQUEST, CUT_REQUEST])
def test_a_fault_during_relax_makes_the_run_fail(
    jamia_at_low_rate: HandModel, ending_request: str
) -> None:
    run = bench_holding_hand(jamia_at_low_rate)
    run.tick('{"do": "hold", "tension_N": {"index": 40}, "rate_N_per_s": 1000}')
    run.run(0.5)
    if ending_request == STOP_REQUEST:
        run.tick(ending_request)
        run.tick(extra_frames=(command_of_other_host(run),))
        assert run.state.mode == HandMode.RELAX
    else:
        run.tick(ending_request, extra_frames=(command_of_other_host(run),))
    run.run_until_mode(HandMode.DONE)
    assert run.state.failure == "fault H13 0x001"
    assert any(
        event.level == "error" and "fault H13" in event.text
        for event in run.events
        if event.name == "mode"
    )


def test_after_a_fault_during_arming_no_further_drive_is_enabled(
    jamia_at_low_rate: HandModel,
) -> None:
    run = make_controller_bench(jamia_at_low_rate, LiveProgram())
    run.toy_hand.motors[1].ignored_commands.add(0xFC)
    run.run_until_mode(HandMode.ARMING)
    run.tick(extra_frames=(command_of_other_host(run),))
    assert run.state.mode == HandMode.DISARM
    since = len(run.tick_history)
    run.run_until_mode(HandMode.DONE)
    enable_payload = b"\xff" * 7 + b"\xfc"
    assert not [
        frame
        for _, _, out in run.tick_history[since - 1 :]
        for frame in out.frames
        if frame.data == enable_payload
    ]
    assert run.state.failure == "fault H13 0x001"


@pytest.mark.parametrize("request_text", [FAST_HOLD_REQUEST, MOVE_REQUEST])
def test_commissioning_refuses_goals_of_clients(
    jamia_at_low_rate: HandModel, request_text: str
) -> None:
    """The controller refuses the goals of a client while the hand is commissioned.

    A goal could tension a tendon while its load cell is tared. With a wrong tare, all readings of
    the load cell would be wrong in later runs.
    """
    run = make_controller_bench(jamia_at_low_rate, CommissionProgram())
    run.run_until_mode(HandMode.ACTIVE)
    run.run(0.05)
    goals = run.state.progress.goals
    out = run.tick(request_text)
    assert run.state.progress.goals is goals
    assert "refused: this run has goals of its own" in [event.text for event in out.events]
    assert not out.telemetry.motor_torque_goal.any()


def test_a_hand_refuses_goals_before_active_mode(jamia_at_low_rate: HandModel) -> None:
    run = make_controller_bench(jamia_at_low_rate, LiveProgram())
    for _ in range(60):
        out = run.tick()
    run.tick(FAST_HOLD_REQUEST)
    assert "refused: the hand is not ready yet" in [
        event.text for event in run.tick_history[-1][2].events
    ]
    assert out.mode < HandMode.ACTIVE
