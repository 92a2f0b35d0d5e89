"""Test how friction changes a tension when a digit reverses its motion.

The friction band of a tendon contains all tensions that friction permits at the same load. The
tests check the computed friction band, and the errors of estimated tensions in the simulator.
"""

from pathlib import Path

import numpy as np
import pytest

from handctl.core.control_law.friction_band import MIN_SLIDING_SPEED_M_S, tension_after_period
from handctl.core.hand_model import HandModel
from handctl.document import validate_content
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from tests.controller.control_law_runs import ControlLawState, run_control_law_tick
from tests.controller.digit_goals import moving_goals
from tests.controller.plant_run import CONTROL_RATE_HZ, run_on_plant
from tests.controller.synthetic_states import estimate_under_tension, uncompiled_function

MOVE_DURATION_S = 0.3
TIME_AROUND_REVERSAL_S = 0.05


def tensions_at_speeds(
    model: HandModel, winding_speeds: list[float], initial_tension: float
) -> np.ndarray:
    """Return the expected tensions [N] at given winding speeds, as an array (ticks, tendons).

    The commanded tension is 12 N, and friction takes 20 % of the tension.
    """
    n = model.tendon_count
    present_tensions, tensions, crept = (
        [initial_tension] * n,
        [],
        MIN_SLIDING_SPEED_M_S * model.period,
    )
    for speed in winding_speeds:
        wound_length = speed * model.period
        present_tensions = [
            uncompiled_function(tension_after_period)(
                tension, 12.0, 0.8, wound_length, stiffness, crept
            )
            for tension, stiffness in zip(
                present_tensions, model.tendon_constants.stiffness, strict=True
            )
        ]
        tensions.append(present_tensions)
    return np.array(tensions)


def test_winding_and_paying_out_are_the_edges_of_the_band(model: HandModel) -> None:
    np.testing.assert_allclose(tensions_at_speeds(model, [0.1] * 50, 12.0)[-1], 12.0 / 0.8)
    np.testing.assert_allclose(tensions_at_speeds(model, [-0.1] * 50, 12.0)[-1], 12.0 * 0.8)


def test_reversal_takes_the_travel_of_the_friction_band(model: HandModel) -> None:
    """With a tendon stiffness of 100 N/mm and a speed of 5 mm/s, the tension falls from 15 to 9.6 N in 11 ms.

    The computed time of the fall is slightly shorter than 11 ms, because the model of the friction
    lets the tendon creep.
    """
    turned_tensions = tensions_at_speeds(model, [-5e-3] * 40, 15.0)
    ticks = int(np.argmax(turned_tensions[:, 0] <= 9.6 + 1e-9)) + 1
    reversal_duration = 5.4 / model.tendon_constants.stiffness[0] / 5e-3
    assert (
        0.6 * reversal_duration - model.period
        <= ticks * model.period
        <= reversal_duration + model.period
    )
    assert (np.diff(turned_tensions, axis=0) <= 0.0).all(), "and never back"


def test_expected_tension_at_rest_approaches_the_load(model: HandModel) -> None:
    remaining_tensions = tensions_at_speeds(model, [0.0] * round(0.5 / model.period), 15.0)
    np.testing.assert_allclose(remaining_tensions[-1], 12.0, atol=0.01)


def test_a_tendon_with_almost_no_expected_tension_pays_out(model: HandModel) -> None:
    n = model.tendon_count
    law_before = ControlLawState.initial_state(n)._replace(
        planned=np.full(n, 5e-324), friction_slider=np.ones(n)
    )
    law, _ = run_control_law_tick(
        model,
        law_before,
        estimate_under_tension(model, 1.0),
        moving_goals(model, 0.6, 0.7, 1.0),
        0.5,
    )
    assert (law.friction_state == -1.0).all()


@pytest.mark.parametrize("hand", ["jamia", "jamia11"])
def test_where_a_free_digit_turns_the_estimate_is_better_than_the_cell(
    hand: str, tmp_path: Path
) -> None:
    angles = (40.0, 15.0, 45.0, 10.0, 35.0, 12.0)
    move_phases = [
        {"kind": "move", "angle_deg": {"index": a, "ring": a}, "duration_s": MOVE_DURATION_S}
        for a in angles
    ]
    task = TaskProgram(
        validate_content({"schema": 1, "name": "turns", "phase": move_phases}, Task, "test")
    )
    run = run_on_plant(hand, task, None, tmp_path, 4.5)
    move_start_times = [
        t for t, event in run.events if event.name == "phase" and event.text == "move"
    ][1:]
    assert len(move_start_times) == len(angles) - 1
    tendons = [0, 2] if hand == "jamia" else [0, 1, 2, 6, 7, 8]
    real, estimate, cell = (
        np.array(table)[:, tendons]
        for table in (run.true_tension, run.estimated_tension, run.measured_tension)
    )
    ticks = [
        k
        for k, t in enumerate(run.time_s)
        if any(0.0 <= t - start < TIME_AROUND_REVERSAL_S for start in move_start_times)
    ]
    assert len(ticks) == pytest.approx(
        len(move_start_times) * TIME_AROUND_REVERSAL_S * CONTROL_RATE_HZ, abs=len(move_start_times)
    )
    estimate_error, raw = (
        np.sqrt(((table - real)[ticks] ** 2).mean()) for table in (estimate, cell)
    )
    assert estimate_error < raw
    assert np.abs(estimate - real)[ticks].max() < 2.5, "[N]"
