"""Judging a finished run: numbers, picture, and a table for a person."""

import shutil
from pathlib import Path
from typing import Any

from handctl.cli.plan import Plan
from handctl.cli.session import Outcome
from handctl.log.reader import RunLog
from handctl.report.figure import draw_run
from handctl.report.summary import summarise
from handctl.report.truth import read_truth


def judge(plan: Plan, outcome: Outcome, log: Path, truth_file: Path | None, picture: bool = True) -> dict[str, Any]:
    """Numbers of a run, with its picture beside the log.

    Args:
        plan: of the run.
        outcome: of the run.
        log: its file.
        truth_file: of the simulator, copied beside the log; None on hardware.
        picture: whether to draw.
    """
    if truth_file is not None:
        beside = log.with_suffix(".truth")
        if truth_file != beside:
            shutil.copyfile(truth_file, beside)
        truth_file = beside
    truth = read_truth(truth_file) if truth_file else None
    with RunLog(log) as record:
        result = summarise(record, plan.hand, truth, outcome.offset_ns)
        if picture:
            draw_run(
                log.with_suffix(".png"), record, plan.hand, truth, outcome.offset_ns, f"{plan.hand.name}: {log.name}"
            )
    stats = outcome.stats
    result |= {
        "missed": stats.missed,
        "frames_tx": stats.frames_tx,
        "frames_rx": stats.frames_rx,
        "frames_lost": lost_frames(outcome),
        "bus_load": max(plan.load),
        "log": str(log),
        "log_bytes": int(str(outcome.log["bytes"])),
        "log_complete": bool(outcome.log["complete"]),
        "picture": str(log.with_suffix(".png")) if picture else None,
        "truth": str(truth_file) if truth_file else None,
        "priority": str(outcome.priority) if outcome.priority else "lockstep",
        "failure": outcome.state.failure,
    }
    return result


def lost_frames(outcome: Outcome) -> int:
    """Frames that a bus refused or that sensors answered out of time."""
    return outcome.stats.refused + outcome.state.sensors.stale


def print_summary(result: dict[str, Any], plan: Plan) -> None:
    """The table that ends a run."""
    from rich.console import Console
    from rich.table import Table

    late = result["late_us"]
    rows = [
        ("ticks", f"{result['ticks']} at {result['rate_hz']:g} Hz"),
        ("missed ticks", f"{result['missed']}"),
        ("lateness p50 / p99.9 / max", f"{late['p50']:.0f} / {late['p99_9']:.0f} / {late['max']:.0f} us"),
        ("tracking error, free motion", _with(result["tracking_rmse_rad"], 57.29578, "deg rms", 2)),
        ("tension estimate against truth", _with(result["tension_rmse_n"], 1.0, "N rms", 2)),
        ("raw load cell against truth", _with(result["tension_raw_rmse_n"], 1.0, "N rms", 2)),
        ("tension while holding, error", _with(result["tension_hold_error_n"], 1.0, "N", 2)),
        ("object moved while held", _with(result["object_motion_mm"], 1.0, "mm", 3)),
        *_forces(result),
        ("bus load, worst case", f"{100 * result['bus_load']:.0f} %"),
        ("frames sent / received / lost", f"{result['frames_tx']} / {result['frames_rx']} / {result['frames_lost']}"),
        ("log", f"{result['log']} ({result['log_bytes'] / 1e6:.1f} MB)"),
        ("priority", result["priority"]),
    ]
    table = Table(title=f"{plan.hand.name}: {result['failure'] or 'done'}", show_header=False)
    for name, value in rows:
        table.add_row(name, value)
    console = Console()
    console.print(table)
    if result["picture"]:
        console.print(f"picture: {result['picture']}", highlight=False, soft_wrap=True)
    console.print(f"look at it: handctl view {result['log']}", highlight=False, soft_wrap=True)


def _with(value: float, scale: float, unit: str, digits: int) -> str:
    return "-" if value != value else f"{value * scale:.{digits}f} {unit}"


def _forces(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Tip-equivalent estimate beside the plant's contact force, per digit."""
    estimated, real = result["tip_equivalent_force_n"], result["contact_force_n"]
    rows = []
    for name, force in estimated.items():
        if force == force:
            beside = f", plant's contacts {real[name]:.1f} N" if name in real else ""
            rows.append((f"{name} tip-equivalent force", f"{force:.1f} N{beside}"))
    return rows
