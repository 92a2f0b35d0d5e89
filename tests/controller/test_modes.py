"""Test the modes of the controller, from the start to a motion and back to a confirmed stop.

The motors of the hand are scripted.
"""

import numpy as np
import pytest

from handctl.controller.hand_modes import (
    ARMING_TIMEOUT_S,
    CUT_DURATION_S,
    DISARM_TIMEOUT_S,
    INVENTORY_TIMEOUT_S,
    LISTENING_DURATION_S,
    READY_DURATION_S,
)
from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, IoEvent
from handctl.drives.frame import Frame
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from handctl.safety.action import SafetyAction
from tests.controller.bench import Bench, bench

STOP, CUT, ARM = '{"do": "stop"}', '{"do": "cut"}', '{"do": "arm"}'
HAPPY = [HandMode.SILENT, HandMode.INVENTORY, HandMode.READY, HandMode.ARMING, HandMode.ACTIVE]
HOME = [HandMode.RELAX, HandMode.DISARM, HandMode.DONE]
ENABLE, DISABLE = b"\xff" * 7 + b"\xfc", b"\xff" * 7 + b"\xfd"


@pytest.fixture(scope="module")
def quick() -> HandModel:
    """Return a model at a low control rate. The low rate makes the tests fast, and all times are in seconds."""
    return HandModel.from_hand(load_hand("jamia"), Gains(), 200.0)


@pytest.fixture
def hand(quick: HandModel) -> Bench:
    return bench(quick, LiveProgram())


def duration_in(run: Bench, mode: HandMode) -> float:
    return sum(out.mode == mode for _, _, out in run.history) * run.controller.model.period


def ids_sent(run: Bench, data: bytes) -> list[int]:
    """Return the identifiers of all sent frames that consist of the bytes ``data``, in the order of sending."""
    return [frame.can_id for _, _, out in run.history for frame in out.frames if frame.data == data]


def disabled(run: Bench) -> bool:
    return all(motor.nibble != 1 for motor in run.peer.motors)


def test_a_hand_goes_through_all_modes_and_ends_disabled(model: HandModel) -> None:
    run = bench(model, LiveProgram())
    run.until(HandMode.ACTIVE)
    assert run.modes == HAPPY
    assert duration_in(run, HandMode.SILENT) == pytest.approx(
        LISTENING_DURATION_S, abs=1.5 * model.period
    )
    assert duration_in(run, HandMode.READY) == pytest.approx(
        READY_DURATION_S, abs=1.5 * model.period
    )
    for _, _, out in run.history:
        if out.mode == HandMode.SILENT:
            assert out.frames == (), "silent means silent"
    assert ids_sent(run, ENABLE) == [motor.node_id for motor in run.peer.motors], (
        "each drive is enabled once"
    )
    assert [motor.nibble for motor in run.peer.motors] == [1] * model.tendon_count
    run.run(2.0)
    assert run.state.progress.phase == "live"
    run.tick(STOP)
    run.until(HandMode.DONE)
    assert run.modes == HAPPY + HOME
    assert disabled(run)
    assert (run.state.failure, run.state.unconfirmed) == ("", ())
    assert run.tick().frames == (), "done means silent"


def test_registers_are_written_before_any_torque(hand: Bench) -> None:
    for motor in hand.peer.motors:
        motor.registers[23] = 1.0
    hand.until(HandMode.ACTIVE)
    assert all(motor.written for motor in hand.peer.motors)
    assert all(motor.registers[9] == 1000 for motor in hand.peer.motors), (
        "watchdog of 50 ms, in units of 50 us"
    )
    assert all(motor.registers[23] == pytest.approx(0.8) for motor in hand.peer.motors), (
        "torque limit"
    )


def test_hand_waits_without_an_arm_request(quick: HandModel) -> None:
    run = bench(quick, LiveProgram(), arm=False)
    run.until(HandMode.READY)
    run.run(2.0)
    assert run.state.mode == HandMode.READY
    assert ids_sent(run, ENABLE) == []
    run.tick(ARM)
    run.until(HandMode.ACTIVE, 1.0)


@pytest.mark.parametrize(
    ("mode", "way"),
    [
        (HandMode.SILENT, [HandMode.DONE]),
        (HandMode.INVENTORY, [HandMode.DONE]),
        (HandMode.READY, [HandMode.DONE]),
        (HandMode.ARMING, [HandMode.DISARM, HandMode.DONE]),
        (HandMode.ACTIVE, HOME),
    ],
)
def test_stop_from_every_mode(hand: Bench, mode: HandMode, way: list[HandMode]) -> None:
    hand.until(mode)
    hand.tick(STOP)
    hand.until(HandMode.DONE)
    assert hand.modes == HAPPY[: HAPPY.index(mode) + 1] + way
    assert disabled(hand)
    assert not hand.state.failure
    if mode < HandMode.ARMING:
        assert ids_sent(hand, ENABLE) == []


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
def test_cut_from_every_mode(hand: Bench, mode: HandMode) -> None:
    if mode == HandMode.RELAX:
        hand.until(HandMode.ACTIVE)
        hand.run(2.0)
        hand.tick('{"do": "hold", "tension_N": {"index": 40}, "rate_N_per_s": 1000}')
        hand.run(0.5)
        hand.tick(STOP)
        assert hand.state.mode == HandMode.RELAX
    else:
        hand.until(mode)
    first = hand.tick(CUT)
    if mode < HandMode.ARMING:
        assert first.mode == HandMode.DONE
        return
    assert first.mode == HandMode.CUT
    ids = [motor.node_id for motor in hand.peer.motors]
    assert [(f.can_id, f.data) for f in first.frames[: len(ids)]] == [(i, DISABLE) for i in ids], (
        "before all else"
    )
    assert disabled(hand), "without a ramp, in the same tick"
    hand.until(HandMode.DONE)
    assert hand.modes[-3:] == [HandMode.CUT, HandMode.DISARM, HandMode.DONE]
    assert duration_in(hand, HandMode.CUT) == pytest.approx(
        CUT_DURATION_S, abs=1.5 * hand.controller.model.period
    )
    assert not hand.state.failure, "a person wanted it"


def test_a_second_stop_does_not_lengthen_the_first(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.run(0.5)
    hand.tick(STOP)
    hand.tick(STOP)
    hand.until(HandMode.DONE, 2.0)


def foreign_command(hand: Bench) -> Frame:
    """Return a torque command to the first motor. Such a frame on the bus can only come from a second controller."""
    return Frame(hand.peer.motors[0].node_id, bytes(8), t_ns=hand.k * hand.period_ns)


def test_a_second_controller_that_is_heard_first_is_left_alone(hand: Bench) -> None:
    hand.run(0.2)
    hand.tick(extra=(foreign_command(hand),))
    hand.until(HandMode.DONE, 1.0)
    assert "another controller" in hand.state.failure
    assert "0x001" in hand.state.failure
    assert all(out.frames == () for _, _, out in hand.history)


@pytest.mark.parametrize("mode", [HandMode.INVENTORY, HandMode.READY])
def test_a_second_controller_that_comes_before_arming_prevents_it(
    hand: Bench, mode: HandMode
) -> None:
    hand.until(mode)
    hand.tick(extra=(foreign_command(hand),))
    assert hand.state.mode == HandMode.DONE
    assert "another controller" in hand.state.failure
    assert ids_sent(hand, ENABLE) == []


def test_a_second_controller_in_active_mode_causes_relax(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.run(1.0)
    assert hand.tick(extra=(foreign_command(hand),)).action == SafetyAction.RELAX
    hand.until(HandMode.DONE)
    assert hand.modes == HAPPY + HOME
    assert "H13" in hand.state.failure
    assert disabled(hand)


def test_the_sync_of_another_host_is_foreign_too(hand: Bench) -> None:
    hand.run(0.1)
    hand.tick(extra=(Frame(0x080, b"\0"),))
    hand.until(HandMode.DONE, 1.0)
    assert "0x080" in hand.state.failure


def test_unknown_identifiers_are_not_signs_of_a_second_controller(hand: Bench) -> None:
    hand.run(0.1)
    for can_id in (0x555, 0x1A0 | 1 << 31, 0x001 | 1 << 31):
        hand.tick(extra=(Frame(can_id, bytes(8)),))
    hand.until(HandMode.ACTIVE)


def test_a_missing_motor_is_named(hand: Bench) -> None:
    hand.peer.motors[2].silent = True
    hand.until(HandMode.DONE)
    assert hand.state.failure == "no answer from ring_motor"
    assert ids_sent(hand, ENABLE) == []
    assert duration_in(hand, HandMode.INVENTORY) == pytest.approx(INVENTORY_TIMEOUT_S, abs=0.05)


def test_two_missing_motors_and_a_missing_sensor_node_are_all_named(hand: Bench) -> None:
    hand.peer.motors[0].silent = hand.peer.motors[3].silent = True
    hand.peer.silent_sensors = True
    hand.until(HandMode.DONE)
    for name in ("index_motor", "thumb_motor", "sensor node"):
        assert name in hand.state.failure
    assert "ring_motor" not in hand.state.failure


def test_silent_joint_encoders_are_reported_as_missing(jamia11: HandModel) -> None:
    run = bench(jamia11, LiveProgram())
    joint_ids = {0x1B0, 0x1B1, 0x1B2}
    run.to_host = lambda frames: [frame for frame in frames if frame.can_id not in joint_ids]
    run.until(HandMode.DONE)
    assert run.state.failure == "no answer from the sensor node"


def test_a_motor_that_reports_an_error_is_named_with_it(hand: Bench) -> None:
    hand.peer.motors[1].nibble = 0xB
    hand.until(HandMode.DONE)
    assert "middle_motor" in hand.state.failure
    assert ids_sent(hand, ENABLE) == []


def test_a_register_that_does_not_read_back_is_named(hand: Bench) -> None:
    hand.peer.motors[1].registers[23] = 1.25
    hand.peer.motors[1].stuck.add(23)
    hand.until(HandMode.DONE)
    assert "middle_motor" in hand.state.failure
    assert "1.25" in hand.state.failure


def test_a_motor_that_does_not_enable_is_named_and_all_are_disabled_again(hand: Bench) -> None:
    hand.peer.motors[1].deaf.add(0xFC)
    hand.until(HandMode.DONE)
    assert hand.state.failure == "not enabled: middle_motor"
    assert hand.modes == [*HAPPY[:4], HandMode.DISARM, HandMode.DONE]
    assert duration_in(hand, HandMode.ARMING) == pytest.approx(ARMING_TIMEOUT_S, abs=0.05)
    assert disabled(hand)


def test_a_motor_that_does_not_confirm_disabling_needs_its_power_removed(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.peer.motors[3].deaf.add(0xFD)
    hand.tick(STOP)
    hand.until(HandMode.DONE)
    assert hand.state.unconfirmed == ("thumb_motor",)
    assert hand.state.failure == "REMOVE POWER: not confirmed disabled: thumb_motor"
    assert duration_in(hand, HandMode.DISARM) == pytest.approx(DISARM_TIMEOUT_S, abs=0.05)


def test_a_silent_motor_relaxes_the_others_and_both_faults_are_reported(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.run(1.0)
    hand.peer.motors[0].silent = True
    hand.until(HandMode.DONE)
    assert hand.modes == HAPPY + HOME
    assert hand.state.unconfirmed == ("index_motor",)
    assert "B17 index_motor" in hand.state.failure
    assert "REMOVE POWER" in hand.state.failure
    assert all(motor.nibble != 1 for motor in hand.peer.motors[1:])


def test_a_drive_error_in_action(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.run(1.0)
    hand.peer.motors[2].nibble = 0xC
    hand.until(HandMode.DONE)
    assert "N11 ring_motor" in hand.state.failure
    assert hand.modes == HAPPY + HOME
    assert hand.state.unconfirmed == ()


def test_a_lost_bus_causes_a_cut(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    out = hand.tick(io=(IoEvent("enodev", "local:x"),))
    assert (out.mode, out.action) == (HandMode.CUT, SafetyAction.CUT)
    hand.until(HandMode.DONE)
    assert "B16" in hand.state.failure


@pytest.mark.parametrize("mode", [HandMode.SILENT, HandMode.INVENTORY, HandMode.READY])
def test_a_lost_bus_before_arming_ends_the_run(hand: Bench, mode: HandMode) -> None:
    hand.until(mode)
    assert hand.tick(io=(IoEvent("enodev", "local:x"),)).mode == HandMode.DONE
    assert "B16" in hand.state.failure
    assert ids_sent(hand, ENABLE) == []


def test_a_fault_while_arming_disarms(hand: Bench) -> None:
    hand.until(HandMode.ARMING)
    hand.tick(extra=(foreign_command(hand),))
    hand.until(HandMode.DONE)
    assert "H13" in hand.state.failure
    assert disabled(hand)


def test_a_cut_during_relax_wins(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.run(2.0)
    hand.tick('{"do": "hold", "tension_N": {"index": 60}, "rate_N_per_s": 1000}')
    hand.run(0.5)
    assert hand.tick(extra=(foreign_command(hand),)).mode == HandMode.RELAX
    assert hand.tick(io=(IoEvent("bus_off", "local:x"),)).mode == HandMode.CUT
    hand.until(HandMode.DONE)
    assert "H13" in hand.state.failure, "what began it"


def test_relax_lowers_the_tension_slowly_and_ends_in_time(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.run(2.0)
    hand.tick('{"do": "hold", "tension_N": {"index": 60, "thumb": 50}, "rate_N_per_s": 1000}')
    hand.run(1.0)
    held = hand.peer.tension.copy()
    assert held[0] > 55.0
    hand.tick(STOP)
    while hand.state.mode == HandMode.RELAX:
        hand.tick()
    assert 0.05 < duration_in(hand, HandMode.RELAX) < 0.5, "500 N/s from 60 N"
    goals = np.array(
        [out.telemetry.tension_goal for _, _, out in hand.history if out.mode == HandMode.RELAX]
    )
    assert (np.diff(goals, axis=0) <= 1e-9).all(), "no tension rises"
    assert np.abs(np.diff(goals, axis=0)).max() <= 500.0 * hand.controller.model.period + 1e-9
    assert (goals[-1] <= 5.0 + 500.0 * hand.controller.model.period + 1e-6).all()


def test_a_program_that_fails_relaxes_the_hand_and_gives_a_reason(quick: HandModel) -> None:
    run = bench(quick, LiveProgram())
    run.peer.tear(1)  # the load cell of a torn tendon reads zero
    run.until(HandMode.DONE, 20.0)
    assert run.state.failure == "not taut after 4 s: middle_tendon"
    assert run.modes == HAPPY + HOME


def test_clear_resets_latched_faults_and_arms_no_drive(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.tick(extra=(foreign_command(hand),))
    assert hand.state.latched
    hand.tick('{"do": "clear"}')
    assert not hand.state.latched
    hand.until(HandMode.DONE)
    assert hand.modes == HAPPY + HOME


def test_every_mode_change_is_reported_once(hand: Bench) -> None:
    hand.until(HandMode.ACTIVE)
    hand.tick(STOP)
    hand.until(HandMode.DONE)
    mode_changes = [event.text.partition(":")[0] for event in hand.events if event.name == "mode"]
    assert mode_changes == [
        f"{a.name} -> {b.name}" for a, b in zip(hand.modes, hand.modes[1:], strict=False)
    ]


def test_the_time_of_a_program_stops_during_a_hold_by_safety(
    hand: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    hand.until(HandMode.ACTIVE)
    hand.run(1.0)
    before = hand.state
    real = Controller._judge_faults
    monkeypatch.setattr(
        Controller, "_judge_faults", lambda self, *words: (SafetyAction.HOLD, real(self, *words)[1])
    )
    hand.run(0.5)
    assert hand.state.mode == HandMode.ACTIVE
    assert hand.state.goal_time == before.goal_time
    assert hand.state.progress == before.progress
    monkeypatch.undo()
    hand.tick()
    assert hand.state.goal_time > before.goal_time
