"""Test the state of drives after a run. A host that is no longer there is a fault only if the run failed."""

from pathlib import Path

import pytest

from handctl.campaign.stage import homed_run
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.session.simulate import SimulatedRun
from tests.drives.protocol_bench import OPTIONS, hand_file

SILENCE_TICKS = 500


def until(course: SimulatedRun, mode: HandMode) -> None:
    assert course.until(lambda out: out.mode == mode, 3.0), course.state.failure


def run_again(course: SimulatedRun) -> SimulatedRun:
    """Return a second run on the same drives. It starts one second after the end of the first run."""
    for k in range(SILENCE_TICKS):
        course.peer.step((course.k + k) * course.period_ns, [])
    return SimulatedRun(
        course.controller,
        course.peer,
        course.period_ns,
        course.controller.initial_state(),
        course.k + k + 1,
    )


@pytest.mark.parametrize("protocol", sorted(OPTIONS))
def test_after_a_good_end_the_next_run_finds_no_fault(protocol: str, tmp_path: Path) -> None:
    hand = load_hand(str(hand_file(tmp_path, [protocol])))
    with homed_run(hand, 500.0, 1) as course:
        until(course, HandMode.ACTIVE)
        course.tick(requests=('{"do": "stop"}',))
        until(course, HandMode.DONE)
        assert course.state.failure == ""
        until(run_again(course), HandMode.READY)


def test_after_a_failure_cia402_drives_stay_supervised(tmp_path: Path) -> None:
    hand = load_hand(str(hand_file(tmp_path, ["cia402"])))
    with homed_run(hand, 500.0, 1) as course:
        until(course, HandMode.ACTIVE)
        course.peer.inject("off node=index_motor")
        assert course.until(lambda out: out.mode == HandMode.DONE, 5.0)
        assert course.state.failure
        assert course.out is not None
        assert course.out.frames == ()
