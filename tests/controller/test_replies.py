"""Test replies that no request explains: the fault that they show, and the frames that count as replies."""

import pytest

from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickOut
from handctl.drives.frame import Frame
from handctl.programs.live_session import LiveProgram
from tests.controller.bench import Bench, bench

UNASKED = Frame(0x11, bytes([0x11, 0x80, 0, 0x80, 8, 0, 30, 30]))
"""Feedback frame of the first motor. It reports that the motor is enabled."""


@pytest.fixture
def silent(jamia: HandModel) -> Bench:
    """Return a bench whose controller has not yet sent a request."""
    run = bench(jamia, LiveProgram())
    run.tick()
    return run


@pytest.fixture
def run(jamia: HandModel) -> Bench:
    """Return a bench whose hand is active."""
    run = bench(jamia, LiveProgram())
    run.until(HandMode.ACTIVE)
    run.run(0.1)
    return run


def faults(out: TickOut) -> list[str]:
    return [event.text[:3] for event in out.events if event.name == "fault"]


@pytest.mark.parametrize("times", [1, 3])
def test_a_motor_that_answers_before_it_was_asked_was_asked_by_another_controller(
    silent: Bench, times: int
) -> None:
    out = silent.tick(extra=(UNASKED,) * times)
    assert faults(out) == ["H13"], "one is enough; it is no duplicate, since nothing was asked"
    assert out.mode == HandMode.DONE
    name = silent.controller.drives[0].name
    assert silent.state.failure == f"another controller is on the bus (heard: {name} answering it)"
    assert all(out.frames == () for _, _, out in silent.history)


def test_a_request_of_another_host_and_its_answer_in_one_tick_are_both_reported(
    silent: Bench,
) -> None:
    out = silent.tick(extra=(Frame(0x01, bytes(8)), UNASKED))
    assert faults(out) == ["H13", "H13"]
    assert "(heard: 0x001, " in silent.state.failure


def test_the_first_reply_to_the_first_request_is_not_in_excess(silent: Bench) -> None:
    silent.until(HandMode.INVENTORY)
    assert not silent.tick().events
    assert not silent.tick().events


def test_frames_of_others_do_not_make_a_duplicate_a_second_node(run: Bench) -> None:
    """Only frames that were decoded as feedback of a motor count as its replies."""
    run.to_host = lambda frames: [
        *frames,
        *[f for f in frames if f.can_id == 0x11],
        Frame(0x11, bytes([0x12] * 8)),
    ]
    assert faults(run.tick()) == ["B05", "B09"]


def test_two_different_replies_show_a_second_node_despite_frames_between_them(run: Bench) -> None:
    run.to_host = lambda frames: [*frames, Frame(0x11, bytes(7)), UNASKED]
    assert "B06" in faults(run.tick())


@pytest.mark.parametrize(("behind", "found"), [
    (lambda cell: [cell, cell], ["B05"]),
    (lambda cell: [cell, cell, with_older_counter(cell)], ["B05", "B07"]),
    (lambda cell: [with_older_counter(cell), cell, cell], ["B04", "B05"]),
    (lambda cell: [cell, with_other_tension(cell)], ["B06"]),
    (lambda cell: [cell, with_other_tension(cell), with_older_counter(cell), with_older_counter(cell)], ["B06", "B07"]),
    (lambda cell: [cell, with_older_counter(cell)], ["B07"]),
])  # fmt: skip
def test_only_load_cell_replies_of_the_present_tick_count(run, behind, found) -> None:
    run.to_host = lambda frames: [
        f for frame in frames for f in (behind(frame) if is_cell(run, frame) else [frame])
    ]
    assert sorted(faults(run.tick())) == found


def is_cell(run: Bench, frame: Frame) -> bool:
    return frame.can_id == run.controller.sensors.ids[0]


def with_older_counter(cell: Frame) -> Frame:
    """Return a load-cell frame with the counter of another SYNC."""
    return cell._replace(data=bytes([cell.data[0] ^ 1]) + cell.data[1:])


def with_other_tension(cell: Frame) -> Frame:
    """Return a load-cell frame with the same counter, but with another tension."""
    return cell._replace(data=bytes([cell.data[0] ^ 0x10]) + cell.data[1:])


@pytest.mark.parametrize(("outstanding", "came", "found"), [
    (1, "AA", "B05"), (1, "AB", "B06"), (1, "ABB", "B06"), (1, "AAB", "B06"), (1, "AAA", "B05"),
    (2, "ABB", "B05"), (2, "AAB", "B06"), (2, "ABA", "B06"), (2, "AB", None),
])  # fmt: skip
def test_only_replies_in_excess_are_compared_with_the_expected_reply(
    run, outstanding, came, found
) -> None:
    """A late reply to an older request is not in excess. Its bytes may differ from those of the new reply."""
    if outstanding == 2:
        run.to_host = lambda frames: [frame for frame in frames if frame.can_id != 0x11]
        run.tick()
    run.to_host = lambda frames: [f for frame in frames for f in change_first_motor(frame, came)]
    reported = [id_ for id_ in faults(run.tick()) if id_ in ("B05", "B06")]
    assert reported == ([found] if found else [])


def change_first_motor(answer: Frame, kinds: str) -> list[Frame]:
    """Return a motor's reply once for each letter.

    For A it is unchanged, and for B it has another temperature. Only replies of the first motor are
    repeated.
    """
    if answer.can_id != 0x11:
        return [answer]
    other = answer._replace(data=answer.data[:7] + bytes([answer.data[7] ^ 1]))
    return [answer if kind == "A" else other for kind in kinds]
