"""Test replies for which the controller sent no request.

The tests check the fault that unrequested replies cause, and which frames count as replies of a
motor.
"""

import pytest

from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickOut
from handctl.drives.frame import Frame
from handctl.programs.live_session import LiveProgram
from tests.controller.controller_bench import ControllerBench, make_controller_bench

UNREQUESTED_REPLY = Frame(0x11, bytes([0x11, 0x80, 0, 0x80, 8, 0, 30, 30]))
"""Feedback frame of the first motor, which reports that the motor is enabled."""


@pytest.fixture
def silent_bench(jamia: HandModel) -> ControllerBench:
    """Return a test bench whose controller has not yet sent a request."""
    run = make_controller_bench(jamia, LiveProgram())
    run.tick()
    return run


@pytest.fixture
def active_bench(jamia: HandModel) -> ControllerBench:
    """Return a test bench whose hand is active."""
    run = make_controller_bench(jamia, LiveProgram())
    run.run_until_mode(HandMode.ACTIVE)
    run.run(0.1)
    return run


def reported_faults(tick_output: TickOut) -> list[str]:
    return [event.text[:3] for event in tick_output.events if event.name == "fault"]


@pytest.mark.parametrize("reply_count", [1, 3])
def test_a_motor_that_answers_before_it_was_asked_was_asked_by_another_controller(
    silent_bench: ControllerBench, reply_count: int
) -> None:
    out = silent_bench.tick(extra_frames=(UNREQUESTED_REPLY,) * reply_count)
    assert reported_faults(out) == ["H13"], (
        "one is enough; it is no duplicate, since nothing was asked"
    )
    assert out.mode == HandMode.DONE
    name = silent_bench.controller.drives[0].name
    assert (
        silent_bench.state.failure
        == f"another controller is on the bus (heard: {name} answering it)"
    )
    assert all(out.frames == () for _, _, out in silent_bench.tick_history)


def test_a_request_of_another_host_and_its_answer_in_one_tick_are_both_reported(
    silent_bench: ControllerBench,
) -> None:
    out = silent_bench.tick(extra_frames=(Frame(0x01, bytes(8)), UNREQUESTED_REPLY))
    assert reported_faults(out) == ["H13", "H13"]
    assert "(heard: 0x001, " in silent_bench.state.failure


def test_the_first_reply_to_the_first_request_is_not_in_excess(
    silent_bench: ControllerBench,
) -> None:
    silent_bench.run_until_mode(HandMode.INVENTORY)
    assert not silent_bench.tick().events
    assert not silent_bench.tick().events


def test_frames_of_others_do_not_make_a_duplicate_a_second_node(
    active_bench: ControllerBench,
) -> None:
    """Only frames that were decoded as the feedback of a motor count as replies of this motor."""
    active_bench.modify_frames_to_host = lambda frames: [
        *frames,
        *[f for f in frames if f.can_id == 0x11],
        Frame(0x11, bytes([0x12] * 8)),
    ]
    assert reported_faults(active_bench.tick()) == ["B05", "B09"]


def test_two_different_replies_show_a_second_node_despite_frames_between_them(
    active_bench: ControllerBench,
) -> None:
    active_bench.modify_frames_to_host = lambda frames: [
        *frames,
        Frame(0x11, bytes(7)),
        UNREQUESTED_REPLY,
    ]
    assert "B06" in reported_faults(active_bench.tick())


@pytest.mark.parametrize(("change_cell_reply", "expected_faults"), [
    (lambda cell: [cell, cell], ["B05"]),
    (lambda cell: [cell, cell, frame_with_older_counter(cell)], ["B05", "B07"]),
    (lambda cell: [frame_with_older_counter(cell), cell, cell], ["B04", "B05"]),
    (lambda cell: [cell, frame_with_other_tension(cell)], ["B06"]),
    (lambda cell: [cell, frame_with_other_tension(cell), *[frame_with_older_counter(cell)] * 2], ["B06", "B07"]),
    (lambda cell: [cell, frame_with_older_counter(cell)], ["B07"]),
])  # fmt: skip
def test_only_load_cell_replies_of_the_present_tick_count(
    active_bench, change_cell_reply, expected_faults
) -> None:
    active_bench.modify_frames_to_host = lambda frames: [
        f
        for frame in frames
        for f in (change_cell_reply(frame) if is_load_cell_frame(active_bench, frame) else [frame])
    ]
    assert sorted(reported_faults(active_bench.tick())) == expected_faults


def is_load_cell_frame(active_bench: ControllerBench, frame: Frame) -> bool:
    return frame.can_id == active_bench.controller.sensors.ids[0]


def frame_with_older_counter(cell_frame: Frame) -> Frame:
    """Copy a load-cell frame, and change its counter, as if the frame replied to another SYNC frame."""
    return cell_frame._replace(data=bytes([cell_frame.data[0] ^ 1]) + cell_frame.data[1:])


def frame_with_other_tension(cell_frame: Frame) -> Frame:
    """Copy a load-cell frame, and change its tension, but not its counter."""
    return cell_frame._replace(data=bytes([cell_frame.data[0] ^ 0x10]) + cell_frame.data[1:])


@pytest.mark.parametrize(("open_requests", "reply_variants", "expected_faults"), [
    (1, "AA", "B05"), (1, "AB", "B06"), (1, "ABB", "B06"), (1, "AAB", "B06"), (1, "AAA", "B05"),
    (2, "ABB", "B05"), (2, "AAB", "B06"), (2, "ABA", "B06"), (2, "AB", None),
])  # fmt: skip
def test_only_replies_in_excess_are_compared_with_the_expected_reply(
    active_bench, open_requests, reply_variants, expected_faults
) -> None:
    """If two requests of the controller are open, two different replies to these requests are no fault.

    The controller compares replies only if it gets more replies than it has open requests.
    """
    if open_requests == 2:
        active_bench.modify_frames_to_host = lambda frames: [
            frame for frame in frames if frame.can_id != 0x11
        ]
        active_bench.tick()
    active_bench.modify_frames_to_host = lambda frames: [
        f for frame in frames for f in copies_of_motor_reply(frame, reply_variants)
    ]
    reported = [id_ for id_ in reported_faults(active_bench.tick()) if id_ in ("B05", "B06")]
    assert reported == ([expected_faults] if expected_faults else [])


def copies_of_motor_reply(motor_reply: Frame, reply_variants: str) -> list[Frame]:
    """Copy a reply of motor 1 once for each letter in ``reply_variants``.

    The letter A stands for an unchanged copy, and the letter B for a copy with another temperature.
    A reply of any other motor is returned once, without a change.
    """
    if motor_reply.can_id != 0x11:
        return [motor_reply]
    other_motor_reply = motor_reply._replace(
        data=motor_reply.data[:7] + bytes([motor_reply.data[7] ^ 1])
    )
    return [motor_reply if kind == "A" else other_motor_reply for kind in reply_variants]
