"""Test that a tension estimate with wrong friction parameters is no worse than the raw load-cell reading."""

from pathlib import Path

import numpy as np
import pytest

from handctl.compiled import kernel
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import constant_tables
from handctl.core.estimation import kalman
from handctl.core.estimation.filter_types import STATE_COUNT, TendonRegime
from handctl.core.estimation.kalman import (
    MAX_ADDED_NOISE_S,
    NOISE_NIS_AVERAGING_TIME_S,
    NOISE_NIS_LIMIT,
    NOISE_NIS_LIMIT_OF_HAND,
)
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.document import validate_content
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from tests.controller.filter_runs import (
    flags_without_contact,
    noiseless_readings,
    run_filter_tick_without_plan,
    state_at_rest,
    state_in_regime,
)
from tests.controller.plant_run import PlantRun, model_of, run_on_plant
from tests.controller.synthetic_states import active_state, constant_args_of, uncompiled_function

TESTED_HANDS = ("jamia", "jamia11", "jamia_bench")
FRICTION_FACTORS = (0.5, 1.0, 1.5, 2.0)
EVALUATION_START_S = 1.2
"""Time in the run from which the test evaluates the errors of the tension estimate [s].

At ``EVALUATION_START_S``, no tendon is slack, and the filter has noticed the wrong friction.
"""
TAUT_TENSION_N = 0.5
BACK_AND_FORTH_TASK = {
    "schema": 1,
    "name": "back and forth",
    "phase": [
        {"kind": "move", "name": f"move {n}", "angle_deg": angle, "duration_s": 0.4}
        for n, angle in enumerate((20.0, 50.0, 15.0, 55.0, 20.0, 50.0, 15.0))
    ],
}
for_each_seed = pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 20))]
)


def run_with_friction(
    hand_name: str, friction_factor: float, seed: int, scene_folder: Path
) -> PlantRun:
    """Run a simulated hand that closes and opens.

    The friction of the simulated hand is ``friction_factor`` times the friction in the hand file.
    """
    program = TaskProgram(validate_content(BACK_AND_FORTH_TASK, Task, "moves"))
    return run_on_plant(hand_name, program, None, scene_folder, 3.0, seed, friction=friction_factor)


def estimate_and_cell_rmse(run: PlantRun) -> tuple[float, float]:
    """Return the RMSE [N] of the estimated tension, and the RMSE of the raw load-cell reading.

    The RMSE includes only taut tendons, and only the time while the hand moves.
    """
    real, is_evaluated_time = np.array(run.true_tension), np.array(run.time_s) > EVALUATION_START_S
    raw = np.array(run.measured_tension)
    is_evaluated = is_evaluated_time[:, None] & (real > TAUT_TENSION_N) & np.isfinite(raw)
    assert np.count_nonzero(is_evaluated) > 500
    estimate, cell = (
        float(np.sqrt(np.mean(np.square(tension_trace - real)[is_evaluated])))
        for tension_trace in (np.array(run.estimated_tension), raw)
    )
    return estimate, cell


@for_each_seed
@pytest.mark.parametrize("friction_factor", FRICTION_FACTORS)
@pytest.mark.parametrize("hand_name", TESTED_HANDS)
def test_estimate_is_no_worse_than_the_raw_load_cell_with_wrong_friction(
    hand_name: str, friction_factor: float, seed: int, tmp_path: Path
) -> None:
    """In this test, the hand moves freely to and fro.

    The simulated friction is ``friction_factor`` times the friction in the hand file.
    """
    estimate, cell = estimate_and_cell_rmse(
        run_with_friction(hand_name, friction_factor, seed, tmp_path)
    )
    assert estimate < cell, f"{estimate:.3f} N, the cell {cell:.3f} N"


@pytest.mark.parametrize("hand", TESTED_HANDS)
def test_the_warning_uses_the_original_model_in_doubt(hand: str) -> None:
    """After large innovations, the filter assumes more noise than before.

    Compared with the increased noise, the same innovations look normal. To warn of a wrong model,
    the filter compares the innovations with the noise that it assumed before the large innovations.
    """
    model = model_of(hand)
    x, force = state_at_rest(model, 20.0, 0.5)
    read = noiseless_readings(model, x, np.full(model.tendon_count, 21.0))
    confident_state = state_in_regime(model, TendonRegime.FREE, x)
    state_in_doubt = confident_state._replace(
        doubt_time_s=np.full(model.tendon_count, MAX_ADDED_NOISE_S)
    )
    (state_after, estimate), (after_doubt, estimate_doubt) = (
        run_filter_tick_without_plan(model, state, read, force, flags_without_contact(model))
        for state in (confident_state, state_in_doubt)
    )
    assert state_after.nis_mean == pytest.approx(after_doubt.nis_mean)
    assert state_after.nis_fast_average == pytest.approx(after_doubt.nis_fast_average)
    assert (estimate_doubt.nis < estimate.nis).all()
    assert (estimate_doubt.tension_sigma > estimate.tension_sigma).all()
    assert (estimate_doubt.tension > estimate.tension + 0.05).all(), "the load cell counts for more"


@kernel("block", "layout", "constants", "layout", "matrix", "matrix")
def _judge_innovations(
    block: BlockArray,
    state_offsets: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    innovation: np.ndarray,
    information: np.ndarray,
) -> None:
    kalman._update_consistency(
        state_tables(block, state_offsets),
        constant_tables(constants, constant_offsets),
        innovation,
        information,
        True,
    )


def nis_average_and_doubt_time(
    model: HandModel, recent_nis: np.ndarray, doubt_time_s: np.ndarray, nis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the average NIS and the remaining doubt time of each tendon after one tick, as arrays (tendons,).

    The average NIS is the average of the normalised innovation squared that the filter computes.
    The doubt time is the time for which the filter still assumes additional noise [s].
    """
    state, n = active_state(model), model.tendon_count
    state.view("nis_lately")[...], state.view("wary")[...] = recent_nis, doubt_time_s
    innovation = np.column_stack((np.zeros(n), np.sqrt(nis), np.full(n, np.nan)))
    _judge_innovations(
        state.block, state.layout.offsets, *constant_args_of(model), innovation, np.ones((n, 3))
    )
    return state.view("nis_lately").copy(), state.view("wary").copy()


def test_a_slow_loop_does_not_adapt() -> None:
    recent_nis, wary = np.full(4, 2.0), np.zeros(4)
    model = HandModel.from_hand(load_hand("jamia"), Gains(), 100.0)
    for _ in range(300):
        recent_nis, wary = nis_average_and_doubt_time(model, recent_nis, wary, np.full(4, 50.0))
    assert not wary.any()


def test_one_tendon_or_all_raise_doubt(jamia11: HandModel) -> None:
    """One tendon with large innovations makes the filter doubt the model of this tendon.

    Smaller innovations in all tendons together make the filter doubt the models of all tendons. A
    single reading with a large innovation does not make the filter doubt the models of the other
    tendons.
    """
    period, default_nis, zero_vector = jamia11.period, np.full(11, 2.0), np.zeros(11)
    for odd, all_of_them in (
        (np.array([2 * NOISE_NIS_LIMIT, *[1.5] * 10]), False),
        (np.full(11, NOISE_NIS_LIMIT_OF_HAND + 0.3), True),
    ):
        recent_nis, wary = default_nis, zero_vector
        for _ in range(round(5 * NOISE_NIS_AVERAGING_TIME_S / period)):
            recent_nis, wary = nis_average_and_doubt_time(jamia11, recent_nis, wary, odd)
        assert wary[0] == MAX_ADDED_NOISE_S
        assert bool(wary[1:].any()) == all_of_them
    nis = np.array([1e6, *[2.0] * 10])
    assert not nis_average_and_doubt_time(jamia11, default_nis, zero_vector, nis)[1][1:].any()


def test_doubt_ends_and_missing_samples_do_not_change_it(jamia11: HandModel) -> None:
    """In each tick, the remaining time for which the filter doubts its model decreases.

    A missing reading (NaN) does not change the average of the normalised innovation squared.
    """
    n = jamia11.tendon_count
    recent_nis, wary = nis_average_and_doubt_time(
        jamia11, np.full(n, 2.0), np.full(n, 3 * jamia11.period), np.full(n, np.nan)
    )
    assert (recent_nis == 2.0).all()
    assert wary == pytest.approx(2 * jamia11.period)
    for _ in range(2):
        recent_nis, wary = nis_average_and_doubt_time(jamia11, recent_nis, wary, np.full(n, 2.0))
    assert not wary.any()
    state = active_state(jamia11)
    state.view("regime")[...] = regimes = np.arange(n) % len(TendonRegime)
    x = uncompiled_function(state_tables)(state.block, state.layout.offsets)
    assert [uncompiled_function(kalman.filter_kind)(x, i) for i in range(n)] == regimes.tolist()
    state.view("wary")[...] = 1e-9
    assert [uncompiled_function(kalman.filter_kind)(x, i) for i in range(n)] == (
        regimes + len(TendonRegime)
    ).tolist()


@pytest.mark.parametrize("hand", TESTED_HANDS)
def test_the_filter_in_doubt_is_stable(hand: str) -> None:
    """While the filter doubts its model, the errors of all states of a taut tendon decay."""
    for blocks in model_of(hand).filter_design.blocks:
        for regime in (TendonRegime.FREE, TendonRegime.HELD):
            block = blocks[regime + len(TendonRegime)]
            indices_without_cell_error = np.delete(np.arange(STATE_COUNT), 5)
            H, K = (
                block.H[:2, indices_without_cell_error],
                block.K[np.ix_(indices_without_cell_error, [0, 1])],
            )
            error = block.F[np.ix_(indices_without_cell_error, indices_without_cell_error)] @ (
                np.eye(len(indices_without_cell_error)) - K @ H
            )
            assert np.abs(np.linalg.eigvals(error)).max() < 1.0
            assert block.tension_variance > blocks[regime].tension_variance
