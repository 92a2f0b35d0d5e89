"""Judging a finished run: numbers, picture, and a table for a person."""

import shutil
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from handctl.cli.plan import Plan
from handctl.cli.screen import screen
from handctl.cli.session import Outcome
from handctl.controller.setup import make_sensors
from handctl.controller.task import Hold, Task
from handctl.log.read.reader import RunLog
from handctl.report.figure import draw_run
from handctl.report.lift import judge_lift, lift_failure
from handctl.report.summary import angle_rows, summarise
from handctl.report.truth import Truth, read_truth


def judge(
    plan: Plan,
    outcome: Outcome,
    log: Path,
    truth_file: Path | None,
    picture: bool = True,
    task: Task | None = None,
) -> dict[str, Any]:
    """Numbers of a run, with its picture beside the log.

    A disk that became full under the run costs the picture, said in a line, and nothing else.

    Args:
        plan: of the run.
        outcome: of the run.
        log: its file.
        truth_file: of the simulator, copied beside the log; None on hardware.
        picture: whether to draw.
        task: that was carried out, if its grasp is to be judged: one that did not carry its object is a failure.
    """
    truth_file = _beside(log, truth_file) if truth_file else None
    truth = read_truth(truth_file) if truth_file else None
    with RunLog(log) as record:
        result = summarise(record, plan.hand, truth, outcome.offset_ns)
        result |= judge_lift(record, truth, outcome.offset_ns, _holds(task))
        drawn = _picture(plan, outcome, record, truth, log) if picture else None
    stats = outcome.stats
    result |= {
        "missed": stats.missed,
        "time_scale": plan.time_scale,
        "frames_tx": stats.frames_tx,
        "frames_rx": stats.frames_rx,
        "frames_late": outcome.state.sensors.stale,
        "frames_lost": lost_frames(plan, outcome),
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
    """Return the names of the phases in which a task holds something."""
    return {phase.name for phase in task.phase if isinstance(phase, Hold)} if task else set()


def _beside(log: Path, truth: Path) -> Path:
    """The truth beside the log, or where it is if there is no room."""
    beside = log.with_suffix(".truth")
    if truth == beside:
        return beside
    try:
        shutil.copyfile(truth, beside)
    except OSError as error:
        _left_out(beside, error)
        return truth
    return beside


def _picture(plan: Plan, outcome: Outcome, record: RunLog, truth: Truth | None, log: Path) -> Path | None:
    """The picture of the run; None if there is no room."""
    path = log.with_suffix(".png")
    try:
        draw_run(path, record, plan.hand, truth, outcome.offset_ns, f"{plan.hand.name}: {log.name}")
    except OSError as error:
        _left_out(path, error)
        return None
    return path


def _left_out(path: Path, error: OSError) -> None:
    """Say that a file beside the log could not be written; half of one is worth nothing."""
    with suppress(OSError):
        path.unlink()
    print(f"handctl: {path} is left out: {error.strerror or error}", file=sys.stderr)


def lost_frames(plan: Plan, outcome: Outcome) -> int:
    """Return how many frames a bus refused or the sensor node never sent; an answer after the next SYNC is late."""
    return outcome.stats.refused + make_sensors(plan.hand).lost(outcome.state.sensors)


def print_summary(result: dict[str, Any], plan: Plan) -> None:
    """The table that ends a run."""
    from rich.table import Table

    late = result["late_us"]
    rows = [
        ("ticks", f"{result['ticks']} at {result['rate_hz']:g} Hz{_slowed(result['time_scale'])}"),
        ("missed ticks", f"{result['missed']}"),
        ("lateness p50 / p99.9 / max", f"{late['p50']:.0f} / {late['p99_9']:.0f} / {late['max']:.0f} us"),
        ("tracking error, free motion", _with(result["tracking_rmse_rad"], 57.29578, "deg rms", 2)),
        ("tension estimate against truth", _with(result["tension_rmse_n"], 1.0, "N rms", 2)),
        ("raw load cell against truth", _with(result["tension_raw_rmse_n"], 1.0, "N rms", 2)),
        ("tension while holding, error", _with(result["tension_hold_error_n"], 1.0, "N", 2)),
        ("object moved while held", _with(result["object_motion_mm"], 1.0, "mm", 3)),
        *_lift(result),
        *angle_rows(result["joint_angles"]),
        *_forces(result),
        ("bus load, worst case", f"{100 * result['bus_load']:.0f} %"),
        ("frames sent / received", f"{result['frames_tx']} / {result['frames_rx']}"),
        ("frames late / lost", f"{result['frames_late']} / {result['frames_lost']}"),
        ("log", f"{result['log']} ({result['log_bytes'] / 1e6:.1f} MB)"),
        ("priority", result["priority"]),
    ]
    table = Table(title=f"{plan.hand.name}: {result['failure'] or 'done'}", show_header=False)
    for name, value in rows:
        table.add_row(name, value)
    console = screen()
    console.print(table)
    if result["picture"]:
        console.print(f"picture: {result['picture']}", soft_wrap=True)
    console.print(f"look at it: handctl view {result['log']}", soft_wrap=True)


def _slowed(scale: float) -> str:
    return "" if scale == 1 else f", at {scale:g} of real time"


def _with(value: float, scale: float, unit: str, digits: int) -> str:
    return "-" if value != value else f"{value * scale:.{digits}f} {unit}"


def _lift(result: dict[str, Any]) -> list[tuple[str, str]]:
    """How far the table sank, and how far the object moved in the hand meanwhile; nothing without such a table."""
    sunk, slid = result["table_sunk_mm"], result["object_slid_mm"]
    if sunk != sunk:
        return []
    return [("table sank / object moved then", f"{sunk:.0f} mm / {_with(slid, 1.0, 'mm', 3)}")]


def _forces(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Tip-equivalent estimate beside the plant's contact force, per digit."""
    estimated, real = result["tip_equivalent_force_n"], result["contact_force_n"]
    rows = []
    for name, force in estimated.items():
        if force == force:
            beside = f", plant's contacts {real[name]:.1f} N" if name in real else ""
            rows.append((f"{name} tip-equivalent force", f"{force:.1f} N{beside}"))
    return rows
