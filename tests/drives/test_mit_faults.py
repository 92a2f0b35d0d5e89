"""What a motor, its power and a second controller can do to a drive's state; nothing unconfirmed counts as disabled."""

import pytest

from handctl.drives.contract import Phase, Want
from handctl.drives.frame import Frame
from handctl.drives.mit.progress import DROPPED_OUT, ENABLED_BY_OTHERS, GONE_NS, UNKNOWN
from tests.drives.conftest import PERIOD_NS, Walk

DISABLE = b"\xff" * 7 + b"\xfd"


def test_a_lost_answer_to_enable_does_not_count_as_disabled(walk: Walk) -> None:
    walk.until(Want.POLL, Phase.READY)
    walk.tick(Want.ENABLE)
    walk.pending.clear()
    walk.motor.silent = True
    assert walk.motor.nibble == 1
    for _ in range(20):
        assert walk.tick(Want.DISABLE).phase == Phase.ENABLED
    walk.motor.silent = False
    assert walk.until(Want.DISABLE, Phase.READY, ticks=3)
    assert walk.motor.nibble == 0


def test_an_answer_from_before_the_order_confirms_nothing(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.silent = True
    walk.tick(Want.DISABLE)
    old = Frame(0x11, bytes([0x01, 0x80, 0, 0x80, 0x08, 0, 30, 30]), 0, 0, walk.t_ns - PERIOD_NS - 1)
    walk.state = walk.drive.receive(walk.state, old)
    assert walk.state.phase == Phase.ENABLED


def test_a_motor_that_disables_itself_is_at_fault_and_is_not_enabled_again(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.nibble = 0
    state = walk.until(Want.ENABLE, Phase.FAULT)
    assert (state.error, state.error_text) == (DROPPED_OUT, "disabled by itself")
    for _ in range(20):
        walk.tick(Want.ENABLE)
    assert walk.motor.nibble == 0


def test_a_motor_that_somebody_else_enables_is_at_fault(walk: Walk) -> None:
    walk.until(Want.POLL, Phase.READY)
    walk.motor.nibble = 1
    state = walk.until(Want.POLL, Phase.FAULT)
    assert state.error == ENABLED_BY_OTHERS
    assert walk.sent[-1].data == DISABLE
    assert walk.motor.nibble == 0
    for want in (Want.POLL, Want.ENABLE, Want.DISABLE):
        assert walk.tick(want).error == ENABLED_BY_OTHERS
        assert walk.state.phase == Phase.FAULT


def test_a_motor_that_somebody_else_enables_does_not_count_as_disabled(walk: Walk) -> None:
    walk.until(Want.POLL, Phase.READY)
    walk.motor.nibble = 1
    walk.motor.deaf.add(0xFD)
    walk.until(Want.POLL, Phase.FAULT)
    for _ in range(5):
        assert walk.tick(Want.DISABLE).phase == Phase.ENABLED
    walk.motor.deaf.clear()
    walk.until(Want.DISABLE, Phase.FAULT, ticks=3)
    assert walk.motor.nibble == 0


@pytest.mark.parametrize(
    ("nibble", "text"),
    [(0x8, "over-voltage"), (0xD, "communication lost: the drive's watchdog fired"), (0xE, "overload")],
)
def test_an_error_of_the_motor_is_told_and_stays(walk: Walk, nibble: int, text: str) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.nibble = nibble
    state = walk.until(Want.ENABLE, Phase.FAULT)
    assert (state.error, state.error_text) == (nibble, text)
    walk.motor.nibble = 0
    for _ in range(5):
        assert walk.tick(Want.ENABLE).phase == Phase.FAULT
    assert walk.tick(Want.DISABLE).phase == Phase.FAULT


@pytest.mark.parametrize("nibble", [2, 3, 4, 7, 15])
def test_a_state_that_nobody_knows_is_a_fault_that_never_counts_as_disabled(walk: Walk, nibble: int) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.nibble = nibble
    state = walk.until(Want.ENABLE, Phase.FAULT)
    assert (state.error, state.error_text) == (UNKNOWN, f"unknown state {nibble:#x}")
    for _ in range(20):
        assert walk.tick(Want.DISABLE).phase == Phase.ENABLED
        assert walk.sent[-1].data == DISABLE
        assert [walk.drive.receive(walk.state, frame).phase for frame in walk.pending] == [Phase.ENABLED]


def test_clearing_forgives_answers_from_before_and_begins_again(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.nibble = 0xA
    walk.until(Want.ENABLE, Phase.FAULT)
    stale = walk.pending
    walk.state, frames = walk.drive.clear(walk.state)
    assert [frame.data for frame in frames] == [b"\xff" * 7 + b"\xfb"]
    walk.pending = stale + [reply for frame in frames for reply in walk.motor.answer(frame, walk.t_ns)]
    walk.until(Want.POLL, Phase.READY)
    assert walk.state.error == 0
    assert walk.motor.nibble == 0


def test_an_error_that_cannot_be_cleared_comes_back(walk: Walk) -> None:
    walk.motor.nibble = 0x9
    walk.motor.deaf.add(0xFB)
    walk.until(Want.POLL, Phase.FAULT)
    walk.state, _ = walk.drive.clear(walk.state)
    assert walk.until(Want.POLL, Phase.FAULT, ticks=10).error == 0x9


def test_a_motor_that_was_without_power_is_configured_again(walk: Walk) -> None:
    walk.until(Want.POLL, Phase.READY)
    walk.motor.silent = True
    walk.until(Want.POLL, Phase.SILENT, ticks=2 + GONE_NS // PERIOD_NS)
    walk.motor.silent = False
    walk.motor.registers[23] = 10.0
    walk.until(Want.POLL, Phase.READY)
    assert walk.motor.registers[23] == pytest.approx(0.8)


def test_a_register_reply_that_nobody_asked_for_changes_nothing(walk: Walk) -> None:
    right = Frame(0x11, bytes([1, 0, 0x33, 10, 1, 0, 0, 0]), 0, 0, walk.t_ns)
    feedback = Frame(0x11, walk.motor.feedback(), 0, 0, walk.t_ns)
    walk.state = walk.drive.receive(walk.state, feedback)
    assert walk.state.phase == Phase.CONFIGURING
    assert walk.drive.receive(walk.state, right).private == walk.state.private


def test_a_motor_that_was_told_to_enable_and_falls_silent_is_not_forgotten(walk: Walk) -> None:
    walk.until(Want.POLL, Phase.READY)
    walk.motor.silent = True
    for _ in range(2 * GONE_NS // PERIOD_NS):
        walk.tick(Want.ENABLE)
    assert walk.motor.nibble == 1
    assert walk.tick(Want.DISABLE).phase == Phase.ENABLED


def test_an_old_answer_after_enable_does_not_take_the_order_back(walk: Walk) -> None:
    walk.until(Want.POLL, Phase.READY)
    old = Frame(0x11, walk.motor.feedback(), 0, 0, walk.t_ns - 1)
    walk.tick(Want.ENABLE)
    walk.pending = [old]
    assert walk.tick(Want.DISABLE).phase == Phase.ENABLED


def test_an_error_soon_after_clearing_is_told_at_once(walk: Walk) -> None:
    walk.state, _ = walk.drive.clear(walk.state)
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.nibble = 0xA
    walk.tick(Want.ENABLE)
    assert walk.tick(Want.ENABLE).phase == Phase.FAULT


def test_a_fault_is_not_forgotten_because_the_motor_is_enabled_again(walk: Walk) -> None:
    walk.until(Want.ENABLE, Phase.ENABLED)
    walk.motor.nibble = 4
    walk.until(Want.ENABLE, Phase.FAULT)
    walk.motor.nibble = 1
    walk.motor.deaf.add(0xFD)
    torques = len(walk.motor.torques)
    for _ in range(5):
        assert walk.tick(Want.ENABLE, 0.4).phase == Phase.FAULT
    assert len(walk.motor.torques) == torques


def test_a_motor_at_fault_that_turns_out_to_be_enabled_does_not_count_as_disabled(walk: Walk) -> None:
    walk.motor.registers[23] = 7
    walk.motor.stuck.add(23)
    walk.until(Want.POLL, Phase.FAULT)
    walk.motor.deaf.add(0xFD)
    walk.tick(Want.DISABLE)
    walk.motor.nibble = 1
    walk.tick(Want.DISABLE)
    assert [walk.drive.receive(walk.state, frame).phase for frame in walk.pending] == [Phase.ENABLED]
