"""Test the beginning of a run, in which the controller finds and configures all drives.

The controller waits until every drive and every load cell has replied with a first reading.
"""

import math

import pytest

from handctl.controller.controller_state import ControllerState
from handctl.controller.hand_modes import INVENTORY_TIMEOUT_S, OperatorRequests, next_mode
from handctl.core import state_block as s
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.drives.contract import DrivePhase
from handctl.drives.frame import Frame
from handctl.programs.live_session import LiveProgram
from handctl.safety.safety_action import SafetyAction
from tests.controller.controller_bench import ControllerBench, make_controller_bench

READ_REGISTER, WRITE_REGISTER = 0x33, 0x55
"""Third byte of a drive's reply to the reading and to the writing of a register."""


@pytest.fixture
def hand_bench(jamia: HandModel) -> ControllerBench:
    return make_controller_bench(jamia, LiveProgram())


def test_motors_that_reply_in_alternate_ticks_are_armed(hand_bench: ControllerBench) -> None:
    """In this test, some drives reply only in every fourth tick.

    The filter starts as soon as each drive has reported its position once.
    """
    motors = range(0x11, 0x15)

    def replies_in_this_tick(frame: Frame) -> bool:
        return (
            frame.can_id not in motors
            or frame.can_id == motors[hand_bench.k % 4]
            or frame.data[2] in (READ_REGISTER, WRITE_REGISTER)
        )

    hand_bench.modify_frames_to_host = lambda frames: [
        frame for frame in frames if replies_in_this_tick(frame)
    ]
    hand_bench.run_until_mode(HandMode.READY)
    assert hand_bench.state.failure == ""
    hand_bench.modify_frames_to_host = lambda frames: frames
    hand_bench.run_until_mode(HandMode.ACTIVE)


def test_the_inventory_waits_for_load_cells_that_reply_in_alternate_ticks(
    jamia11: HandModel,
) -> None:
    run = make_controller_bench(jamia11, LiveProgram())
    first_id, *other_ids = run.controller.sensors.ids[: run.controller.sensors.tension_frames]
    run.modify_frames_to_host = lambda frames: [
        frame for frame in frames if frame.can_id not in other_ids
    ]
    run.run_until_mode(HandMode.INVENTORY)
    run.run(0.5)
    assert not run.state.has_started
    run.modify_frames_to_host = lambda frames: [
        frame for frame in frames if frame.can_id != first_id
    ]
    run.tick()
    run.tick()
    assert run.state.has_started


def hand_in_inventory(hand_bench: ControllerBench, duration_s: float) -> ControllerState:
    """Return the state of a controller that is about to check whether every node has sent a reading.

    In the returned state, every node has sent a reading. A test can remove readings from the state.
    """
    hand_bench.run_until_mode(HandMode.READY)
    state = hand_bench.state.copy()
    state.mode, state.mode_start_time = HandMode.INVENTORY, -duration_s
    return state


def mode_after_inventory(
    hand_bench: ControllerBench, state: ControllerState
) -> tuple[HandMode, str]:
    state_after = state.copy()
    next_mode(
        hand_bench.controller.model,
        hand_bench.controller.drives,
        state_after,
        SafetyAction.PASS,
        OperatorRequests(),
        (),
        0.0,
    )
    return state_after.mode, state_after.failure


def test_a_ready_drive_that_never_reports_its_position_is_named(
    hand_bench: ControllerBench,
) -> None:
    """A drive can report that it is ready without sending its position.

    An ODrive, for example, sends heartbeats even if its encoder messages are switched off.
    """
    known_hand = hand_in_inventory(hand_bench, INVENTORY_TIMEOUT_S + 0.1)
    blind, state_without_position = (
        known_hand.drives[1]._replace(position=math.nan),
        known_hand.copy(),
    )
    hand_bench.controller.store_drive_state(state_without_position, 1, blind)
    state_without_position.run_integers[s.FILTER_STARTED] = 0
    assert mode_after_inventory(hand_bench, state_without_position) == (
        HandMode.DONE,
        "no position from middle_motor",
    )
    late = state_without_position.copy()
    hand_bench.controller.store_drive_state(late, 1, blind._replace(phase=DrivePhase.CONFIGURING))
    assert mode_after_inventory(hand_bench, late) == (
        HandMode.DONE,
        "middle_motor: not configured in time",
    )
    state_without_position.mode_start_time = 0.0
    assert mode_after_inventory(hand_bench, state_without_position)[0] == HandMode.INVENTORY
    assert mode_after_inventory(hand_bench, known_hand) == (HandMode.READY, "")
