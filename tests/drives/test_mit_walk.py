"""A motor's way from silence by its registers to torque and back."""

import math

import pytest

from handctl.drives.contract import DriveState, Phase, Want
from handctl.drives.frame import Frame
from handctl.drives.mit.progress import DROPPED_OUT, GONE_NS, MISMATCH, Progress
from tests.drives.conftest import Walk, drive_of

ENABLE = b"\xff" * 7 + b"\xfc"
DISABLE = b"\xff" * 7 + b"\xfd"
HALF_TORQUE = 3071
"""Code of 0.4 N m when TMAX is 0.8: (0.4 + 0.8) * 4095 / 1.6 = 3071.25."""


def test_the_whole_way(walk: Walk) -> None:
    assert walk.tick(Want.LISTEN).phase == Phase.SILENT
    assert walk.sent == []
    walk.until(Want.POLL, Phase.READY)
    assert walk.motor.registers[9] == 1000  # 50 ms in units of 50 us
    assert walk.motor.nibble == 0
    assert all(frame.can_id == 0x7FF for frame in walk.sent)
    walk.until(Want.ENABLE, Phase.ENABLED)
    for _ in range(5):
        walk.tick(Want.ENABLE, 0.4)
    assert set(walk.motor.torques[1:]) == {HALF_TORQUE}
    assert walk.tick(Want.DISABLE).phase == Phase.ENABLED
    assert walk.tick(Want.DISABLE).phase == Phase.READY
    assert walk.motor.nibble == 0


def test_right_registers_are_not_written(walk: Walk) -> None:
    walk.motor.registers[9] = 1000
    walk.until(Want.POLL, Phase.READY)
    assert walk.motor.written == []


@pytest.mark.parametrize("register", [9, 10, 21, 22, 23])
def test_a_wrong_register_is_written_once_and_read_back(walk: Walk, register: int) -> None:
    walk.motor.registers[9] = 1000
    right = walk.motor.registers[register]
    walk.motor.registers[register] = 3
    walk.until(Want.POLL, Phase.READY)
    assert walk.motor.written == [register]
    assert walk.motor.registers[register] == pytest.approx(right, rel=1e-6)


@pytest.mark.parametrize(("register", "name"), [(10, "CTRL_MODE"), (21, "PMAX"), (23, "TMAX"), (9, "TIMEOUT")])
def test_a_register_that_does_not_keep_its_value_is_named(walk: Walk, register: int, name: str) -> None:
    walk.motor.registers[register] = 7
    walk.motor.stuck.add(register)
    state = walk.until(Want.ENABLE, Phase.FAULT)
    assert state.error == MISMATCH
    assert f"register {register} {name} reads 7 after writing, expected" in state.error_text
    for _ in range(50):
        walk.tick(Want.ENABLE)
    assert walk.motor.nibble == 0
    assert ENABLE not in [frame.data for frame in walk.sent]


def test_a_register_that_is_not_answered_is_named(walk: Walk) -> None:
    walk.motor.mute.add(23)
    state = walk.until(Want.POLL, Phase.FAULT)
    assert "register 23 TMAX is not answered" in state.error_text


def test_values_are_unknown_until_the_ranges_are(walk: Walk) -> None:
    walk.motor.registers[21] = 4.0
    walk.motor.codes = (0xFFFF, 0xFFF, 0xFFF)
    while walk.tick(Want.POLL).phase != Phase.READY:
        assert math.isnan(walk.state.position)
        assert math.isnan(walk.state.velocity)
        assert math.isnan(walk.state.torque)
    walk.tick(Want.POLL)
    walk.tick(Want.POLL)
    assert walk.state.position == pytest.approx(12.5)
    assert walk.state.torque == pytest.approx(0.8)


def test_a_motor_that_is_enabled_at_the_start_is_disabled_before_anything_else(walk: Walk) -> None:
    walk.motor.nibble = 1
    walk.until(Want.POLL, Phase.READY)
    assert [frame.data for frame in walk.sent[:2]] == [bytes([1, 0, 0xCC, 0, 0, 0, 0, 0]), DISABLE]
    assert walk.motor.torques == []
    assert walk.state.error_text == ""


def test_a_motor_that_does_not_disable_at_the_start_never_becomes_ready(walk: Walk) -> None:
    walk.motor.nibble = 1
    walk.motor.deaf.add(0xFD)
    for _ in range(200):
        assert walk.tick(Want.ENABLE).phase in (Phase.SILENT, Phase.CONFIGURING)
    assert walk.state.error_text == "enabled, and does not disable"
    assert walk.motor.written == []
    assert walk.tick(Want.DISABLE).phase == Phase.ENABLED


def test_an_enabled_motor_that_is_only_to_be_polled_is_disabled(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.tick(Want.POLL, 0.4)
    assert walk.sent[-1].data == DISABLE
    walk.until(Want.POLL, Phase.READY)
    assert walk.motor.nibble == 0


def test_late_register_replies_are_not_feedback(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    late = Frame(0x11, bytes([1, 0, 0x33, 23, 0, 0, 0x80, 0x3F]), 0, 0, walk.t_ns)
    after = walk.drive.receive(walk.state, late)
    assert after.phase == Phase.ENABLED
    assert after.feedback_count == walk.state.feedback_count


def test_a_reply_that_comes_twice_does_not_answer_the_next_request(walk: Walk) -> None:
    walk.motor.registers[9] = 1000
    while walk.state.phase != Phase.READY:
        walk.pending = [reply for reply in walk.pending for _ in range(2)]
        walk.tick(Want.POLL)
    assert walk.motor.written == []
    assert len([frame for frame in walk.sent if frame.data[2] == 0x33]) == 6


def test_short_replies_and_those_of_another_motor_are_counted_and_not_read(walk: Walk) -> None:
    short, other = Frame(0x11, b"\x01" + bytes(5), t_ns=5), Frame(0x11, b"\x12" + bytes(7), t_ns=5)
    for frame in (short, other):
        walk.state = walk.drive.receive(walk.state, frame)
    assert walk.state.misread == 2
    assert (walk.state.phase, walk.state.feedback_count) == (Phase.SILENT, 0)


def test_an_open_request_is_repeated_only_after_its_time(walk: Walk) -> None:
    walk.motor.mute.add(10)
    for _ in range(50):
        walk.tick(Want.POLL)
    asked = [frame for frame in walk.sent if frame.data[2:4] == bytes([0x33, 10])]
    assert len(asked) == 5, "100 ms, one request in 20 ms"


def test_a_motor_that_took_long_to_configure_is_not_taken_for_gone(walk: Walk) -> None:
    walk.motor.mute.update((9, 10, 21, 22, 23))
    for register in (10, 21, 22, 23, 9):
        for _ in range(35):
            walk.tick(Want.POLL)
        walk.motor.mute.discard(register)
    walk.until(Want.POLL, Phase.READY)
    assert walk.t_ns > GONE_NS
    refreshes = [frame for frame in walk.sent[1:-1] if frame.data[2] == 0xCC]
    assert refreshes == [], "it began again"
    for _ in range(5):
        assert walk.tick(Want.POLL).phase == Phase.READY


def test_a_motor_may_be_enabled_again_and_is_watched_again(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.until(Want.DISABLE, Phase.READY)
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.tick(Want.ENABLE, 0.4)
    assert walk.motor.torques[-1] == HALF_TORQUE
    walk.motor.nibble = 0
    assert walk.until(Want.ENABLE, Phase.FAULT).error == DROPPED_OUT


def test_once_told_to_disable_a_motor_gets_no_torque_before_it_has_confirmed(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.silent = True
    walk.tick(Want.POLL)
    for _ in range(5):
        walk.tick(Want.ENABLE, 0.4)
        assert walk.sent[-1].data == DISABLE
    walk.motor.silent = False
    walk.until(Want.ENABLE, Phase.ENABLED)


def test_disabling_a_motor_that_is_not_configured_does_not_make_it_ready_to_arm(walk: Walk) -> None:
    walk.motor.registers[23] = 10.0
    walk.until(Want.DISABLE, Phase.CONFIGURING, Phase.READY)
    walk.tick(Want.ENABLE)
    assert walk.sent[-1].data[2] == 0x33
    walk.until(Want.ENABLE, Phase.ENABLED)
    assert walk.motor.registers[23] == pytest.approx(0.8)


def test_a_motor_whose_number_looks_like_a_state_is_read_near_the_end_of_its_range() -> None:
    drive = drive_of(node_id=0x11)
    state = DriveState(phase=Phase.ENABLED, private=Progress(configured=True, asked=True))
    seen = drive.receive(state, Frame(0x21, bytes([0x11, 0x00, 0x33, 0x80, 0x08, 0, 30, 30])))
    assert seen.feedback_count == 1
    assert seen.position == pytest.approx(-12.5 + 25 * 0x33 / 65535)


def test_what_comes_on_another_bus_is_not_heard(walk: Walk) -> None:
    assert walk.drive.receive(walk.state, Frame(0x11, walk.motor.feedback(), bus=1)) is walk.state
