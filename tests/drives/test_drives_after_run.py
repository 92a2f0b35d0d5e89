"""Test the state of the drives after a run.

Between two runs, the host sends nothing. After a run that ended without a failure, no drive reports
the silence of the host as a fault. After a failed run, CiA 402 drives continue to supervise the
host.
"""

from pathlib import Path

import pytest

from handctl.campaign.run_stages import homed_run
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from handctl.session.lockstep_simulation import SimulatedRun
from tests.drives.protocol_bench import OPTIONS_TEXT_BY_PROTOCOL, hand_file

SILENCE_TICKS = 500


def run_until_mode(simulated_run: SimulatedRun, mode: HandMode) -> None:
    assert simulated_run.run_until(lambda out: out.mode == mode, 3.0), simulated_run.state.failure


def restart_with_same_drives(simulated_run: SimulatedRun) -> SimulatedRun:
    """Return a second run with the same drives, which starts one second after the end of the first run."""
    for k in range(SILENCE_TICKS):
        simulated_run.simulated_hand.step((simulated_run.k + k) * simulated_run.period_ns, [])
    return SimulatedRun(
        simulated_run.controller,
        simulated_run.simulated_hand,
        simulated_run.period_ns,
        simulated_run.controller.initial_state(),
        simulated_run.k + k + 1,
    )


@pytest.mark.parametrize("protocol", sorted(OPTIONS_TEXT_BY_PROTOCOL))
def test_after_a_good_end_the_next_run_finds_no_fault(protocol: str, tmp_path: Path) -> None:
    hand = load_hand(str(hand_file(tmp_path, [protocol])))
    with homed_run(hand, 500.0, 1) as simulated_run:
        run_until_mode(simulated_run, HandMode.ACTIVE)
        simulated_run.run_tick(requests=('{"do": "stop"}',))
        run_until_mode(simulated_run, HandMode.DONE)
        assert simulated_run.state.failure == ""
        run_until_mode(restart_with_same_drives(simulated_run), HandMode.READY)


def test_after_a_failure_cia402_drives_stay_supervised(tmp_path: Path) -> None:
    hand = load_hand(str(hand_file(tmp_path, ["cia402"])))
    with homed_run(hand, 500.0, 1) as simulated_run:
        run_until_mode(simulated_run, HandMode.ACTIVE)
        simulated_run.simulated_hand.inject("off node=index_motor")
        assert simulated_run.run_until(lambda out: out.mode == HandMode.DONE, 5.0)
        assert simulated_run.state.failure
        assert simulated_run.last_output is not None
        assert simulated_run.last_output.frames == ()
