"""Judgement of a grasp in a scene where the table under the object sinks.

The grasp succeeds if the hand still holds the object at the end of the last hold phase.
"""

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.log.read.reader import RunLog
from handctl.report.truth_record import TruthRecord

TABLE_DEPTH_COLUMN = "support"
"""Column of the simulator's truth file with the distance by which the table has sunk [m].

Only the truth files of scenes with a sinking table have this column.
"""
MAX_SLIP_MM = 10.0
"""Largest motion of an object in the hand at which the object counts as held [mm].

Objects that the hand holds in the demo move by 3 mm at most.
"""
FALL_MM = 500.0
"""Motion of an object in the hand above which the object counts as fallen [mm]."""


def judge_lift(
    log: RunLog, truth: TruthRecord | None, offset_ns: int, hold_phases: Collection[str]
) -> dict[str, Any]:
    """Return two distances: how far the table sank, and how far the object moved.

    The distances of table and object are measured while the hand holds the object.

    Args:
        log: log of the run.
        truth: true values from the simulator, or None on hardware.
        offset_ns: time on the clock of the simulator at which the time of the run is 0 [ns].
        hold_phases: names of the hold phases of the task.

    Returns:
        `table_sunk_mm`: distance by which the table has sunk at the end of the last hold.
        `object_slid_mm`: distance that the object moved from the start of the sinking to the end of
        the last hold. Both distances are NaN if the table never sank or if there was no hold.
        `digit_forces_N`: largest contact force on each digit during the hold, by the name of the
        digit.
    """
    nan_result: dict[str, Any] = dict.fromkeys(("table_sunk_mm", "object_slid_mm"), float("nan"))
    nan_result["digit_forces_N"] = {}
    t_ns = _hold_times(log, hold_phases) + offset_ns
    if (
        truth is None
        or not truth.has_column(TABLE_DEPTH_COLUMN)
        or not len(t_ns)
        or not truth.contains_any_time(t_ns)
    ):
        return nan_result
    is_inside = (truth.t_ns >= t_ns[0]) & (truth.t_ns <= t_ns[-1])
    table_depths = truth.values[is_inside, truth.columns.index(TABLE_DEPTH_COLUMN)]
    positions = truth.interpolated_columns(
        ["object/x", "object/y", "object/z"], truth.t_ns[is_inside]
    )[table_depths > 0.0]
    slip_distance_mm = float("nan")
    if len(positions):
        slip_distance_mm = float(np.linalg.norm(positions - positions[0], axis=1).max() * 1e3)
    return {
        "table_sunk_mm": float(table_depths[-1] * 1e3),
        "object_slid_mm": slip_distance_mm,
        "digit_forces_N": _digit_forces(truth, is_inside),
    }


def _digit_forces(truth: TruthRecord, is_inside: NDArray[np.bool_]) -> dict[str, float]:
    """Return the largest contact force on each digit in the selected rows of a truth file [N]."""
    names = [
        column.split("/")[1]
        for column in truth.columns
        if column.startswith("contact_force/") and column.endswith("/x")
    ]
    forces = {}
    for name in names:
        columns = [truth.columns.index(f"contact_force/{name}/{axis}") for axis in "xyz"]
        components = truth.values[is_inside][:, columns]
        forces[name] = float(np.linalg.norm(components, axis=1).max(initial=0.0))
    return forces


def _hold_times(log: RunLog, hold_phases: Collection[str]) -> Any:
    """Return the times [ns] of the ticks from the start of the first hold phase to the end of the last hold phase."""
    phase_changes = log.phases
    end_ticks = (
        [*[change.k for change in phase_changes[1:]], int(log.k[-1]) + 1] if phase_changes else []
    )
    phases_with_end_ticks = zip(phase_changes, end_ticks, strict=True)
    hold_spans = [
        (change.k, end) for change, end in phases_with_end_ticks if change.name in hold_phases
    ]
    if not hold_spans:
        return log.t_ns[:0]
    return log.t_ns[(log.k >= hold_spans[0][0]) & (log.k < hold_spans[-1][1])]


def lift_failure(lift_result: dict[str, Any]) -> str:
    """Return the reason why a grasp failed. The text is empty if the grasp succeeded.

    The text is also empty if the scene had no object.

    Args:
        lift_result: result of `judge_lift`.
    """
    table_sunk_mm = lift_result["table_sunk_mm"]
    object_slid_mm = lift_result["object_slid_mm"]
    if table_sunk_mm == 0.0:
        forces_text = ", ".join(
            f"{name} {force:.1f} N" for name, force in lift_result["digit_forces_N"].items()
        )
        return (
            "the object was never lifted: the table sinks only if digits press on the object from opposite sides; "
            f"largest contact force on each digit: {forces_text}"
        )
    if object_slid_mm > FALL_MM:
        return f"the object fell out of the hand while the table sank {table_sunk_mm:.0f} mm"
    if object_slid_mm > MAX_SLIP_MM:
        return f"the object was not held: it moved {object_slid_mm:.0f} mm while the table sank {table_sunk_mm:.0f} mm"
    return ""
