"""Whether a grasp carried its object: by how far the table sank, and how far the object then moved."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from handctl.report.lift import SLID_MM, judge_lift, lift_failure
from handctl.report.summary import summarise
from handctl.report.truth import TruthRecord
from tests.report.made_up import JAMIA, MadeUpLog, set_column, truth_of

TICKS = 400
SINKS, ENDS = 200, 350
"""Ticks at which the table begins to sink and at which the hold ends."""


def told(sunk_m: float, fallen_m: float) -> tuple[MadeUpLog, TruthRecord]:
    """A grasp whose table sinks and whose object falls, linearly, from SINKS to the end of the hold."""
    log = MadeUpLog(JAMIA, TICKS, {0: "close", 100: "carry", ENDS: "release"})
    truth = truth_of(JAMIA, TICKS)
    truth = replace(
        truth, values=np.column_stack([truth.values, truth.values[:, 0]]), columns=(*truth.columns, "support")
    )
    way = np.interp(np.arange(TICKS), [SINKS, ENDS - 1], [0.0, 1.0])
    set_column(truth, "support", sunk_m * way)
    set_column(truth, "object/z", -fallen_m * way - 0.5 * (np.arange(TICKS) >= ENDS))  # let go, it falls
    set_column(truth, "object/x", 0.05 * (np.arange(TICKS) < 150))  # it was shoved before, on the table
    return log, truth


def judged(log: MadeUpLog, truth: TruthRecord | None, *holds: str) -> dict[str, Any]:
    return judge_lift(log, truth, 0, holds)  # type: ignore[arg-type]


def test_an_object_that_stays_in_the_hand_is_carried() -> None:
    found = judged(*told(0.2, 0.0005), "carry")
    assert found["table_sunk_mm"] == pytest.approx(200.0)
    assert found["object_slid_mm"] == pytest.approx(0.5, abs=0.01)
    assert lift_failure(found) == ""


def test_an_object_that_falls_with_its_table_is_a_failure() -> None:
    found = judged(*told(0.2, 0.2), "carry")
    assert "moved 199 mm while the table sank 200 mm" in lift_failure(found)


@pytest.mark.parametrize("side", [-0.5, 0.5])
def test_the_limit_is_the_named_one(side: float) -> None:
    found = judged(*told(0.2, (SLID_MM + side) * 1e-3), "carry")
    assert bool(lift_failure(found)) == (side > 0)


def test_a_table_that_never_sank_is_a_failure_and_no_motion_is_shown() -> None:
    log, truth = told(0.0, 0.0)
    assert "never lifted" in lift_failure(judged(log, truth, "carry"))
    held = MadeUpLog(JAMIA, TICKS, {0: "hold"})
    held.fields["contact"][:, 0] = 1.0
    held.fields["tension_goal"][:] = held.fields["tension"][:] = held.fields["tension_raw"][:] = 9.0
    held.fields["tip_force"][:] = 0.0
    assert np.isnan(summarise(held, JAMIA, truth, 0)["object_motion_mm"])  # type: ignore[arg-type]
    _, sinking = told(0.2, 0.0)
    assert not np.isnan(summarise(held, JAMIA, sinking, 0)["object_motion_mm"])  # type: ignore[arg-type]


def test_nothing_is_judged_where_nothing_can_sink_or_is_held() -> None:
    log, truth = told(0.2, 0.2)
    for found in (judged(log, truth), judged(log, truth, "elsewhere"), judged(log, None, "carry"),
                  judged(log, truth_of(JAMIA, TICKS), "carry")):  # fmt: skip
        assert np.isnan(found["table_sunk_mm"])
        assert lift_failure(found) == ""
