"""Test how the whole controller reacts to a load cell with a broken wire."""

from dataclasses import replace

import numpy as np
import pytest

from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.programs.live_session import LiveProgram
from handctl.safety.faults.tendon import RELAXING_TIME_S
from tests.controller.controller_bench import ControllerBench, make_controller_bench


@pytest.mark.parametrize("tare_N", [-3.0, 0.0, 5.0])
def test_a_wire_that_breaks_is_found_behind_every_tare(jamia: HandModel, tare_N: float) -> None:
    """A broken wire of a load cell is detected, even if the tare of the load cell is not zero."""
    model, n = jamia, jamia.tendon_count
    run = make_controller_bench(model, LiveProgram())
    run.controller = replace(run.controller, tare_tensions=np.full(n, tare_N))
    run.toy_hand.cell_bias[:] = tare_N
    run.run_until_mode(HandMode.ACTIVE)
    run.run(0.5)
    run.toy_hand.cell_bias[1] = -100.0
    faults = [
        event.text[:3] for _ in range(4) for event in run.tick().events if event.name == "fault"
    ]
    assert "T06" in faults
    assert run.state.mode == HandMode.RELAX


def bench_with_saturated_cell(model: HandModel) -> ControllerBench:
    """Return a test bench whose hand has just started to relax.

    One load cell reads the upper end of its range.
    """
    run = make_controller_bench(model, LiveProgram())
    run.run_until_mode(HandMode.ACTIVE)
    run.toy_hand.cell_bias[:] = (
        60.0  # all load cells continue to read a high tension, so the action RELAX does not end
    )
    run.toy_hand.cell_bias[1] = 300.0
    run.run_until_mode(HandMode.RELAX)
    return run


def test_a_cell_that_stays_at_its_rail_while_the_hand_relaxes_cuts(jamia: HandModel) -> None:
    """The controller disables the drives if a load cell stays saturated while the hand relaxes.

    The saturated reading can be the only sign of a drive that does not obey.
    """
    run = bench_with_saturated_cell(jamia)
    mode_start_s = run.state.mode_start_time
    run.run_until_mode(HandMode.CUT)
    assert abs(run.state.mode_start_time - mode_start_s - RELAXING_TIME_S) <= 2 * jamia.period


def test_a_tendon_that_relaxes_in_time_needs_no_cut(jamia: HandModel) -> None:
    run = bench_with_saturated_cell(jamia)
    for _ in range(round(0.9 * RELAXING_TIME_S / jamia.period)):
        assert run.tick().mode == HandMode.RELAX
    run.toy_hand.cell_bias[:] = 0.0
    run.run_until_mode(HandMode.DISARM)
