"""Figure of a run: mean joint angle, tensions and contact force of each digit, and lateness of the ticks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import HandMode
from handctl.digit_colours import colour_numbers
from handctl.hand.description import Hand
from handctl.log.read.reader import RunLog
from handctl.output_files import save_figure
from handctl.printing import printable_text
from handctl.report.run_summary import mean_angles
from handctl.report.truth_record import TruthRecord

DIGIT_COLOURS = ("#3b6fb6", "#d9822b", "#3c9d5d", "#b8436f", "#7a5fb5", "#8a8a2a", "#3a8f9c")
"""Colours of the digits: index, middle, ring, thumb, and others."""
COMMAND_COLOUR = "#444444"
PLANT_COLOUR = "#000000"
PHASE_MARK_COLOUR = "#999999"
FAULT_COLOUR = "#d01c1c"
"""Colour of fault marks.

The constants above are the colours of commands, of the simulated plant and of phase marks.
"""
TENDON_OPACITIES = (1.0, 0.65, 0.4)
"""Opacity of the first, second and third tendon of a digit."""
PASSIVE_PHASES = frozenset(mode.name.lower() for mode in HandMode)
"""Names of the phases before and after the time in which the hand is active."""
MARK_WIDTH_FRACTION = 0.038
"""Width that the name of a mark needs in a column of the figure, as a fraction of the column."""
LAYOUT_PAD_INCH = 0.12
"""Horizontal padding of the axes [inch].

When the layout is computed, the tick labels for the final height of the axes are not known. Wider
tick labels move the label of an axis by up to 0.05 inch to the left.
"""
MARK_HEIGHTS = (0.99, 0.72, 0.45)
"""Upper ends of the names of marks, as fractions of the height of the first row.

The name of a mark that would overlap the previous name is written lower. If no height is free, the
name is left out.
"""
ROW_LABELS = ("mean joint angle [deg]", "tendon tension [N]", "contact force [N]")
"""Label of each row of the figure."""

Array = NDArray[np.float64]


def digit_colours(hand: Hand) -> list[str]:
    """Return the colour of each digit.

    Digits with the same name have the same colour on every hand.
    """
    return [
        DIGIT_COLOURS[number % len(DIGIT_COLOURS)] for number in colour_numbers(hand.digit_names)
    ]


def draw_run(
    path: Path, log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int, title: str
) -> None:
    """Draw the figure of a run as PNG.

    Args:
        path: path of the file to write.
        log: log of the run.
        hand: hand of the run.
        truth: true values from the simulator, or None on hardware.
        offset_ns: time on the clock of the simulator at which the time of the run is 0 [ns].
        title: title of the figure.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    n = len(hand.digit)
    # In virtual time no tick is late, so the figure has no row for the lateness.
    has_lateness = bool(log.late_ns.any())
    layout = ConstrainedLayoutEngine(w_pad=LAYOUT_PAD_INCH)
    figure = Figure(figsize=(max(9.0, 2.6 + 2.6 * n), 7.6 + 1.4 * has_lateness), layout=layout)
    FigureCanvasAgg(figure)
    figure_grid = figure.add_gridspec(
        1 + has_lateness, 1, height_ratios=[8, 1.2][: 1 + has_lateness]
    )
    grid = figure_grid[0].subgridspec(3, n).subplots(sharex=True, sharey="row", squeeze=False)
    figure.suptitle(title)
    _draw_angles(grid[0], log, hand, truth, offset_ns)
    _draw_tensions(grid[1], log, hand, truth, offset_ns)
    _draw_forces(grid[2], log, hand, truth, offset_ns)
    lateness_axes = [figure.add_subplot(figure_grid[1])] if has_lateness else []
    for axes in lateness_axes:
        axes.plot(log.times, log.late_ns / 1e3, color="#666666", linewidth=0.6)
        axes.set(ylabel="lateness\nof a tick [us]", xlabel="time [s]")
    _add_titles_and_phases(grid, lateness_axes, log, hand)
    figure.legend(
        *_legend_entries(truth is not None),
        loc="outside lower center",
        ncols=4,
        fontsize=8,
        frameon=False,
    )
    save_figure(figure, path)


def _add_titles_and_phases(
    axes_grid: NDArray[Any], lateness_axes: list[Any], log: RunLog, hand: Hand
) -> None:
    """Add titles, grid lines and phase marks.

    The time axis shows only the interval in which the hand is active.
    """
    for column, name in zip(axes_grid.T, hand.digit_names, strict=True):
        column[0].set_title(name, fontsize=11, fontweight="bold")
        column[-1].set_xlabel("time [s]", fontsize=8)
    for row, label in zip(axes_grid, ROW_LABELS, strict=True):
        row[0].set_ylabel(label)
    are_prismatic = [
        bool(hand.mean_position_units(name).is_prismatic[0]) for name in hand.digit_names
    ]
    for d, axes in enumerate(axes_grid[0]):
        # Without separate labels, the label of the first digit would be the label of all digits.
        if d == 0 or len(set(are_prismatic)) > 1:
            axes.set_ylabel("mean joint position [mm]" if are_prismatic[d] else ROW_LABELS[0])
    for axes in (*axes_grid.flat, *lateness_axes):
        axes.grid(alpha=0.3)
        axes.margins(x=0)
        axes.tick_params(labelsize=8)
    torque_ticks = np.flatnonzero(np.isin(log.mode, (int(HandMode.ACTIVE), int(HandMode.RELAX))))
    if len(torque_ticks):
        start = max(0.0, log.times[torque_ticks[0]] - 0.2)
        end = log.times[torque_ticks[-1]] + 0.1
        for axes in (axes_grid[0, 0], *lateness_axes):
            axes.set_xlim(start, end)
        for row in (axes_grid[0], axes_grid[2]):
            _fit_value_axis(row, start, end)
    _mark_phases(axes_grid, log)


def _fit_value_axis(axes_row: Sequence[Any], start_s: float, end_s: float) -> None:
    """Limit the value axis of a row of plots to the values that occur while the hand is active.

    While the hand is inactive, joints without tendon tension can move far. Values from this time
    have no effect on the value axis.
    """
    lines = [line.get_data() for axes in axes_row for line in axes.lines]
    visible_values = np.concatenate([y[(x >= start_s) & (x <= end_s)] for x, y in lines])
    min_value = np.fmin.reduce(visible_values, initial=np.inf)
    max_value = np.fmax.reduce(visible_values, initial=-np.inf)
    if min_value < max_value:
        axes_row[0].set_ylim(
            min_value - 0.05 * (max_value - min_value), max_value + 0.05 * (max_value - min_value)
        )


def _legend_entries(truth: bool) -> tuple[list[Any], list[str]]:
    """Return the sample lines of the legend, and the meaning of each line as text."""
    from matplotlib.lines import Line2D

    samples_and_texts = [
        (
            Line2D([], [], color=DIGIT_COLOURS[0], linewidth=1.8),
            "estimate, for tensions and forces with its 1-sigma band",
        ),
        (Line2D([], [], color=COMMAND_COLOUR, linewidth=1.0, linestyle="--"), "command"),
    ]
    if truth:
        samples_and_texts.append(
            (
                Line2D([], [], color=PLANT_COLOUR, linewidth=0.8),
                "plant, for forces the sum of all contact forces",
            )
        )
    return [handle for handle, _ in samples_and_texts], [text for _, text in samples_and_texts]


def _draw_angles(
    axes_row: Sequence[Any], log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int
) -> None:
    """Draw the mean joint angle of each digit: estimate, command and true value."""
    factors = np.array([hand.mean_position_units(name).factor[0] for name in hand.digit_names])
    goal, estimate = (factors * mean_angles(hand, log.field(name)) for name in ("q_goal", "q"))
    true_angles = None
    if truth is not None:
        table = truth.interpolated_columns(
            [f"q/{joint}" for joint in hand.joints], log.t_ns + offset_ns
        )
        true_angles = factors * mean_angles(hand, table)
    for d, (axes, colour) in enumerate(zip(axes_row, digit_colours(hand), strict=True)):
        axes.plot(log.times, estimate[:, d], color=colour, linewidth=1.8)
        _draw_command_and_truth(
            axes, log, goal[:, d], None if true_angles is None else true_angles[:, d]
        )


def _draw_command_and_truth(
    axes: Any, log: RunLog, goal_values: Array | None, true_values: Array | None
) -> None:
    """Add two lines to a plot of an estimate: the command, and the true value from the simulator."""
    if true_values is not None:
        axes.plot(log.times, true_values, color=PLANT_COLOUR, linewidth=0.7)
    if goal_values is not None:
        axes.plot(log.times, goal_values, color=COMMAND_COLOUR, linewidth=1.0, linestyle="--")


def _draw_tensions(
    axes_row: Sequence[Any], log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int
) -> None:
    """Draw the tendon tensions of each digit: estimates, commands and true values."""
    estimate = log.field("tension")
    sigma = log.field("tension_sigma")
    goal = log.field("tension_goal")
    for axes, tendons, colour in zip(
        axes_row, hand.digit_tendons.values(), digit_colours(hand), strict=True
    ):
        names = hand.tendon_names[tendons]
        # TENDON_OPACITIES is repeated so that every tendon has an opacity, even if a digit has more
        # than three tendons.
        for opacity, i, name in zip(
            TENDON_OPACITIES * len(names), range(tendons.start, tendons.stop), names, strict=False
        ):
            axes.plot(
                log.times, estimate[:, i], color=colour, alpha=opacity, linewidth=1.2, label=name
            )
            lower_bound = estimate[:, i] - sigma[:, i]
            upper_bound = estimate[:, i] + sigma[:, i]
            axes.fill_between(
                log.times, lower_bound, upper_bound, color=colour, alpha=0.25, linewidth=0
            )
            true_tensions = (
                None
                if truth is None
                else truth.interpolated_column(f"tension/{name}", log.t_ns + offset_ns)
            )
            _draw_command_and_truth(axes, log, goal[:, i], true_tensions)
        if len(names) > 1:
            axes.legend(loc="upper left", fontsize=6, frameon=False)
    # If a load cell is wrong, the command and the true tension can be far above the estimated
    # tension.
    drawn_values = np.concatenate([line.get_ydata() for axes in axes_row for line in axes.lines])
    axes_row[0].set_ylim(-2, float(np.fmax.reduce(drawn_values, initial=9.0)) * 1.15)


def _draw_forces(
    axes_row: Sequence[Any], log: RunLog, hand: Hand, truth: TruthRecord | None, offset_ns: int
) -> None:
    """Draw the contact force on each digit: estimate and true value."""
    estimate = log.field("tip_force")
    sigma = log.field("tip_force_sigma")
    for d, (axes, name, colour) in enumerate(
        zip(axes_row, hand.digit_names, digit_colours(hand), strict=True)
    ):
        axes.plot(log.times, estimate[:, d], color=colour, linewidth=1.0)
        lower_bound = estimate[:, d] - sigma[:, d]
        upper_bound = estimate[:, d] + sigma[:, d]
        axes.fill_between(
            log.times, lower_bound, upper_bound, color=colour, alpha=0.25, linewidth=0
        )
        if truth is not None:
            # The truth file contains the three components of the contact force. The estimate
            # contains only the size of the contact force, without the direction.
            force_components = [
                truth.interpolated_column(f"contact_force/{name}/{axis}", log.t_ns + offset_ns)
                for axis in "xyz"
            ]
            _draw_command_and_truth(
                axes,
                log,
                None,
                np.asarray(
                    np.sqrt(sum(component**2 for component in force_components)), np.float64
                ),
            )


def _mark_phases(axes_grid: Any, log: RunLog) -> None:
    """Mark the start of each phase and the first fault by a line in every plot.

    The names of the phases and of the fault are written in the first row of plots.
    """
    error = ("error", "fault")
    faults = [event for event in log.events if (event.event.level, event.event.name) == error]
    # The name of a fault is placed in the figure before the names of phases. As a result, there is
    # always space for the name of the fault.
    time_marks = [
        (event.t_ns / 1e9, event.event.text.partition(" ")[0], FAULT_COLOUR) for event in faults[:1]
    ]
    time_marks += [
        (change.t_ns / 1e9, change.name, PHASE_MARK_COLOUR)
        for change in log.phases
        if change.name not in PASSIVE_PHASES
    ]
    positions = _mark_positions([t_s for t_s, _, _ in time_marks], axes_grid[0, 0].get_xlim())
    for (t_s, name, colour), position in zip(time_marks, positions, strict=True):
        for axes in axes_grid.flat:
            axes.axvline(t_s, color=colour, linewidth=0.6)
        if position:
            _write_mark_name(axes_grid[0], position, name, colour)


def _mark_positions(
    times_s: Sequence[float], time_limits_s: tuple[float, float]
) -> list[tuple[float, float] | None]:
    """Return where the name of each mark is written: the time [s] at the left end of the name, and the height.

    If there is no space for the name of a mark, the position is None.

    Args:
        times_s: time of each mark [s], the most important mark first.
        time_limits_s: begin and end of the time axis [s].
    """
    width = MARK_WIDTH_FRACTION * (time_limits_s[1] - time_limits_s[0])
    positions: list[tuple[float, float] | None] = []
    for t_s in times_s:
        # If a mark is near the end of the axis, the name is written to the left of the line that
        # marks the time.
        left_edge_s = t_s if t_s + width <= time_limits_s[1] else t_s - width
        occupied_heights = {
            position[1]
            for position in positions
            if position and abs(position[0] - left_edge_s) < width
        }
        free_heights = [height for height in MARK_HEIGHTS if height not in occupied_heights]
        is_inside = time_limits_s[0] <= t_s <= time_limits_s[1]
        positions.append((left_edge_s, free_heights[0]) if is_inside and free_heights else None)
    return positions


def _write_mark_name(
    axes_row: Sequence[Any], position: tuple[float, float], name: str, colour: str
) -> None:
    """Write the name of a time mark into each plot of a row of the figure.

    The argument ``position`` contains the time [s], and the height as a fraction of the plot.
    """
    for axes in axes_row:
        style = {
            "fontsize": 7,
            "color": FAULT_COLOUR if colour == FAULT_COLOUR else COMMAND_COLOUR,
            "rotation": 90,
            "va": "top",
        }
        transform = axes.get_xaxis_transform()
        axes.text(
            *position, f" {printable_text(name, 40)}", transform=transform, clip_on=True, **style
        )
