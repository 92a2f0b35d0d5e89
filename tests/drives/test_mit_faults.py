"""Test faults of a motor and its power supply, and faults that a second controller causes.

A motor counts as disabled only when it has confirmed that it is disabled.
"""

import pytest

from handctl.drives.contract import DrivePhase, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.mit.progress import (
    DROPPED_OUT_ERROR,
    ENABLED_BY_OTHER_HOST_ERROR,
    UNKNOWN_STATUS_ERROR,
)
from handctl.drives.state_machine import SILENCE_TIMEOUT_NS
from tests.drives.conftest import PERIOD_NS, MotorRig

DISABLE_PAYLOAD = b"\xff" * 7 + b"\xfd"


def test_a_lost_answer_to_enable_does_not_count_as_disabled(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    rig.tick(DriveTarget.ENABLE)
    rig.pending_replies.clear()
    rig.motor.is_silent = True
    assert rig.motor.state_nibble == 1
    for _ in range(20):
        assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.ENABLED
    rig.motor.is_silent = False
    assert rig.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY, max_ticks=3)
    assert rig.motor.state_nibble == 0


def test_an_answer_from_before_the_order_confirms_nothing(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.is_silent = True
    rig.tick(DriveTarget.DISABLE)
    frame_before_command = Frame(
        0x11, bytes([0x01, 0x80, 0, 0x80, 0x08, 0, 30, 30]), 0, 0, rig.t_ns - PERIOD_NS - 1
    )
    rig.state = rig.drive.receive(rig.state, frame_before_command)
    assert rig.state.phase == DrivePhase.ENABLED


def test_a_motor_that_disables_itself_is_at_fault_and_is_not_enabled_again(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.state_nibble = 0
    state = rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT)
    assert (state.error, state.error_text) == (DROPPED_OUT_ERROR, "disabled by itself")
    for _ in range(20):
        rig.tick(DriveTarget.ENABLE)
    assert rig.motor.state_nibble == 0


def test_a_motor_enabled_by_another_host_is_in_fault(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    rig.motor.state_nibble = 1
    state = rig.run_until_phase(DriveTarget.POLL, DrivePhase.FAULT)
    assert state.error == ENABLED_BY_OTHER_HOST_ERROR
    assert rig.sent_frames[-1].data == DISABLE_PAYLOAD
    assert rig.motor.state_nibble == 0
    for target in (DriveTarget.POLL, DriveTarget.ENABLE, DriveTarget.DISABLE):
        assert rig.tick(target).error == ENABLED_BY_OTHER_HOST_ERROR
        assert rig.state.phase == DrivePhase.FAULT


def test_a_motor_enabled_by_another_host_does_not_count_as_disabled(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    rig.motor.state_nibble = 1
    rig.motor.ignored_commands.add(0xFD)
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.FAULT)
    for _ in range(5):
        assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.ENABLED
    rig.motor.ignored_commands.clear()
    rig.run_until_phase(DriveTarget.DISABLE, DrivePhase.FAULT, max_ticks=3)
    assert rig.motor.state_nibble == 0


@pytest.mark.parametrize(
    ("state_nibble", "error_text"),
    [
        (0x8, "over-voltage"),
        (0xD, "communication lost: the drive's watchdog fired"),
        (0xE, "overload"),
    ],
)
def test_an_error_of_the_motor_is_reported_and_stays(
    rig: MotorRig, state_nibble: int, error_text: str
) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.state_nibble = state_nibble
    state = rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT)
    assert (state.error, state.error_text) == (state_nibble, error_text)
    rig.motor.state_nibble = 0
    for _ in range(5):
        assert rig.tick(DriveTarget.ENABLE).phase == DrivePhase.FAULT
    assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.FAULT


@pytest.mark.parametrize("state_nibble", [2, 3, 4, 7, 15])
def test_an_unknown_state_is_a_fault_and_never_counts_as_disabled(
    rig: MotorRig, state_nibble: int
) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.state_nibble = state_nibble
    state = rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT)
    assert (state.error, state.error_text) == (
        UNKNOWN_STATUS_ERROR,
        f"unknown state {state_nibble:#x}",
    )
    for _ in range(20):
        assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.ENABLED
        assert rig.sent_frames[-1].data == DISABLE_PAYLOAD
        assert [rig.drive.receive(rig.state, frame).phase for frame in rig.pending_replies] == [
            DrivePhase.ENABLED
        ]


def test_clear_ignores_earlier_replies_and_starts_again(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.state_nibble = 0xA
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT)
    stale_frame = rig.pending_replies
    rig.state, frames = rig.drive.clear(rig.state)
    assert [frame.data for frame in frames] == [b"\xff" * 7 + b"\xfb"]
    rig.pending_replies = stale_frame + [
        reply for frame in frames for reply in rig.motor.answer_frame(frame, rig.t_ns)
    ]
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert rig.state.error == 0
    assert rig.motor.state_nibble == 0


def test_an_error_that_cannot_be_cleared_comes_back(rig: MotorRig) -> None:
    rig.motor.state_nibble = 0x9
    rig.motor.ignored_commands.add(0xFB)
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.FAULT)
    rig.state, _ = rig.drive.clear(rig.state)
    assert rig.run_until_phase(DriveTarget.POLL, DrivePhase.FAULT, max_ticks=10).error == 0x9


def test_a_motor_that_was_without_power_is_configured_again(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    rig.motor.is_silent = True
    rig.run_until_phase(
        DriveTarget.POLL, DrivePhase.SILENT, max_ticks=2 + SILENCE_TIMEOUT_NS // PERIOD_NS
    )
    rig.motor.is_silent = False
    rig.motor.registers[23] = 10.0
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert rig.motor.registers[23] == pytest.approx(0.8)


def test_an_unrequested_register_reply_changes_nothing(rig: MotorRig) -> None:
    register_reply = Frame(0x11, bytes([1, 0, 0x33, 10, 1, 0, 0, 0]), 0, 0, rig.t_ns)
    feedback = Frame(0x11, rig.motor.feedback_bytes(), 0, 0, rig.t_ns)
    rig.state = rig.drive.receive(rig.state, feedback)
    assert rig.state.phase == DrivePhase.CONFIGURING
    assert rig.drive.receive(rig.state, register_reply).protocol_state == rig.state.protocol_state


def test_a_motor_that_is_silent_after_the_enable_command_counts_as_enabled(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    rig.motor.is_silent = True
    for _ in range(2 * SILENCE_TIMEOUT_NS // PERIOD_NS):
        rig.tick(DriveTarget.ENABLE)
    assert rig.motor.state_nibble == 1
    assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.ENABLED


def test_an_old_reply_after_enable_does_not_cancel_the_command(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    old_reply = Frame(0x11, rig.motor.feedback_bytes(), 0, 0, rig.t_ns - 1)
    rig.tick(DriveTarget.ENABLE)
    rig.pending_replies = [old_reply]
    assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.ENABLED


def test_an_error_soon_after_clearing_is_reported_at_once(rig: MotorRig) -> None:
    rig.state, _ = rig.drive.clear(rig.state)
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.state_nibble = 0xA
    rig.tick(DriveTarget.ENABLE)
    assert rig.tick(DriveTarget.ENABLE).phase == DrivePhase.FAULT


def test_a_fault_is_not_forgotten_because_the_motor_is_enabled_again(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.state_nibble = 4
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT)
    rig.motor.state_nibble = 1
    rig.motor.ignored_commands.add(0xFD)
    torques = len(rig.motor.torque_codes)
    for _ in range(5):
        assert rig.tick(DriveTarget.ENABLE, 0.4).phase == DrivePhase.FAULT
    assert len(rig.motor.torque_codes) == torques


def test_a_motor_at_fault_that_turns_out_to_be_enabled_does_not_count_as_disabled(
    rig: MotorRig,
) -> None:
    rig.motor.registers[23] = 7
    rig.motor.fixed_registers.add(23)
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.FAULT)
    rig.motor.ignored_commands.add(0xFD)
    rig.tick(DriveTarget.DISABLE)
    rig.motor.state_nibble = 1
    rig.tick(DriveTarget.DISABLE)
    assert [rig.drive.receive(rig.state, frame).phase for frame in rig.pending_replies] == [
        DrivePhase.ENABLED
    ]
