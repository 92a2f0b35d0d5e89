"""Judgement of a finished run, with performance numbers and a picture."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from handctl.controller.run_setup import make_sensors
from handctl.core.state_block import STALE_FRAME_COUNT
from handctl.log.read.reader import RunLog
from handctl.programs.task import HoldPhase, Task
from handctl.report.frame_counts import frame_counts
from handctl.report.lift_judgement import judge_lift, lift_failure
from handctl.report.run_figure import draw_run
from handctl.report.run_summary import summarise_run
from handctl.report.truth_record import TruthRecord, copy_truth, read_truth, truth_file_path
from handctl.session.notices import NoticeCallback
from handctl.session.run import RunOutcome
from handctl.session.run_plan import RunPlan

TRUE_VALUES_MARGIN_NS = 1_000_000_000
"""Time before and after a run for which the true values are kept [ns]."""


def judge_run(
    plan: RunPlan,
    outcome: RunOutcome,
    log: Path,
    truth_file: Path | None,
    draws_picture: bool = True,
    task: Task | None = None,
) -> dict[str, Any]:
    """Compute numbers that describe the performance of a run, and draw a picture next to the log.

    If the picture cannot be written, for example because the disk is full, a notice informs the
    operator about the missing picture.

    Args:
        plan: plan of the run.
        outcome: outcome of the run.
        log: log file of the run.
        truth_file: truth file of the simulator, which is copied to the folder of the log. The value
            is None for a real hand.
        draws_picture: True to draw the picture.
        task: task that the run has executed. If ``task`` is given, the grasp of the task is judged.
            A run with a task counts as failed if the hand did not hold the object.
    """
    with RunLog(log) as record:
        if truth_file:
            times = (
                record.t_ns[[0, -1]] + outcome.offset_ns if len(record) else np.zeros(2, np.int64)
            )
            truth_file = _copy_truth(log, truth_file, times.tolist(), plan.show_notice)
        truth = read_truth(truth_file) if truth_file else None
        result = summarise_run(record, plan.hand, truth, outcome.offset_ns)
        result |= judge_lift(record, truth, outcome.offset_ns, _hold_phases(task))
        silent_ticks = frame_counts(record, plan.hand).silent_ticks
        drawn_picture = _draw_picture(plan, outcome, record, truth, log) if draws_picture else None
    stats = outcome.loop_stats
    result |= {
        "missed": stats.missed_ticks,
        "clock_pauses": outcome.pause_count,
        "clock_paused_s": outcome.paused_ns / 1e9,
        "time_scale": plan.time_scale,
        "frames_tx": stats.frames_tx,
        "frames_rx": stats.frames_rx,
        "frames_late": outcome.state.run_integers[STALE_FRAME_COUNT],
        "frames_lost": lost_frames(plan, outcome),
        "silent_ticks": silent_ticks,
        "bus_load": max(plan.bus_loads),
        "log": str(log),
        "log_bytes": int(str(outcome.log_summary["bytes"])),
        "log_complete": bool(outcome.log_summary["complete"]),
        "picture": str(drawn_picture) if drawn_picture else None,
        "truth": str(truth_file) if truth_file else None,
        "priority": str(outcome.priority) if outcome.priority else "lockstep",
        "failure": outcome.state.failure or lift_failure(result),
    }
    return result


def _hold_phases(task: Task | None) -> set[str]:
    """Return the names of the phases of a task in which the hand holds an object."""
    return {phase.name for phase in task.phase if isinstance(phase, HoldPhase)} if task else set()


def _copy_truth(
    log: Path, truth: Path, times_ns: Sequence[int], show_notice: NoticeCallback
) -> Path | None:
    """Copy the true values of the run to the folder of the log, and return the path of the copy.

    If the file cannot be copied, return the original path. If the truth file has no values of the
    run, return None.

    Args:
        log: log of the run.
        truth: truth file of the simulator.
        times_ns: first and last time of the run on the simulator's clock [ns].
        show_notice: function that shows a notice to the operator.
    """
    truth_path = truth_file_path(log)
    if truth == truth_path:
        return truth_path
    start_ns, end_ns = times_ns[0] - TRUE_VALUES_MARGIN_NS, times_ns[1] + TRUE_VALUES_MARGIN_NS
    try:
        if not copy_truth(truth, truth_path, start_ns, end_ns):
            return None
    except OSError as error:
        _delete_incomplete_file(truth_path, error, show_notice)
        return truth
    return truth_path


def _draw_picture(
    plan: RunPlan, outcome: RunOutcome, record: RunLog, truth: TruthRecord | None, log: Path
) -> Path | None:
    """Draw the picture of a run, and return the path of the picture.

    If the picture cannot be written, return None.
    """
    path = log.with_suffix(".png")
    try:
        draw_run(path, record, plan.hand, truth, outcome.offset_ns, f"{plan.hand.name}: {log.name}")
    except OSError as error:
        _delete_incomplete_file(path, error, plan.show_notice)
        return None
    return path


def _delete_incomplete_file(path: Path, error: OSError, show_notice: NoticeCallback) -> None:
    """Delete an incomplete truth file or picture next to the log, and tell the operator that this file is missing."""
    with suppress(OSError):
        path.unlink()
    show_notice(f"handctl: {path} is left out: {error.strerror or error}")


def lost_frames(plan: RunPlan, outcome: RunOutcome) -> int:
    """Return the number of frames that were lost in a run.

    A frame is lost if a bus refused to send it, or if a frame of the sensor node never arrived. A
    reply that arrives after the next SYNC frame counts as late, not as lost.
    """
    return outcome.loop_stats.refused_frames + make_sensors(plan.hand).lost_frame_count(
        *outcome.state.sensor_counts
    )
