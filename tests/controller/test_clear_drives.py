"""Test the first run after a controller has died and the watchdogs of its drives have latched a fault.

Drives with latched watchdog faults stay disabled until the operator sends a request to clear the
faults.
"""

import pytest

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from tests.controller.controller_bench import ControllerBench, make_controller_bench

COMMUNICATION_LOST_STATE = 0xD
CLEAR_REQUEST = '{"do": "clear"}'


@pytest.fixture
def hand_after_crash() -> ControllerBench:
    """Return a test bench with a hand that was armed when an earlier controller of the hand died."""
    run = make_controller_bench(
        HandModel.from_hand(load_hand("jamia"), Gains(), 200.0), LiveProgram()
    )
    for motor in run.toy_hand.motors:
        motor.state_nibble = COMMUNICATION_LOST_STATE
    return run


def test_without_an_order_the_hand_is_refused_and_the_line_says_what_to_do(
    hand_after_crash: ControllerBench,
) -> None:
    hand_after_crash.run_until_mode(HandMode.DONE)
    assert HandMode.ARMING not in hand_after_crash.mode_history
    assert "communication lost" in hand_after_crash.state.failure
    assert "--clear" in hand_after_crash.state.failure
    assert [motor.state_nibble for motor in hand_after_crash.toy_hand.motors] == [
        COMMUNICATION_LOST_STATE
    ] * 4


def test_with_the_order_the_drives_are_cleared_configured_and_armed(
    hand_after_crash: ControllerBench,
) -> None:
    hand_after_crash.tick(CLEAR_REQUEST)
    hand_after_crash.run_until_mode(HandMode.ACTIVE)
    assert hand_after_crash.mode_history == [
        HandMode.SILENT,
        HandMode.INVENTORY,
        HandMode.READY,
        HandMode.ARMING,
        HandMode.ACTIVE,
    ]
    assert hand_after_crash.state.failure == ""


def test_clear_before_arming_does_not_clear_later_errors(hand_after_crash: ControllerBench) -> None:
    hand_after_crash.tick(CLEAR_REQUEST)
    hand_after_crash.run_until_mode(HandMode.ACTIVE)
    hand_after_crash.run(0.5)
    hand_after_crash.toy_hand.motors[1].state_nibble = COMMUNICATION_LOST_STATE
    hand_after_crash.run_until_mode(HandMode.DONE)
    assert "N08" in hand_after_crash.state.failure
    assert hand_after_crash.toy_hand.motors[1].state_nibble == COMMUNICATION_LOST_STATE


def test_a_drive_that_does_not_clear_is_refused_in_time(hand_after_crash: ControllerBench) -> None:
    hand_after_crash.toy_hand.motors[2].ignored_commands = {0xFB}
    hand_after_crash.tick(CLEAR_REQUEST)
    hand_after_crash.run_until_mode(HandMode.DONE)
    assert (
        hand_after_crash.state.failure
        == "no answer from ring_motor (or an error that does not clear)"
    )
    assert HandMode.ARMING not in hand_after_crash.mode_history
