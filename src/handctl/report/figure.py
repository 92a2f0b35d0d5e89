"""The picture of a run: angles, tensions, contact forces and lateness over time."""

from pathlib import Path
from typing import Any

import numpy as np

from handctl.controller.types import Mode
from handctl.hand.description import Hand
from handctl.log.reader import RunLog
from handctl.report.summary import mean_angles
from handctl.report.truth import Truth

COLOURS = ("#3b6fb6", "#d9822b", "#3c9d5d", "#b8436f", "#7a5fb5", "#8a8a2a")


def draw_run(path: Path, log: RunLog, hand: Hand, truth: Truth | None, offset_ns: int, title: str) -> None:
    """Write the picture as PNG.

    Args:
        path: file to write.
        log: of the run.
        hand: that ran.
        truth: of the simulator, or None.
        offset_ns: the run's t = 0 on the simulator's clock [ns].
        title: above the picture.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9.5), layout="constrained")
    FigureCanvasAgg(figure)
    angles, tensions, forces, late = figure.subplots(4, 1, sharex=True, height_ratios=[3, 3, 2, 1])
    figure.suptitle(title)
    _angles(angles, log, hand, truth, offset_ns)
    _tensions(tensions, log, hand, truth, offset_ns)
    _forces(forces, log, hand, truth, offset_ns)
    late.plot(log.times, log.late_ns / 1e3, color="#666666", linewidth=0.6)
    late.set(ylabel="lateness [us]", xlabel="time [s]")
    for axes in (angles, tensions, forces, late):
        axes.grid(alpha=0.3)
        axes.margins(x=0)
    _phases((angles, tensions, forces), log)
    acting = np.flatnonzero(np.isin(log.mode, (int(Mode.ACTIVE), int(Mode.RELAX))))
    if len(acting):
        late.set_xlim(max(0.0, log.times[acting[0]] - 0.2), log.times[acting[-1]] + 0.1)
    figure.savefig(path, dpi=110)


def _angles(axes: Any, log: RunLog, hand: Hand, truth: Truth | None, offset_ns: int) -> None:
    goal, estimate = (np.degrees(mean_angles(hand, log.field(name))) for name in ("q_goal", "q"))
    real = None
    if truth is not None:
        table = truth.table([f"q/{joint}" for joint in hand.joints], log.t_ns + offset_ns)
        real = np.degrees(mean_angles(hand, table))
    for d, name in enumerate(hand.digit_names):
        colour = COLOURS[d % len(COLOURS)]
        axes.plot(log.times, estimate[:, d], color=colour, linewidth=1.4, label=name)
        axes.plot(log.times, goal[:, d], color=colour, linewidth=0.9, linestyle="--")
        if real is not None:
            axes.plot(log.times, real[:, d], color="black", linewidth=0.6, alpha=0.6)
    axes.set(ylabel="mean joint angle [deg]")
    axes.set_title("solid: estimate, dashed: command" + (", black: plant" if real is not None else ""), fontsize=9)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _tensions(axes: Any, log: RunLog, hand: Hand, truth: Truth | None, offset_ns: int) -> None:
    estimate, sigma, goal = log.field("tension"), log.field("tension_sigma"), log.field("tension_goal")
    for i, name in enumerate(hand.tendon_names):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(log.times, estimate[:, i], color=colour, linewidth=1.0, label=name)
        low, high = estimate[:, i] - sigma[:, i], estimate[:, i] + sigma[:, i]
        axes.fill_between(log.times, low, high, color=colour, alpha=0.25, linewidth=0)
        axes.plot(log.times, goal[:, i], color=colour, linewidth=0.9, linestyle="--")
        if truth is not None:
            axes.plot(
                log.times, truth.at(f"tension/{name}", log.t_ns + offset_ns), color="black", linewidth=0.5, alpha=0.6
            )
    axes.set(ylabel="tension [N]", ylim=(-2, float(np.fmax.reduce(estimate, axis=None, initial=9.0)) * 1.15))
    axes.set_title("estimate with its 1-sigma band, dashed: command" + (", black: plant" if truth else ""), fontsize=9)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _forces(axes: Any, log: RunLog, hand: Hand, truth: Truth | None, offset_ns: int) -> None:
    estimate = log.field("tip_force")
    for d, name in enumerate(hand.digit_names):
        colour = COLOURS[d % len(COLOURS)]
        axes.plot(log.times, estimate[:, d], color=colour, linewidth=1.0, label=name)
        if truth is not None:
            parts = [truth.at(f"contact_force/{name}/{axis}", log.t_ns + offset_ns) for axis in "xyz"]
            axes.plot(log.times, np.sqrt(sum(part**2 for part in parts)), color=colour, linewidth=0.8, linestyle=":")
    axes.set(ylabel="contact force [N]")
    axes.set_title(
        "solid: tip-equivalent estimate" + (", dotted: sum of contacts in the plant" if truth else ""), fontsize=9
    )


QUIET = frozenset(mode.name.lower() for mode in Mode)
"""Names of phases before and after the hand acts."""


def _phases(rows: Any, log: RunLog) -> None:
    """Where each phase of the program begins."""
    for change in log.phases:
        if change.name in QUIET:
            continue
        for row, axes in enumerate(rows):
            axes.axvline(change.t_ns / 1e9, color="#999999", linewidth=0.6)
            if row == 0:
                place = {"rotation": 90, "va": "top", "transform": axes.get_xaxis_transform()}
                axes.text(change.t_ns / 1e9, 0.98, f" {change.name}", fontsize=8, color="#555555", **place)
