"""Test the modes of the controller, from the start through a motion to a confirmed stop.

The controller runs with the simple hand ``ToyHand``.
"""

import numpy as np
import pytest

from handctl.controller.hand_modes import (
    ARMING_TIMEOUT_S,
    DISARM_TIMEOUT_S,
    INVENTORY_TIMEOUT_S,
    LISTENING_DURATION_S,
    READY_DURATION_S,
    TORQUE_CUT_DURATION_S,
)
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, IoEvent
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from handctl.safety.safety_action import SafetyAction
from tests.controller.controller_bench import ControllerBench, make_controller_bench

STOP_REQUEST, CUT_REQUEST, ARM_REQUEST = '{"do": "stop"}', '{"do": "cut"}', '{"do": "arm"}'
MODES_UNTIL_ACTIVE = [
    HandMode.SILENT,
    HandMode.INVENTORY,
    HandMode.READY,
    HandMode.ARMING,
    HandMode.ACTIVE,
]
MODES_UNTIL_DONE = [HandMode.RELAX, HandMode.DISARM, HandMode.DONE]
ENABLE_PAYLOAD, DISABLE_PAYLOAD = b"\xff" * 7 + b"\xfc", b"\xff" * 7 + b"\xfd"


@pytest.fixture(scope="module")
def jamia_at_low_rate() -> HandModel:
    """Return a hand model at a low control rate.

    The low control rate makes the tests fast. All times in the tests are in seconds, and do not
    depend on the control rate.
    """
    return HandModel.from_hand(load_hand("jamia"), Gains(), 200.0)


@pytest.fixture
def hand_bench(jamia_at_low_rate: HandModel) -> ControllerBench:
    return make_controller_bench(jamia_at_low_rate, LiveProgram())


def duration_in_mode(bench: ControllerBench, mode: HandMode) -> float:
    return sum(out.mode == mode for _, _, out in bench.tick_history) * bench.controller.model.period


def can_ids_with_payload(run: ControllerBench, payload: bytes) -> list[int]:
    """Return the identifiers of all sent frames whose payload is ``payload``, in the order of sending."""
    return [
        frame.can_id
        for _, _, out in run.tick_history
        for frame in out.frames
        if frame.data == payload
    ]


def all_motors_disabled(bench: ControllerBench) -> bool:
    return all(motor.state_nibble != 1 for motor in bench.toy_hand.motors)


def test_a_hand_goes_through_all_modes_and_ends_disabled(model: HandModel) -> None:
    run = make_controller_bench(model, LiveProgram())
    run.run_until_mode(HandMode.ACTIVE)
    assert run.mode_history == MODES_UNTIL_ACTIVE
    assert duration_in_mode(run, HandMode.SILENT) == pytest.approx(
        LISTENING_DURATION_S, abs=1.5 * model.period
    )
    assert duration_in_mode(run, HandMode.READY) == pytest.approx(
        READY_DURATION_S, abs=1.5 * model.period
    )
    for _, _, out in run.tick_history:
        if out.mode == HandMode.SILENT:
            assert out.frames == (), "silent means silent"
    assert can_ids_with_payload(run, ENABLE_PAYLOAD) == [
        motor.node_id for motor in run.toy_hand.motors
    ], "each drive is enabled once"
    assert [motor.state_nibble for motor in run.toy_hand.motors] == [1] * model.tendon_count
    run.run(2.0)
    assert run.state.progress.phase == "live"
    run.tick(STOP_REQUEST)
    run.run_until_mode(HandMode.DONE)
    assert run.mode_history == MODES_UNTIL_ACTIVE + MODES_UNTIL_DONE
    assert all_motors_disabled(run)
    assert (run.state.failure, run.state.unconfirmed_motors) == ("", ())
    assert run.tick().frames == (), "done means silent"


def test_registers_are_written_before_any_torque(hand_bench: ControllerBench) -> None:
    for motor in hand_bench.toy_hand.motors:
        motor.registers[23] = 1.0
    hand_bench.run_until_mode(HandMode.ACTIVE)
    assert all(motor.written_registers for motor in hand_bench.toy_hand.motors)
    assert all(motor.registers[9] == 1000 for motor in hand_bench.toy_hand.motors), (
        "watchdog of 50 ms, in units of 50 us"
    )
    assert all(motor.registers[23] == pytest.approx(0.8) for motor in hand_bench.toy_hand.motors), (
        "torque limit"
    )


def test_hand_waits_without_an_arm_request(jamia_at_low_rate: HandModel) -> None:
    run = make_controller_bench(jamia_at_low_rate, LiveProgram(), arms_at_start=False)
    run.run_until_mode(HandMode.READY)
    run.run(2.0)
    assert run.state.mode == HandMode.READY
    assert can_ids_with_payload(run, ENABLE_PAYLOAD) == []
    run.tick(ARM_REQUEST)
    run.run_until_mode(HandMode.ACTIVE, 1.0)


@pytest.mark.parametrize(
    ("mode", "expected_modes"),
    [
        (HandMode.SILENT, [HandMode.DONE]),
        (HandMode.INVENTORY, [HandMode.DONE]),
        (HandMode.READY, [HandMode.DONE]),
        (HandMode.ARMING, [HandMode.DISARM, HandMode.DONE]),
        (HandMode.ACTIVE, MODES_UNTIL_DONE),
    ],
)
def test_stop_from_every_mode(
    hand_bench: ControllerBench, mode: HandMode, expected_modes: list[HandMode]
) -> None:
    hand_bench.run_until_mode(mode)
    hand_bench.tick(STOP_REQUEST)
    hand_bench.run_until_mode(HandMode.DONE)
    assert (
        hand_bench.mode_history
        == MODES_UNTIL_ACTIVE[: MODES_UNTIL_ACTIVE.index(mode) + 1] + expected_modes
    )
    assert all_motors_disabled(hand_bench)
    assert not hand_bench.state.failure
    if mode < HandMode.ARMING:
        assert can_ids_with_payload(hand_bench, ENABLE_PAYLOAD) == []


@pytest.mark.parametrize(
    "mode",
    [
        HandMode.SILENT,
        HandMode.INVENTORY,
        HandMode.READY,
        HandMode.ARMING,
        HandMode.ACTIVE,
        HandMode.RELAX,
    ],
)
def test_cut_from_every_mode(hand_bench: ControllerBench, mode: HandMode) -> None:
    if mode == HandMode.RELAX:
        hand_bench.run_until_mode(HandMode.ACTIVE)
        hand_bench.run(2.0)
        hand_bench.tick('{"do": "hold", "tension_N": {"index": 40}, "rate_N_per_s": 1000}')
        hand_bench.run(0.5)
        hand_bench.tick(STOP_REQUEST)
        assert hand_bench.state.mode == HandMode.RELAX
    else:
        hand_bench.run_until_mode(mode)
    first_output = hand_bench.tick(CUT_REQUEST)
    if mode < HandMode.ARMING:
        assert first_output.mode == HandMode.DONE
        return
    assert first_output.mode == HandMode.CUT
    ids = [motor.node_id for motor in hand_bench.toy_hand.motors]
    assert [(f.can_id, f.data) for f in first_output.frames[: len(ids)]] == [
        (i, DISABLE_PAYLOAD) for i in ids
    ], "before all else"
    assert all_motors_disabled(hand_bench), "without a ramp, in the same tick"
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.mode_history[-3:] == [HandMode.CUT, HandMode.DISARM, HandMode.DONE]
    assert duration_in_mode(hand_bench, HandMode.CUT) == pytest.approx(
        TORQUE_CUT_DURATION_S, abs=1.5 * hand_bench.controller.model.period
    )
    assert not hand_bench.state.failure, "a person wanted it"


def test_a_second_stop_does_not_lengthen_the_first(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(0.5)
    hand_bench.tick(STOP_REQUEST)
    hand_bench.tick(STOP_REQUEST)
    hand_bench.run_until_mode(HandMode.DONE, 2.0)


def command_of_other_host(hand_bench: ControllerBench) -> Frame:
    """Return a frame with a torque command to the first motor.

    The controller under test does not send the returned command frame, so only a second controller
    could have sent this frame.
    """
    return Frame(
        hand_bench.toy_hand.motors[0].node_id, bytes(8), t_ns=hand_bench.k * hand_bench.period_ns
    )


def test_a_second_controller_that_is_heard_first_is_left_alone(hand_bench: ControllerBench) -> None:
    hand_bench.run(0.2)
    hand_bench.tick(extra_frames=(command_of_other_host(hand_bench),))
    hand_bench.run_until_mode(HandMode.DONE, 1.0)
    assert "another controller" in hand_bench.state.failure
    assert "0x001" in hand_bench.state.failure
    assert all(out.frames == () for _, _, out in hand_bench.tick_history)


@pytest.mark.parametrize("mode", [HandMode.INVENTORY, HandMode.READY])
def test_a_second_controller_that_comes_before_arming_prevents_it(
    hand_bench: ControllerBench, mode: HandMode
) -> None:
    hand_bench.run_until_mode(mode)
    hand_bench.tick(extra_frames=(command_of_other_host(hand_bench),))
    assert hand_bench.state.mode == HandMode.DONE
    assert "another controller" in hand_bench.state.failure
    assert can_ids_with_payload(hand_bench, ENABLE_PAYLOAD) == []


def test_a_second_controller_in_active_mode_causes_relax(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(1.0)
    assert (
        hand_bench.tick(extra_frames=(command_of_other_host(hand_bench),)).action
        == SafetyAction.RELAX
    )
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.mode_history == MODES_UNTIL_ACTIVE + MODES_UNTIL_DONE
    assert "H13" in hand_bench.state.failure
    assert all_motors_disabled(hand_bench)


def test_the_sync_of_another_host_is_foreign_too(hand_bench: ControllerBench) -> None:
    hand_bench.run(0.1)
    hand_bench.tick(extra_frames=(Frame(0x080, b"\0"),))
    hand_bench.run_until_mode(HandMode.DONE, 1.0)
    assert "0x080" in hand_bench.state.failure


def test_unknown_identifiers_are_not_signs_of_a_second_controller(
    hand_bench: ControllerBench,
) -> None:
    hand_bench.run(0.1)
    for can_id in (0x555, 0x1A0 | 1 << 31, 0x001 | 1 << 31):
        hand_bench.tick(extra_frames=(Frame(can_id, bytes(8)),))
    hand_bench.run_until_mode(HandMode.ACTIVE)


def test_a_missing_motor_is_named(hand_bench: ControllerBench) -> None:
    hand_bench.toy_hand.motors[2].is_silent = True
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.state.failure == "no answer from ring_motor"
    assert can_ids_with_payload(hand_bench, ENABLE_PAYLOAD) == []
    assert duration_in_mode(hand_bench, HandMode.INVENTORY) == pytest.approx(
        INVENTORY_TIMEOUT_S, abs=0.05
    )


def test_two_missing_motors_and_a_missing_sensor_node_are_all_named(
    hand_bench: ControllerBench,
) -> None:
    hand_bench.toy_hand.motors[0].is_silent = hand_bench.toy_hand.motors[3].is_silent = True
    hand_bench.toy_hand.silent_sensors = True
    hand_bench.run_until_mode(HandMode.DONE)
    for name in ("index_motor", "thumb_motor", "sensor node"):
        assert name in hand_bench.state.failure
    assert "ring_motor" not in hand_bench.state.failure


def test_silent_joint_encoders_are_reported_as_missing(jamia11: HandModel) -> None:
    run = make_controller_bench(jamia11, LiveProgram())
    joint_ids = {0x1B0, 0x1B1, 0x1B2}
    run.modify_frames_to_host = lambda frames: [
        frame for frame in frames if frame.can_id not in joint_ids
    ]
    run.run_until_mode(HandMode.DONE)
    assert run.state.failure == "no answer from the sensor node"


def test_a_motor_that_reports_an_error_is_named_with_it(hand_bench: ControllerBench) -> None:
    hand_bench.toy_hand.motors[1].state_nibble = 0xB
    hand_bench.run_until_mode(HandMode.DONE)
    assert "middle_motor" in hand_bench.state.failure
    assert can_ids_with_payload(hand_bench, ENABLE_PAYLOAD) == []


def test_a_register_that_does_not_read_back_is_named(hand_bench: ControllerBench) -> None:
    hand_bench.toy_hand.motors[1].registers[23] = 1.25
    hand_bench.toy_hand.motors[1].fixed_registers.add(23)
    hand_bench.run_until_mode(HandMode.DONE)
    assert "middle_motor" in hand_bench.state.failure
    assert "1.25" in hand_bench.state.failure


def test_a_motor_that_does_not_enable_is_named_and_all_are_disabled_again(
    hand_bench: ControllerBench,
) -> None:
    hand_bench.toy_hand.motors[1].ignored_commands.add(0xFC)
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.state.failure == "not enabled: middle_motor"
    assert hand_bench.mode_history == [*MODES_UNTIL_ACTIVE[:4], HandMode.DISARM, HandMode.DONE]
    assert duration_in_mode(hand_bench, HandMode.ARMING) == pytest.approx(
        ARMING_TIMEOUT_S, abs=0.05
    )
    assert all_motors_disabled(hand_bench)


def test_a_motor_that_does_not_confirm_disabling_needs_its_power_removed(
    hand_bench: ControllerBench,
) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.toy_hand.motors[3].ignored_commands.add(0xFD)
    hand_bench.tick(STOP_REQUEST)
    hand_bench.run_until_mode(HandMode.DISARM)
    hand_bench.toy_hand.motor_force[3] = 0.0  # the motor stays enabled, but makes no torque
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.state.unconfirmed_motors == ("thumb_motor",)
    assert hand_bench.state.failure == "REMOVE POWER: not confirmed disabled: thumb_motor"
    assert duration_in_mode(hand_bench, HandMode.DISARM) == pytest.approx(
        DISARM_TIMEOUT_S, abs=0.05
    )


def test_a_motor_that_keeps_its_torque_needs_its_power_removed_at_once(
    hand_bench: ControllerBench,
) -> None:
    """In this test, a motor still reports a torque 0.1 s after it was disabled.

    If a motor still makes torque after the disable command, this is the fault N16 (a drive does not
    release).
    """
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.toy_hand.motors[3].ignored_commands.add(0xFD)
    hand_bench.tick(STOP_REQUEST)
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.state.unconfirmed_motors == ("thumb_motor",)
    assert hand_bench.state.failure == "REMOVE POWER: still pulling after the cut: thumb_motor"
    assert duration_in_mode(hand_bench, HandMode.DISARM) < 0.2


def test_a_motor_that_reports_disabled_and_pulls_needs_its_power_removed(
    hand_bench: ControllerBench,
) -> None:
    """Reproduce a defect: after an ordinary stop, a run ended although a motor still pulled.

    The run ended as soon as all drives reported that they were disabled, and nothing checked
    whether a motor still pulled.
    """
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(1.0)
    hand_bench.tick(STOP_REQUEST)
    hand_bench.run_until_mode(HandMode.DISARM)
    # The motor reports that it is disabled, but the load cell of its tendon still reads 30 N.
    hand_bench.toy_hand.cell_bias[3] = 30.0
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.state.failure == "REMOVE POWER: still pulling after the cut: thumb_motor"


def test_a_silent_motor_relaxes_the_others_and_both_faults_are_reported(
    hand_bench: ControllerBench,
) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(1.0)
    hand_bench.toy_hand.motors[0].is_silent = True
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.mode_history == MODES_UNTIL_ACTIVE + MODES_UNTIL_DONE
    assert hand_bench.state.unconfirmed_motors == ("index_motor",)
    assert "B17 index_motor" in hand_bench.state.failure
    assert "REMOVE POWER" in hand_bench.state.failure
    assert all(motor.state_nibble != 1 for motor in hand_bench.toy_hand.motors[1:])


def test_a_drive_error_in_action(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(1.0)
    hand_bench.toy_hand.motors[2].state_nibble = 0xC
    hand_bench.run_until_mode(HandMode.DONE)
    assert "N11 ring_motor" in hand_bench.state.failure
    assert hand_bench.mode_history == MODES_UNTIL_ACTIVE + MODES_UNTIL_DONE
    assert hand_bench.state.unconfirmed_motors == ()


def test_a_lost_bus_causes_a_cut(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    out = hand_bench.tick(io_events=(IoEvent("enodev", "local:x"),))
    assert (out.mode, out.action) == (HandMode.CUT, SafetyAction.CUT)
    hand_bench.run_until_mode(HandMode.DONE)
    assert "B16" in hand_bench.state.failure


@pytest.mark.parametrize("mode", [HandMode.SILENT, HandMode.INVENTORY, HandMode.READY])
def test_a_lost_bus_before_arming_ends_the_run(hand_bench: ControllerBench, mode: HandMode) -> None:
    hand_bench.run_until_mode(mode)
    assert hand_bench.tick(io_events=(IoEvent("enodev", "local:x"),)).mode == HandMode.DONE
    assert "B16" in hand_bench.state.failure
    assert can_ids_with_payload(hand_bench, ENABLE_PAYLOAD) == []


def test_a_fault_while_arming_disarms(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ARMING)
    hand_bench.tick(extra_frames=(command_of_other_host(hand_bench),))
    hand_bench.run_until_mode(HandMode.DONE)
    assert "H13" in hand_bench.state.failure
    assert all_motors_disabled(hand_bench)


def test_a_cut_during_relax_wins(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(2.0)
    hand_bench.tick('{"do": "hold", "tension_N": {"index": 60}, "rate_N_per_s": 1000}')
    hand_bench.run(0.5)
    assert hand_bench.tick(extra_frames=(command_of_other_host(hand_bench),)).mode == HandMode.RELAX
    assert hand_bench.tick(io_events=(IoEvent("bus_off", "local:x"),)).mode == HandMode.CUT
    hand_bench.run_until_mode(HandMode.DONE)
    assert "H13" in hand_bench.state.failure, "what began it"


def test_relax_lowers_the_tension_slowly_and_ends_in_time(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(2.0)
    hand_bench.tick('{"do": "hold", "tension_N": {"index": 60, "thumb": 50}, "rate_N_per_s": 1000}')
    hand_bench.run(1.0)
    held_tension = hand_bench.toy_hand.tension.copy()
    assert held_tension[0] > 55.0
    hand_bench.tick(STOP_REQUEST)
    while hand_bench.state.mode == HandMode.RELAX:
        hand_bench.tick()
    assert 0.05 < duration_in_mode(hand_bench, HandMode.RELAX) < 0.5, "500 N/s from 60 N"
    goals = np.array(
        [
            out.telemetry.tension_goal
            for _, _, out in hand_bench.tick_history
            if out.mode == HandMode.RELAX
        ]
    )
    assert (np.diff(goals, axis=0) <= 1e-9).all(), "no tension rises"
    assert np.abs(np.diff(goals, axis=0)).max() <= 500.0 * hand_bench.controller.model.period + 1e-9
    assert (goals[-1] <= 5.0 + 500.0 * hand_bench.controller.model.period + 1e-6).all()


def test_a_program_that_fails_relaxes_the_hand_and_gives_a_reason(
    jamia_at_low_rate: HandModel,
) -> None:
    run = make_controller_bench(jamia_at_low_rate, LiveProgram())
    run.toy_hand.snap_tendon(1)  # the load cell of a torn tendon reads zero
    run.run_until_mode(HandMode.DONE, 20.0)
    assert run.state.failure == "not taut after 4 s: middle_tendon"
    assert run.mode_history == MODES_UNTIL_ACTIVE + MODES_UNTIL_DONE


def test_clear_resets_latched_faults_and_arms_no_drive(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.tick(extra_frames=(command_of_other_host(hand_bench),))
    assert hand_bench.state.latched_faults
    hand_bench.tick('{"do": "clear"}')
    assert not hand_bench.state.latched_faults
    hand_bench.run_until_mode(HandMode.DONE)
    assert hand_bench.mode_history == MODES_UNTIL_ACTIVE + MODES_UNTIL_DONE


def test_every_mode_change_is_reported_once(hand_bench: ControllerBench) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.tick(STOP_REQUEST)
    hand_bench.run_until_mode(HandMode.DONE)
    mode_changes = [
        event.text.partition(":")[0] for event in hand_bench.events if event.name == "mode"
    ]
    assert mode_changes == [
        f"{a.name} -> {b.name}"
        for a, b in zip(hand_bench.mode_history, hand_bench.mode_history[1:], strict=False)
    ]


def test_the_time_of_a_program_stops_during_a_hold_by_safety(
    hand_bench: ControllerBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand_bench.run_until_mode(HandMode.ACTIVE)
    hand_bench.run(1.0)
    state_before = hand_bench.state
    real = Controller._judge_faults
    monkeypatch.setattr(
        Controller, "_judge_faults", lambda self, *words: (SafetyAction.HOLD, real(self, *words)[1])
    )
    hand_bench.run(0.5)
    assert hand_bench.state.mode == HandMode.ACTIVE
    assert hand_bench.state.goal_time == state_before.goal_time
    assert hand_bench.state.progress == state_before.progress
    monkeypatch.undo()
    hand_bench.tick()
    assert hand_bench.state.goal_time > state_before.goal_time
