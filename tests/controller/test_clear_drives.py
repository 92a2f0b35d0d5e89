"""A controller has died, and the watchdogs of the drives have latched.

Only a request of the operator enables the drives again.
"""

import pytest

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.programs.live_session import LiveProgram
from tests.controller.bench import Bench, bench

COMMUNICATION_LOST = 0xD
CLEAR = '{"do": "clear"}'


@pytest.fixture
def hand_after_crash() -> Bench:
    """Return a bench whose hand was armed when its previous controller died."""
    run = bench(HandModel.from_hand(load_hand("jamia"), Gains(), 200.0), LiveProgram())
    for motor in run.peer.motors:
        motor.nibble = COMMUNICATION_LOST
    return run


def test_without_an_order_the_hand_is_refused_and_the_line_says_what_to_do(
    hand_after_crash: Bench,
) -> None:
    hand_after_crash.until(HandMode.DONE)
    assert HandMode.ARMING not in hand_after_crash.modes
    assert "communication lost" in hand_after_crash.state.failure
    assert "--clear" in hand_after_crash.state.failure
    assert [motor.nibble for motor in hand_after_crash.peer.motors] == [COMMUNICATION_LOST] * 4


def test_with_the_order_the_drives_are_cleared_configured_and_armed(
    hand_after_crash: Bench,
) -> None:
    hand_after_crash.tick(CLEAR)
    hand_after_crash.until(HandMode.ACTIVE)
    assert hand_after_crash.modes == [
        HandMode.SILENT,
        HandMode.INVENTORY,
        HandMode.READY,
        HandMode.ARMING,
        HandMode.ACTIVE,
    ]
    assert hand_after_crash.state.failure == ""


def test_clear_before_arming_does_not_clear_later_errors(hand_after_crash: Bench) -> None:
    hand_after_crash.tick(CLEAR)
    hand_after_crash.until(HandMode.ACTIVE)
    hand_after_crash.run(0.5)
    hand_after_crash.peer.motors[1].nibble = COMMUNICATION_LOST
    hand_after_crash.until(HandMode.DONE)
    assert "N08" in hand_after_crash.state.failure
    assert hand_after_crash.peer.motors[1].nibble == COMMUNICATION_LOST


def test_a_drive_that_does_not_clear_is_refused_in_time(hand_after_crash: Bench) -> None:
    hand_after_crash.peer.motors[2].deaf = {0xFB}
    hand_after_crash.tick(CLEAR)
    hand_after_crash.until(HandMode.DONE)
    assert (
        hand_after_crash.state.failure
        == "no answer from ring_motor (or an error that does not clear)"
    )
    assert HandMode.ARMING not in hand_after_crash.modes
