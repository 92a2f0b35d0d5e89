"""Test that an excitation tares the load cells of slack tendons again."""

import numpy as np
import pytest

from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.programs.excitation import (
    MAX_TARE_CHANGE_N,
    TARE_DURATION_S,
    TARE_STEP_NAME,
    ExciteProgram,
    ExciteStep,
)
from tests.controller.controller_bench import ControllerBench, make_controller_bench

STEP_COUNT = 20
DRIFTING_TENDON = 1
FASTEST_DRIFT_N_PER_S = 0.6
"""Drift of a load cell with which its bias is 6 N at the end of the excitation [N/s]."""


def excited_bench(model: HandModel, drift_N_per_s: float, excited_digit: str) -> ControllerBench:
    """Run an excitation that consists only of the steps ``tare`` of one digit, and return its bench.

    Args:
        model: model of the hand.
        drift_N_per_s: drift of the load cell of the tendon ``DRIFTING_TENDON`` [N/s].
        excited_digit: digit of all steps.
    """
    step = ExciteStep(
        digit=excited_digit, name=TARE_STEP_NAME, kind="limp", duration_s=TARE_DURATION_S
    )
    bench = make_controller_bench(model, ExciteProgram((step,) * STEP_COUNT))
    bench.run_until_mode(HandMode.ACTIVE)
    while bench.state.mode == HandMode.ACTIVE:
        bench.toy_hand.cell_bias[DRIFTING_TENDON] += drift_N_per_s * model.period
        bench.tick()
    return bench


@pytest.mark.parametrize("drift_N_per_s", [-0.43, 0.43])
def test_the_load_cell_of_a_slack_tendon_is_tared_again(
    jamia: HandModel, drift_N_per_s: float
) -> None:
    """Reproduce a defect: a load cell that drifted for a minute, beside a moving digit, ended the run with T06."""
    bench = excited_bench(jamia, drift_N_per_s, "index")
    bias = bench.toy_hand.cell_bias[DRIFTING_TENDON]
    assert abs(bias) > 4.1
    assert not bench.state.failure
    tares = bench.state.view("program_tare")
    assert tares[DRIFTING_TENDON] == pytest.approx(bias, abs=0.6)
    assert np.abs(np.delete(tares, DRIFTING_TENDON)).max() < 0.2


def test_the_load_cells_of_the_excited_digit_keep_their_tare(jamia: HandModel) -> None:
    """The identification determines the offsets of the excited digit's load cells, so their tare stays the same."""
    digit = jamia.hand.digit_names[DRIFTING_TENDON]
    bench = excited_bench(jamia, -0.2, digit)
    assert bench.state.view("program_tare")[DRIFTING_TENDON] == 0.0


def test_a_load_cell_that_drifts_far_is_still_reported(jamia: HandModel) -> None:
    bench = excited_bench(jamia, -FASTEST_DRIFT_N_PER_S, "index")
    assert "T06" in bench.state.failure
    assert abs(bench.state.view("program_tare")[DRIFTING_TENDON]) <= MAX_TARE_CHANGE_N
