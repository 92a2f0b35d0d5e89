"""Test changes of gains during a run.

Changed gains stay within their bounds and cause no step of the torque. The hash of the state
includes the gains.
"""

import json
from collections.abc import Mapping

import numpy as np
import pytest

from handctl.controller.controller_state import ControllerState
from handctl.controller.gain_change import MAX_CACHED_DESIGNS, DesignCache
from handctl.controller.pending_gains import PendingGains
from handctl.controller.tick import Controller
from handctl.core import state_block as s
from handctl.core.gains.gain_bounds import (
    checked_gain_bounds,
    gain_bounds,
    gains_with_values,
    values_by_key,
)
from handctl.core.gains.gains import Gains, TensionGains
from handctl.core.gains.motion_design import control_loop_count, design_motion
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.drives.frame_records import WordRows
from handctl.errors import ConfigError
from handctl.hand.hand_loading import hand_path
from handctl.programs.commission import CommissionProgram
from handctl.programs.live_session import LiveProgram
from handctl.programs.requests import parse_request
from handctl.runtime.clocks.lockstep import load_simulator
from handctl.safety.safety_action import SafetyAction
from tests.controller.control_law_runs import tension_limits_of
from tests.controller.controller_bench import (
    ControllerBench,
    make_controller_bench,
    uncommissioned_controller,
)

HOLD_REQUEST = '{"do": "hold", "tension_N": {"index": 14, "middle": 14, "ring": 14, "thumb": 14}, "rate_N_per_s": 500}'
MOVE_REQUEST = '{"do": "move", "angle_deg": {"index": 45, "middle": 45, "ring": 45, "thumb": 20}, "duration_s": 0.2}'


def gain_request(gain_by_key: Mapping[str, float]) -> str:
    return json.dumps({"do": "gains", "set": gain_by_key})


def noiseless_hand(model: HandModel) -> ControllerBench:
    """Return a test bench with a simulated hand whose load cells have no noise.

    The tendons of the hand are taut, and the hand waits for requests.
    """
    options = {"hand_path": str(hand_path("jamia")), "homed": True, "perturb": {"noise": 0.0}}
    peer = load_simulator("firmware_sim.lockstep_hand:LockstepHand", **options)
    bench = ControllerBench(uncommissioned_controller(model, LiveProgram()), peer)
    bench.run_until_mode(HandMode.ACTIVE)
    while bench.state.progress.phase != "live":
        bench.tick()
    return bench


@pytest.fixture
def bench_with_rising_tension(jamia: HandModel) -> ControllerBench:
    """Return a test bench whose hand raises its tensions, so that the tension loops have errors."""
    bench = noiseless_hand(jamia)
    bench.tick(HOLD_REQUEST)
    bench.run(0.1)
    return bench


def test_unused_designs_are_dropped_and_designs_of_the_run_are_kept(jamia: HandModel) -> None:
    run, designs = uncommissioned_controller(jamia, LiveProgram()), DesignCache()
    gains = Gains().model_copy(update={"tension": TensionGains(force_N=11.0)})
    complete_controller = designs.controller(run, gains)
    for force in range(20, 20 + 3 * MAX_CACHED_DESIGNS):
        designs.design_next_loop(
            jamia,
            PendingGains(
                Gains().model_copy(update={"tension": TensionGains(force_N=float(force))})
            ),
        )
        assert designs.controller(run, gains) is complete_controller
    assert len(designs.loop_designs) == MAX_CACHED_DESIGNS
    assert gains in designs.loop_designs
    assert set(designs.controllers) <= set(designs.loop_designs)


@pytest.mark.parametrize(
    "unsolvable_gain", [("motion.force_N", 1e-9), ("tension.tension_error_N", 1e-150)]
)
def test_weights_from_which_no_gains_follow_are_refused_and_the_run_goes_on(
    bench_with_rising_tension: ControllerBench, unsolvable_gain: tuple[str, float]
) -> None:
    gains_before = bench_with_rising_tension.state.decisions.gains
    outputs = [bench_with_rising_tension.tick(gain_request(dict([unsolvable_gain])))]
    outputs += [bench_with_rising_tension.tick() for _ in range(10)]
    (gains_event,) = [event for out in outputs for event in out.events if event.name == "gains"]
    assert gains_event.text.startswith("refused: gains: ")
    assert "no controller follows" in gains_event.text
    decisions = bench_with_rising_tension.state.decisions
    assert (decisions.gains, decisions.pending_gains, bench_with_rising_tension.state.mode) == (
        gains_before,
        None,
        HandMode.ACTIVE,
    )
    bench_with_rising_tension.tick(gain_request({"tension.force_N": 6.0}))
    bench_with_rising_tension.run(0.1)
    assert bench_with_rising_tension.state.decisions.gains is not None
    assert bench_with_rising_tension.state.decisions.gains.tension.force_N == 6.0, (
        "the next ones are taken"
    )


def test_a_hand_that_is_commissioned_keeps_its_gains(jamia: HandModel) -> None:
    """The controller refuses a change of gains during the commissioning.

    The run after the commissioning would not use gains that were changed during the commissioning.
    """
    bench = ControllerBench(
        uncommissioned_controller(jamia, CommissionProgram()),
        load_simulator(
            "firmware_sim.lockstep_hand:LockstepHand", hand_path=str(hand_path("jamia"))
        ),
    )
    bench.run_until_mode(HandMode.ACTIVE)
    out = bench.tick(gain_request({"motion.force_N": 20.0}))
    assert "refused: the hand is being commissioned" in [event.text for event in out.events]
    assert bench.state.decisions.pending_gains is None


def test_a_change_is_taken_over_when_every_piece_is_designed(
    bench_with_rising_tension: ControllerBench, jamia: HandModel
) -> None:
    outputs = [bench_with_rising_tension.tick(gain_request({"tension.force_N": 45.0}))]
    outputs += [
        bench_with_rising_tension.tick()
        for _ in range(control_loop_count(jamia.tendon_constants) + 2)
    ]
    events = [[event for event in out.events if event.name == "gain"] for out in outputs]
    at = [i for i, event_of_tick in enumerate(events) if event_of_tick]
    assert at == [control_loop_count(jamia.tendon_constants) - 1]
    assert [(event.where, event.text) for event in events[at[0]]] == [("tension.force_N", "45.0")]
    assert bench_with_rising_tension.state.decisions.gains is not None
    assert bench_with_rising_tension.state.decisions.gains.tension.force_N == 45.0
    hashes = {out.state_hash for out in outputs}
    assert len(hashes) == len(outputs)


RecordedControlLawCall = tuple[Controller, ControllerState, ControllerState, SafetyAction, int]


def record_control_law_calls(monkeypatch: pytest.MonkeyPatch) -> list[RecordedControlLawCall]:
    """Return a list that records each call of the control law.

    An entry of the list contains the arguments of the call, and the states of the controller before
    and after the call.
    """
    calls = list[RecordedControlLawCall]()
    compute_torques, command_active_hand = (
        Controller._compute_torques,
        Controller._command_active_hand,
    )

    def record_torques(
        self: Controller, state: ControllerState, action: SafetyAction, ticks: int
    ) -> None:
        state_before = state.copy()
        compute_torques(self, state, action, ticks)
        calls.append((self, state_before, state.copy(), action, ticks))

    def record_commands(
        self: Controller,
        state: ControllerState,
        frame_rows: WordRows,
        action: SafetyAction,
        ticks: int,
    ) -> tuple[int, int]:
        state_before = state.copy()
        encoded_commands = command_active_hand(self, state, frame_rows, action, ticks)
        calls.append((self, state_before, state.copy(), action, ticks))
        return encoded_commands

    monkeypatch.setattr(Controller, "_compute_torques", record_torques)
    monkeypatch.setattr(Controller, "_command_active_hand", record_commands)
    return calls


@pytest.mark.parametrize(
    ("request_text", "gain_by_key"),
    [
        (HOLD_REQUEST, {"tension.force_N": 45.0}),
        (HOLD_REQUEST, {"tension.force_N": 1.5}),
        (HOLD_REQUEST, {"tension.integral_per_s": 0.0, "motion.disturbance_rejection": 0.0}),
        (MOVE_REQUEST, {"motion.force_N": 60.0}),
        (MOVE_REQUEST, {"motion.position_error_m": 1.8e-3, "motion.tension_feedback": 1.0}),
    ],
)
def test_a_change_makes_no_step_in_torque(
    jamia: HandModel,
    monkeypatch: pytest.MonkeyPatch,
    request_text: str,
    gain_by_key: dict[str, float],
) -> None:
    """In the tick in which the gains change, a trim force keeps the commanded torque the same."""
    bench = noiseless_hand(jamia)
    bench.tick(request_text)
    bench.run(0.1)
    for _ in range(control_loop_count(jamia.tendon_constants) - 1):
        bench.tick(
            gain_request(gain_by_key)
        ) if bench.state.decisions.pending_gains is None else bench.tick()
    calls = record_control_law_calls(monkeypatch)
    out = bench.tick()
    assert any(event.name == "gain" for event in out.events)
    assert bench.state.run_integers[s.TRIM_ACTIVE]
    (_, state_before, _, action, ticks), (new_controller, _, without, *_) = calls
    state_with_trim = state_before.copy()
    state_with_trim.view("trim")[...] = bench.state.view("trim")
    state_with_trim.run_integers[s.TRIM_ACTIVE] = 1
    new_controller._compute_torques(state_with_trim, action, ticks)
    np.testing.assert_allclose(
        state_with_trim.view("torque"), out.telemetry.motor_torque_goal, atol=1e-12
    )
    assert np.abs(without.view("torque") - state_with_trim.view("torque")).max() > 1e-4


def test_while_safety_holds_new_gains_are_limited_like_the_old_ones(
    jamia: HandModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The controller limits the torque commands with old and with new gains in the same way.

    If the controller limited the commands with only the old or only the new gains, the difference
    of the commands would become a trim force. The trim force would make the tendon slack.
    """
    bench = noiseless_hand(jamia)
    bench.tick(MOVE_REQUEST)
    bench.run(0.05)
    judge_faults = Controller._judge_faults
    monkeypatch.setattr(
        Controller,
        "_judge_faults",
        lambda self, *words: (SafetyAction.HOLD, judge_faults(self, *words)[1]),
    )
    calls = record_control_law_calls(monkeypatch)
    bench.tick(gain_request({"motion.force_N": 60.0}))
    while bench.state.decisions.pending_gains is not None:
        calls.clear()
        bench.tick()
    (old_controller, _, old_state, *_), (new_controller, _, new_state, *_) = calls
    assert old_controller is not new_controller
    assert (
        old_state.run_integers[s.SAFETY_HOLD_ACTIVE]
        == new_state.run_integers[s.SAFETY_HOLD_ACTIVE]
        == 1
    )
    np.testing.assert_array_equal(new_state.view("limit_held"), old_state.view("limit_held"))
    limit = old_state.view("limit_held")
    for state in (old_state, new_state):
        np.testing.assert_array_equal(tension_limits_of(old_controller.model, state), limit)
        assert (
            state.view("torque") / jamia.tendon_constants.spool_radius
            <= limit + jamia.tendon_constants.coulomb_friction + 1e-9
        ).all()


def test_the_trim_fades_and_the_goal_is_reached(bench_with_rising_tension: ControllerBench) -> None:
    bench_with_rising_tension.tick(gain_request({"tension.tension_error_N": 1.4}))
    bench_with_rising_tension.run(2.5)
    assert not bench_with_rising_tension.state.run_integers[s.TRIM_ACTIVE]
    assert not bench_with_rising_tension.state.view("trim").any()
    tension = np.array(
        [out.telemetry.tension for *_, out in bench_with_rising_tension.tick_history[-200:]]
    )
    np.testing.assert_allclose(tension.mean(axis=0), 14.0, atol=1.0)


def test_two_changes_of_gains_add_up_and_can_be_undone(
    bench_with_rising_tension: ControllerBench, jamia: HandModel
) -> None:
    bench_with_rising_tension.tick(gain_request({"tension.force_N": 30.0}))
    bench_with_rising_tension.tick(gain_request({"motion.tension_feedback": 0.1}))
    bench_with_rising_tension.run(0.1)
    gains = bench_with_rising_tension.state.decisions.gains
    assert gains is not None
    assert (gains.tension.force_N, gains.motion.tension_feedback) == (30.0, 0.1)
    bench_with_rising_tension.tick(
        gain_request(
            {"tension.force_N": jamia.gains.tension.force_N, "motion.tension_feedback": 0.3}
        )
    )
    bench_with_rising_tension.run(0.1)
    assert bench_with_rising_tension.state.decisions.gains == jamia.gains


@pytest.mark.parametrize(
    ("gain_by_key", "expected_message"),
    [
        ({"tension.farce_N": 1.0}, "tension.force_N?"),
        ({"tension.force_N": 501.0}, "at most 500"),
        ({"tension.force_N": 0.0}, "more than 0"),
        ({"contact.ticks": 2.5}, "a whole number"),
        ({"filter.offset_m": 1e-4}, "designed before arming"),
        ({"tension.force_N": 30.0, "motion.force_N": -1.0}, "motion.force_N"),
    ],
)
def test_impossible_gains_are_refused_in_one_line_without_effect(
    bench_with_rising_tension: ControllerBench, gain_by_key: dict[str, float], expected_message: str
) -> None:
    out = bench_with_rising_tension.tick(gain_request(gain_by_key))
    lines = [event for event in out.events if event.name == "request" and event.level == "warn"]
    assert len(lines) == 1
    assert expected_message in lines[0].text
    assert "\n" not in lines[0].text
    bench_with_rising_tension.run(0.1)
    assert bench_with_rising_tension.state.decisions.gains is None


def test_a_hand_that_is_not_armed_takes_gains_without_a_trim(jamia: HandModel) -> None:
    bench = make_controller_bench(jamia, LiveProgram(), arms_at_start=False)
    bench.run_until_mode(HandMode.READY)
    bench.tick(gain_request({"motion.force_N": 40.0}))
    bench.run(0.1)
    assert bench.state.decisions.gains is not None
    assert not bench.state.run_integers[s.TRIM_ACTIVE]
    assert not bench.state.view("trim").any()


def test_every_key_has_bounds_and_its_default_is_within(jamia: HandModel) -> None:
    known_bounds = gain_bounds()
    assert known_bounds.keys() == values_by_key(Gains()).keys()
    assert len(known_bounds) > 20
    for key, bound in known_bounds.items():
        assert np.isfinite([bound.low, bound.high]).all(), key
        assert checked_gain_bounds(key, bound.default, "test") is bound
        with pytest.raises(ConfigError):
            checked_gain_bounds(key, bound.high * 1.01, "test")


@pytest.mark.parametrize("uses_upper_bound", [False, True])
def test_every_corner_of_the_live_bounds_can_be_designed(
    jamia: HandModel, uses_upper_bound: bool
) -> None:
    """The test sets one gain at a time to its bound. All gains except the gain at its bound keep their defaults.

    If a gain must be greater than its lower bound, the test uses the lower bound plus one hundredth
    of the gain's default.
    """
    for key, bound in gain_bounds().items():
        if bound.is_changeable_live:
            value = (
                bound.high
                if uses_upper_bound
                else bound.low + (0.01 * bound.default if bound.is_low_excluded else 0.0)
            )
            gains = gains_with_values(
                Gains(),
                {key: value if not bound.is_integer else round(value)},
                "test",
                is_live=True,
            )
            design = design_motion(jamia.tendon_constants, gains, jamia.period)
            assert np.isfinite(
                [design.stiffness, design.damping, design.tension, design.tension_speed]
            ).all(), key


def test_the_request_needs_at_least_one_value() -> None:
    assert isinstance(parse_request('{"do": "gains", "set": {}}'), str)
