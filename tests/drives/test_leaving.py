"""Test the state of drives after a run. A host that is no longer there is a fault only if the run failed."""

from pathlib import Path

import pytest

from handctl.campaign.run_stages import homed_run
from handctl.core.types import Mode
from handctl.hand.load import load_hand
from handctl.session.simulate import SimulatedRun
from tests.drives.protocol_bench import OPTIONS, hand_file

SILENCE_TICKS = 500


def until(course: SimulatedRun, mode: Mode) -> None:
    assert course.run_until(lambda out: out.mode == mode, 3.0), course.state.failure


def run_again(course: SimulatedRun) -> SimulatedRun:
    """Return a second run on the same drives. It starts one second after the end of the first run."""
    for k in range(SILENCE_TICKS):
        course.simulated_hand.step((course.k + k) * course.period_ns, [])
    return SimulatedRun(
        course.controller,
        course.simulated_hand,
        course.period_ns,
        course.controller.initial(),
        course.k + k + 1,
    )


@pytest.mark.parametrize("protocol", sorted(OPTIONS))
def test_after_a_good_end_the_next_run_finds_no_fault(protocol: str, tmp_path: Path) -> None:
    hand = load_hand(str(hand_file(tmp_path, [protocol])))
    with homed_run(hand, 500.0, 1) as course:
        until(course, Mode.ACTIVE)
        course.run_tick(requests=('{"do": "stop"}',))
        until(course, Mode.DONE)
        assert course.state.failure == ""
        until(run_again(course), Mode.READY)


def test_after_a_failure_cia402_drives_stay_supervised(tmp_path: Path) -> None:
    hand = load_hand(str(hand_file(tmp_path, ["cia402"])))
    with homed_run(hand, 500.0, 1) as course:
        until(course, Mode.ACTIVE)
        course.simulated_hand.inject("off node=index_motor")
        assert course.run_until(lambda out: out.mode == Mode.DONE, 5.0)
        assert course.state.failure
        assert course.last_output is not None
        assert course.last_output.frames == ()
