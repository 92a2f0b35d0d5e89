"""Test how the report judges whether a hand has lifted an object.

The report judges a lift by the true motions of the table and of the object.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handctl.report.lift_judgement import MAX_SLIP_MM, judge_lift, lift_failure
from handctl.report.run_summary import summarise_run
from handctl.report.truth_record import TruthRecord
from tests.report.generated_run import (
    JAMIA_HAND,
    GeneratedRunLog,
    set_truth_column,
    zero_truth_record,
)

TICK_COUNT = 400
SINK_START_TICK, SINK_END_TICK = 200, 350
"""Index of the tick at which the table begins to sink, and index of the tick at which the hold phase ends."""


def log_and_truth_of_lift(
    table_descent_m: float, object_fall_m: float
) -> tuple[GeneratedRunLog, TruthRecord]:
    """Create a log and the true values of a run in which table and object sink with constant speeds.

    Table and object sink from the tick SINK_START_TICK to the tick SINK_END_TICK.
    """
    log = GeneratedRunLog(
        JAMIA_HAND, TICK_COUNT, {0: "close", 100: "carry", SINK_END_TICK: "release"}
    )
    truth = zero_truth_record(JAMIA_HAND, TICK_COUNT)
    truth = replace(
        truth,
        values=np.column_stack([truth.values, truth.values[:, 0]]),
        columns=(*truth.columns, "support"),
    )
    descent_fraction = np.interp(
        np.arange(TICK_COUNT), [SINK_START_TICK, SINK_END_TICK - 1], [0.0, 1.0]
    )
    set_truth_column(truth, "support", table_descent_m * descent_fraction)
    set_truth_column(
        truth,
        "object/z",
        -object_fall_m * descent_fraction - 0.5 * (np.arange(TICK_COUNT) >= SINK_END_TICK),
    )  # the object falls when the hand opens
    set_truth_column(
        truth, "object/x", 0.05 * (np.arange(TICK_COUNT) < 150)
    )  # the object is pushed before the lift
    return log, truth


def lift_result(
    run_log: GeneratedRunLog, truth: TruthRecord | None, *hold_phases: str
) -> dict[str, Any]:
    return judge_lift(run_log, truth, 0, hold_phases)  # type: ignore[arg-type]


def test_an_object_that_stays_in_the_hand_is_carried() -> None:
    lift_report = lift_result(*log_and_truth_of_lift(0.2, 0.0005), "carry")
    assert lift_report["table_sunk_mm"] == pytest.approx(200.0)
    assert lift_report["object_slid_mm"] == pytest.approx(0.5, abs=0.01)
    assert lift_failure(lift_report) == ""


def test_an_object_that_falls_with_its_table_is_a_failure() -> None:
    lift_report = lift_result(*log_and_truth_of_lift(0.2, 0.2), "carry")
    assert "moved 199 mm while the table sank 200 mm" in lift_failure(lift_report)


@pytest.mark.parametrize("slide_direction", [-0.5, 0.5])
def test_an_object_may_slide_by_the_limit_and_no_farther(slide_direction: float) -> None:
    lift_report = lift_result(
        *log_and_truth_of_lift(0.2, (MAX_SLIP_MM + slide_direction) * 1e-3), "carry"
    )
    assert bool(lift_failure(lift_report)) == (slide_direction > 0)


def test_without_a_sunk_table_the_lift_fails_and_has_no_object_motion() -> None:
    log, truth = log_and_truth_of_lift(0.0, 0.0)
    assert "never lifted" in lift_failure(lift_result(log, truth, "carry"))
    steady_log = GeneratedRunLog(JAMIA_HAND, TICK_COUNT, {0: "hold"})
    steady_log.fields["contact"][:, 0] = 1.0
    steady_log.fields["tension_goal"][:] = steady_log.fields["tension"][:] = steady_log.fields[
        "tension_raw"
    ][:] = 9.0
    steady_log.fields["tip_force"][:] = 0.0
    assert np.isnan(summarise_run(steady_log, JAMIA_HAND, truth, 0)["object_motion_mm"])  # type: ignore[arg-type]
    _, sinking = log_and_truth_of_lift(0.2, 0.0)
    assert not np.isnan(summarise_run(steady_log, JAMIA_HAND, sinking, 0)["object_motion_mm"])  # type: ignore[arg-type]


def test_without_a_sinking_table_or_a_hold_there_is_no_judgement() -> None:
    log, truth = log_and_truth_of_lift(0.2, 0.2)
    for lift_report in (lift_result(log, truth), lift_result(log, truth, "elsewhere"), lift_result(log, None, "carry"),
                  lift_result(log, zero_truth_record(JAMIA_HAND, TICK_COUNT), "carry")):  # fmt: skip
        assert np.isnan(lift_report["table_sunk_mm"])
        assert lift_failure(lift_report) == ""
