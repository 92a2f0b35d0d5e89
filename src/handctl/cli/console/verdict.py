"""Table of the results of a run, printed at the end of the run."""

from typing import Any

from handctl.cli.console.rich_console import rich_console
from handctl.report.run_summary import angle_rows, tracking_text
from handctl.session.run_plan import RunPlan


def print_summary(run_result: dict[str, Any], plan: RunPlan) -> None:
    """Print the table of results of a finished run."""
    from rich.table import Table

    lateness_us = run_result["late_us"]
    rows = [
        (
            "ticks",
            f"{run_result['ticks']} at {run_result['rate_hz']:g} Hz{_time_scale_text(run_result['time_scale'])}",
        ),
        ("missed ticks", f"{run_result['missed']}"),
        *_clock_text(run_result),
        (
            "lateness p50 / p99.9 / max",
            f"{lateness_us['p50']:.0f} / {lateness_us['p99_9']:.0f} / {lateness_us['max']:.0f} us",
        ),
        (
            "tracking error, free motion",
            _value_with_unit(run_result["tracking_rmse_rad"], *tracking_text(run_result), 2),
        ),
        (
            "tension estimate against truth",
            _value_with_unit(run_result["tension_rmse_n"], 1.0, "N rms", 2),
        ),
        (
            "raw load cell against truth",
            _value_with_unit(run_result["tension_raw_rmse_n"], 1.0, "N rms", 2),
        ),
        (
            "tension while holding, error",
            _value_with_unit(run_result["tension_hold_error_n"], 1.0, "N", 2),
        ),
        ("object moved while held", _value_with_unit(run_result["object_motion_mm"], 1.0, "mm", 3)),
        *_lift_text(run_result),
        *angle_rows(run_result["joint_angles"]),
        *_forces_text(run_result),
        ("bus load, worst case", f"{100 * run_result['bus_load']:.0f} %"),
        ("frames sent / received", f"{run_result['frames_tx']} / {run_result['frames_rx']}"),
        (
            "frames late / lost",
            f"{run_result['frames_late']} / {run_result['frames_lost']}{_no_reply_text(run_result['silent_ticks'])}",
        ),
        ("log", f"{run_result['log']} ({run_result['log_bytes'] / 1e6:.1f} MB)"),
        ("priority", run_result["priority"]),
    ]
    table = Table(title=f"{plan.hand.name}: {run_result['failure'] or 'done'}", show_header=False)
    for name, value in rows:
        table.add_row(name, value)
    console = rich_console()
    console.print(table)
    if run_result["picture"]:
        console.print(f"picture: {run_result['picture']}", soft_wrap=True)
    console.print(f"view the run: handctl view {run_result['log']}", soft_wrap=True)


def _no_reply_text(silent_ticks: int) -> str:
    """Return a text with the number of ticks in which no node answered.

    Ticks in which no node answered can explain why frames were late.
    """
    return (
        f", bus silent for {silent_ticks} tick{'s' if silent_ticks > 1 else ''}"
        if silent_ticks
        else ""
    )


def _clock_text(run_result: dict[str, Any]) -> list[tuple[str, str]]:
    """Return a table row with the total time for which the simulated clock waited for a slow machine.

    If the clock never waited, return no row.
    """
    if not run_result["clock_pauses"]:
        return []
    simulated_s = run_result["ticks"] / run_result["rate_hz"]
    times = "once" if run_result["clock_pauses"] == 1 else f"{run_result['clock_pauses']} times"
    return [
        (
            "clock paused for this machine",
            f"{times}, {run_result['clock_paused_s']:.3f} s in {simulated_s:.1f} s",
        )
    ]


def _time_scale_text(scale: float) -> str:
    return "" if scale == 1 else f", at {scale:g} of real time"


def _value_with_unit(value: float, display_factor: float, unit: str, digits: int) -> str:
    return "-" if value != value else f"{value * display_factor:.{digits}f} {unit}"


def _lift_text(run_result: dict[str, Any]) -> list[tuple[str, str]]:
    """Return a row of results that states how far the support of the object sank, and how far the object then moved.

    If the support did not sink, return an empty list.
    """
    table_sunk_mm = run_result["table_sunk_mm"]
    object_slid_mm = run_result["object_slid_mm"]
    if table_sunk_mm != table_sunk_mm:
        return []
    return [
        (
            "table sank / object moved then",
            f"{table_sunk_mm:.0f} mm / {_value_with_unit(object_slid_mm, 1.0, 'mm', 3)}",
        )
    ]


def _forces_text(run_result: dict[str, Any]) -> list[tuple[str, str]]:
    """Return a table row for each digit, with its estimated tip force and its simulated contact force."""
    estimated = run_result["tip_equivalent_force_n"]
    true_forces = run_result["contact_force_n"]
    rows = []
    for name, force in estimated.items():
        if force == force:
            truth_text = (
                f", plant's contacts {true_forces[name]:.1f} N" if name in true_forces else ""
            )
            rows.append((f"{name} tip-equivalent force", f"{force:.1f} N{truth_text}"))
    return rows
