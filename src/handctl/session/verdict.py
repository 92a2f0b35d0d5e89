"""Verdict on a finished run: numbers and picture."""

import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

from handctl.controller.setup import make_sensors
from handctl.core.block import STALE
from handctl.log.read.reader import RunLog
from handctl.programs.task import Hold, Task
from handctl.report.frame_counts import frame_counts
from handctl.report.lift import judge_lift, lift_failure
from handctl.report.run_figure import draw_run
from handctl.report.summary import summarise
from handctl.report.truth import TruthRecord, read_truth
from handctl.session.notices import Tell
from handctl.session.plan import Plan
from handctl.session.run import Outcome


def judge(
    plan: Plan,
    outcome: Outcome,
    log: Path,
    truth_file: Path | None,
    picture: bool = True,
    task: Task | None = None,
) -> dict[str, Any]:
    """Compute the numbers of a run and draw its picture beside the log.

    If the disk is full, only the picture is left out, with a notice of one line.

    Args:
        plan: plan of the run.
        outcome: outcome of the run.
        log: log file of the run.
        truth_file: truth file of the simulator, copied beside the log, or None on hardware.
        picture: True to draw the picture.
        task: executed task, if its grasp is to be judged. A grasp that did not carry its object is a failure.
    """
    truth_file = _beside(log, truth_file, plan.tell) if truth_file else None
    truth = read_truth(truth_file) if truth_file else None
    with RunLog(log) as record:
        result = summarise(record, plan.hand, truth, outcome.offset_ns)
        result |= judge_lift(record, truth, outcome.offset_ns, _holds(task))
        silent = frame_counts(record, plan.hand).silent
        drawn = _picture(plan, outcome, record, truth, log) if picture else None
    stats = outcome.stats
    result |= {
        "missed": stats.missed,
        "time_scale": plan.time_scale,
        "frames_tx": stats.frames_tx,
        "frames_rx": stats.frames_rx,
        "frames_late": outcome.state.whole(STALE),
        "frames_lost": lost_frames(plan, outcome),
        "silent_ticks": silent,
        "bus_load": max(plan.load),
        "log": str(log),
        "log_bytes": int(str(outcome.log["bytes"])),
        "log_complete": bool(outcome.log["complete"]),
        "picture": str(drawn) if drawn else None,
        "truth": str(truth_file) if truth_file else None,
        "priority": str(outcome.priority) if outcome.priority else "lockstep",
        "failure": outcome.state.failure or lift_failure(result),
    }
    return result


def _holds(task: Task | None) -> set[str]:
    """Return the names of the phases in which a task holds an object."""
    return {phase.name for phase in task.phase if isinstance(phase, Hold)} if task else set()


def _beside(log: Path, truth: Path, tell: Tell) -> Path:
    """Copy the truth file beside the log and return its path. If the copy fails, return the original path."""
    beside = log.with_suffix(".truth")
    if truth == beside:
        return beside
    try:
        shutil.copyfile(truth, beside)
    except OSError as error:
        _left_out(beside, error, tell)
        return truth
    return beside


def _picture(plan: Plan, outcome: Outcome, record: RunLog, truth: TruthRecord | None, log: Path) -> Path | None:
    """Draw the picture of the run and return its path, or None if the file cannot be written."""
    path = log.with_suffix(".png")
    try:
        draw_run(path, record, plan.hand, truth, outcome.offset_ns, f"{plan.hand.name}: {log.name}")
    except OSError as error:
        _left_out(path, error, plan.tell)
        return None
    return path


def _left_out(path: Path, error: OSError, tell: Tell) -> None:
    """Delete a partly written file beside the log and notify the operator."""
    with suppress(OSError):
        path.unlink()
    tell(f"handctl: {path} is left out: {error.strerror or error}")


def lost_frames(plan: Plan, outcome: Outcome) -> int:
    """Count the frames that a bus refused or the sensor node never sent. A reply after the next SYNC is late."""
    return outcome.stats.refused + make_sensors(plan.hand).lost(*outcome.state.sensor_counts)
