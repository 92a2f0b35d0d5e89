"""Test the life cycle of a motor: silence, set-up of its registers, enabling and disabling."""

import math

import pytest

from handctl.drives.contract import DrivePhase, DriveState, DriveTarget
from handctl.drives.frame import Frame
from handctl.drives.mit.progress import (
    DROPPED_OUT_ERROR,
    SETTING_MISMATCH_ERROR,
    MitProgress,
)
from handctl.drives.state_machine import SILENCE_TIMEOUT_NS
from tests.drives.conftest import MotorRig, make_mit_drive

ENABLE_PAYLOAD = b"\xff" * 7 + b"\xfc"
DISABLE_PAYLOAD = b"\xff" * 7 + b"\xfd"
HALF_TORQUE = 3071
"""Code of a torque of 0.4 N m if the register TMAX is 0.8 N m: (0.4 + 0.8) * 4095 / 1.6 = 3071.25."""


def test_motor_goes_from_silent_to_enabled_and_back_to_disabled(rig: MotorRig) -> None:
    assert rig.tick(DriveTarget.LISTEN).phase == DrivePhase.SILENT
    assert rig.sent_frames == []
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert rig.motor.registers[9] == 1000  # 50 ms in units of 50 us
    assert rig.motor.state_nibble == 0
    assert all(frame.can_id == 0x7FF for frame in rig.sent_frames)
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    for _ in range(5):
        rig.tick(DriveTarget.ENABLE, 0.4)
    assert set(rig.motor.torque_codes[1:]) == {HALF_TORQUE}
    assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.ENABLED
    assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.READY
    assert rig.motor.state_nibble == 0


def test_right_registers_are_not_written(rig: MotorRig) -> None:
    rig.motor.registers[9] = 1000
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert rig.motor.written_registers == []


@pytest.mark.parametrize("register_number", [9, 10, 21, 22, 23])
def test_a_wrong_register_is_written_once_and_read_back(
    rig: MotorRig, register_number: int
) -> None:
    rig.motor.registers[9] = 1000
    correct_value = rig.motor.registers[register_number]
    rig.motor.registers[register_number] = 3
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert rig.motor.written_registers == [register_number]
    assert rig.motor.registers[register_number] == pytest.approx(correct_value, rel=1e-6)


@pytest.mark.parametrize(
    ("register_number", "register_name"),
    [(10, "CTRL_MODE"), (21, "PMAX"), (23, "TMAX"), (9, "TIMEOUT")],
)
def test_a_register_that_does_not_keep_its_value_is_named(
    rig: MotorRig, register_number: int, register_name: str
) -> None:
    rig.motor.registers[register_number] = 7
    rig.motor.fixed_registers.add(register_number)
    state = rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT)
    assert state.error == SETTING_MISMATCH_ERROR
    assert (
        f"register {register_number} {register_name} reads 7 after writing, expected"
        in state.error_text
    )
    for _ in range(50):
        rig.tick(DriveTarget.ENABLE)
    assert rig.motor.state_nibble == 0
    assert ENABLE_PAYLOAD not in [frame.data for frame in rig.sent_frames]


def test_a_register_that_is_not_answered_is_named(rig: MotorRig) -> None:
    rig.motor.unanswered_registers.add(23)
    state = rig.run_until_phase(DriveTarget.POLL, DrivePhase.FAULT)
    assert "register 23 TMAX is not answered" in state.error_text


def test_values_are_unknown_until_the_ranges_are(rig: MotorRig) -> None:
    rig.motor.registers[21] = 4.0
    rig.motor.feedback_codes = (0xFFFF, 0xFFF, 0xFFF)
    while rig.tick(DriveTarget.POLL).phase != DrivePhase.READY:
        assert math.isnan(rig.state.position)
        assert math.isnan(rig.state.velocity)
        assert math.isnan(rig.state.torque)
    rig.tick(DriveTarget.POLL)
    rig.tick(DriveTarget.POLL)
    assert rig.state.position == pytest.approx(12.5)
    assert rig.state.torque == pytest.approx(0.8)


def test_a_motor_that_is_enabled_at_the_start_is_disabled_before_anything_else(
    rig: MotorRig,
) -> None:
    rig.motor.state_nibble = 1
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert [frame.data for frame in rig.sent_frames[:2]] == [
        bytes([1, 0, 0xCC, 0, 0, 0, 0, 0]),
        DISABLE_PAYLOAD,
    ]
    assert rig.motor.torque_codes == []
    assert rig.state.error_text == ""


def test_a_motor_that_does_not_disable_at_the_start_never_becomes_ready(rig: MotorRig) -> None:
    rig.motor.state_nibble = 1
    rig.motor.ignored_commands.add(0xFD)
    for _ in range(200):
        assert rig.tick(DriveTarget.ENABLE).phase in (DrivePhase.SILENT, DrivePhase.CONFIGURING)
    assert rig.state.error_text == "enabled, and does not disable"
    assert rig.motor.written_registers == []
    assert rig.tick(DriveTarget.DISABLE).phase == DrivePhase.ENABLED


def test_an_enabled_motor_that_is_only_to_be_polled_is_disabled(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.tick(DriveTarget.POLL, 0.4)
    assert rig.sent_frames[-1].data == DISABLE_PAYLOAD
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert rig.motor.state_nibble == 0


def test_late_register_replies_are_not_feedback(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    late_frame = Frame(0x11, bytes([1, 0, 0x33, 23, 0, 0, 0x80, 0x3F]), 0, 0, rig.t_ns)
    state_after = rig.drive.receive(rig.state, late_frame)
    assert state_after.phase == DrivePhase.ENABLED
    assert state_after.feedback_count == rig.state.feedback_count


def test_a_reply_that_comes_twice_does_not_answer_the_next_request(rig: MotorRig) -> None:
    rig.motor.registers[9] = 1000
    while rig.state.phase != DrivePhase.READY:
        rig.pending_replies = [reply for reply in rig.pending_replies for _ in range(2)]
        rig.tick(DriveTarget.POLL)
    assert rig.motor.written_registers == []
    assert len([frame for frame in rig.sent_frames if frame.data[2] == 0x33]) == 6


def test_short_replies_and_those_of_another_motor_are_counted_and_not_read(rig: MotorRig) -> None:
    short_frame, other_frame = (
        Frame(0x11, b"\x01" + bytes(5), t_ns=5),
        Frame(0x11, b"\x12" + bytes(7), t_ns=5),
    )
    for frame in (short_frame, other_frame):
        rig.state = rig.drive.receive(rig.state, frame)
    assert rig.state.misread_frame_count == 2
    assert (rig.state.phase, rig.state.feedback_count) == (DrivePhase.SILENT, 0)


def test_an_open_request_is_repeated_only_after_its_timeout(rig: MotorRig) -> None:
    rig.motor.unanswered_registers.add(10)
    for _ in range(50):
        rig.tick(DriveTarget.POLL)
    requests = [frame for frame in rig.sent_frames if frame.data[2:4] == bytes([0x33, 10])]
    assert len(requests) == 5, "100 ms, one request in 20 ms"


def test_slow_configuration_is_no_timeout(rig: MotorRig) -> None:
    rig.motor.unanswered_registers.update((9, 10, 21, 22, 23))
    for register in (10, 21, 22, 23, 9):
        for _ in range(35):
            rig.tick(DriveTarget.POLL)
        rig.motor.unanswered_registers.discard(register)
    rig.run_until_phase(DriveTarget.POLL, DrivePhase.READY)
    assert rig.t_ns > SILENCE_TIMEOUT_NS
    refresh_frames = [frame for frame in rig.sent_frames[1:-1] if frame.data[2] == 0xCC]
    assert refresh_frames == [], "it began again"
    for _ in range(5):
        assert rig.tick(DriveTarget.POLL).phase == DrivePhase.READY


def test_a_motor_may_be_enabled_again_and_is_watched_again(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.run_until_phase(DriveTarget.DISABLE, DrivePhase.READY)
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.tick(DriveTarget.ENABLE, 0.4)
    assert rig.motor.torque_codes[-1] == HALF_TORQUE
    rig.motor.state_nibble = 0
    assert rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.FAULT).error == DROPPED_OUT_ERROR


def test_after_the_disable_command_a_motor_gets_no_torque_before_it_confirms(rig: MotorRig) -> None:
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    rig.motor.is_silent = True
    rig.tick(DriveTarget.POLL)
    for _ in range(5):
        rig.tick(DriveTarget.ENABLE, 0.4)
        assert rig.sent_frames[-1].data == DISABLE_PAYLOAD
    rig.motor.is_silent = False
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)


def test_disabling_a_motor_that_is_not_configured_does_not_make_it_ready_to_arm(
    rig: MotorRig,
) -> None:
    rig.motor.registers[23] = 10.0
    rig.run_until_phase(DriveTarget.DISABLE, DrivePhase.CONFIGURING, DrivePhase.READY)
    rig.tick(DriveTarget.ENABLE)
    assert rig.sent_frames[-1].data[2] == 0x33
    rig.run_until_phase(DriveTarget.ENABLE, DrivePhase.ENABLED)
    assert rig.motor.registers[23] == pytest.approx(0.8)


def test_a_motor_whose_number_looks_like_a_state_is_read_near_the_end_of_its_range() -> None:
    drive = make_mit_drive(node_id=0x11)
    state = DriveState(
        phase=DrivePhase.ENABLED,
        protocol_state=MitProgress(is_configured=True, is_enable_sent=True),
    )
    frames = drive.receive(state, Frame(0x21, bytes([0x11, 0x00, 0x33, 0x80, 0x08, 0, 30, 30])))
    assert frames.feedback_count == 1
    assert frames.position == pytest.approx(-12.5 + 25 * 0x33 / 65535)


def test_frames_of_another_bus_are_ignored(rig: MotorRig) -> None:
    assert rig.drive.receive(rig.state, Frame(0x11, rig.motor.feedback_bytes(), bus=1)) is rig.state
