"""Draw the plots of simulated runs.

The plots show the tension estimate, a snapped tendon, tip forces, a replay of a run, and the CAN
frames of a tick.
"""

from pathlib import Path
from typing import Any

import numpy as np

from handctl.controller.bus_load import bus_loads
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import load_hand
from tools.figures import runs
from tools.figures.style import (
    BLOCK_COLOURS,
    COMMAND_COLOUR,
    DIGIT_COLOURS,
    ESTIMATE_COLOUR,
    FAULT_COLOUR,
    INK_COLOUR,
    RAW_COLOUR,
    TRUTH_COLOUR,
    new_figure,
)

POINTS_LIMIT = 1500
"""Number of points to which a long curve in an SVG is reduced.

A curve can have up to twice ``POINTS_LIMIT`` points.
"""


def thinned_curves(t: Any, *curves: Any) -> tuple[Any, ...]:
    """Return every n-th point of each curve.

    A long curve keeps at least POINTS_LIMIT points, but fewer than twice as many.
    """
    step = max(1, len(t) // POINTS_LIMIT)
    return tuple(values[::step] for values in (t, *curves))


def estimate_plot(folder: Path) -> Any:
    """Plot three tensions: raw load cell, estimate with its uncertainty, and true tension.

    The two panels of the plot show a motion and a contact.
    """
    log, truth, _ = runs.grasp_run(folder)
    offset = int(log.header.metadata.get("truth_offset_ns", "0"))
    true_tension = truth.interpolated_column("tension/index_tendon", log.t_ns + offset)
    raw, mean, sigma = (
        log.field(name)[:, 0] for name in ("tension_raw", "tension", "tension_sigma")
    )
    figure = new_figure(8.6, 3.6)
    left_axes, right_axes = figure.subplots(1, 2)
    starts = {change.name: change.t_ns * 1e-9 for change in log.phases}
    spans = ((left_axes, starts["preshape"], starts["preshape"] + 0.9, "free motion"),
             (right_axes, starts["hold"] + 0.15, starts["hold"] + 0.75, "a hold begins"))  # fmt: skip
    for axes, start_s, end_s, title in spans:
        is_shown = (log.times >= start_s) & (log.times <= end_s)
        t = log.times[is_shown]
        axes.plot(t, raw[is_shown], ".", color=RAW_COLOUR, markersize=3, label="raw load cell")
        axes.fill_between(t, (mean - 2 * sigma)[is_shown], (mean + 2 * sigma)[is_shown],
                          color=ESTIMATE_COLOUR, alpha=0.2, linewidth=0,
                          label="estimate, two sigma")  # fmt: skip
        axes.plot(t, mean[is_shown], color=ESTIMATE_COLOUR, label="estimate")
        axes.plot(
            t, true_tension[is_shown], color=TRUTH_COLOUR, linewidth=0.9, label="truth of the plant"
        )
        axes.set(title=f"index tendon, {title}", xlabel="time [s]")
        axes.margins(x=0)
    left_axes.set_ylabel("tension [N]")
    left_axes.legend(loc="upper left")
    return figure


def snapped_tendon(folder: Path) -> Any:
    """Draw the tension, the torque and the mode before and after a tendon snaps."""
    del folder
    run = runs.snap_run()
    ms = run.t * 1e3
    figure = new_figure(8.6, 4.6)
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1.1))
    for n, (name, colour) in enumerate(DIGIT_COLOURS.items()):
        top.plot(ms, run.values["true_tension"][:, n], color=colour, label=name)
        middle.plot(ms, run.values["motor_torque_goal"][:, n] * 1e3, color=colour)
    top.plot(
        ms,
        run.values["tension"][:, 0],
        color=DIGIT_COLOURS["index"],
        linestyle="--",
        linewidth=0.9,
        label="index, estimate",
    )
    top.set_ylabel("true tension [N]")
    top.legend(loc="center left")
    middle.set_ylabel("torque command\n[mN m]")
    modes = np.array([int(mode) for mode in run.mode])
    for mode in np.unique(modes):
        times_of_mode = ms[modes == mode]
        length_ms = times_of_mode[-1] - times_of_mode[0] + 2.0
        colour = BLOCK_COLOURS["host" if mode == HandMode.ACTIVE else "safety"]
        bottom.barh(
            0,
            length_ms,
            left=times_of_mode[0],
            color=colour,
            edgecolor=INK_COLOUR,
            linewidth=0.6,
            height=0.8,
        )
        bottom.text(times_of_mode[0] + length_ms / 2.0, 0, HandMode(mode).name, ha="center", va="center",
                    color=INK_COLOUR, fontsize=7.5 if length_ms > 10.0 else 5.5,
                    rotation=0.0 if length_ms > 10.0 else 90.0)  # fmt: skip
    bottom.set(yticks=[], ylabel="mode", xlabel="time after the snap [ms]")
    bottom.grid(visible=False)
    reports = [(when, text) for when, text in run.events if text.startswith(("T01", "T02"))][:1]
    for axes in (top, middle, bottom):
        axes.axvline(0.0, color=FAULT_COLOUR, linewidth=1.0)
        axes.margins(x=0)
        for when, _ in reports:
            axes.axvline(when * 1e3, color=FAULT_COLOUR, linewidth=1.0, linestyle=":")
    for when, text in reports:
        middle.text(
            when * 1e3 + 2.0,
            middle.get_ylim()[1] * 0.9,
            text.split(":")[0],
            color=FAULT_COLOUR,
            fontsize=8,
            va="top",
        )
    top.set_title("the index tendon snaps in a grasp")
    return figure


def tip_force(folder: Path) -> Any:
    """Plot the commanded, the estimated and the true tip force of each digit.

    One row of panels shows forces on a wall, and the other row shows forces in a grasp.
    """
    del folder
    figure = new_figure(8.6, 5.8)
    grid = figure.subplots(2, 4, sharey="row")
    thumb = [3 * force for force in runs.GRIP_COMMANDS_N]
    commands = [runs.TIP_COMMANDS_N] * 4, [runs.GRIP_COMMANDS_N] * 3 + [thumb]
    for row, run, commanded in zip(
        grid, (runs.tip_on_wall(), runs.tip_in_grasp()), commands, strict=True
    ):
        _draw_tip_forces(row, run, commanded)
    grid[0, 0].set_ylabel("on a wall:\nforce at the tip [N]")
    grid[1, 0].set_ylabel("in a held grasp:\ncontact force of the digit [N]")
    for axes, name in zip(grid[0], DIGIT_COLOURS, strict=True):
        axes.set_title(name)
    for axes in grid[1]:
        axes.set_xlabel("time [s]")
    grid[0, 0].legend(loc="upper left")
    return figure


def _draw_tip_forces(digit_axes: Any, run: runs.RunRecording, commanded_forces: Any) -> None:
    """Draw the tip forces of each digit in a separate panel.

    Args:
        digit_axes: axes of the digits.
        run: recording of a run. The phases of the run with a constant commanded force are named 0,
            1 and so on.
        commanded_forces: commanded tip force of each phase with a constant force, and of each digit
            [N].
    """
    phases = np.array(run.phase)
    is_shown = run.t >= run.t[phases == "0"][0] - 0.4
    for n, (axes, colour) in enumerate(zip(digit_axes, DIGIT_COLOURS.values(), strict=True)):
        command = np.full(len(run.t), np.nan)
        for i, force in enumerate(commanded_forces[n]):
            command[phases == str(i)] = force
        axes.plot(
            run.t[is_shown],
            command[is_shown],
            color=COMMAND_COLOUR,
            linestyle="--",
            label="command",
        )
        axes.plot(
            run.t[is_shown],
            run.values["tip_force"][is_shown, n],
            color=colour,
            linewidth=0.9,
            label="estimate",
        )
        axes.plot(
            run.t[is_shown],
            run.values["true_contact"][is_shown, n],
            color=TRUTH_COLOUR,
            linewidth=0.9,
            label="truth of the plant",
        )
        axes.margins(x=0)


def replay_plot(folder: Path) -> Any:
    """Plot the angles and tensions of a grasp and of its replay.

    In the replay, the simulated hand has other sensor noise.
    """
    log, _, _ = runs.grasp_run(folder)
    replay = runs.replay_run(folder)
    start, end = runs.recording_interval(log)
    playback_start = replay.t[replay.phase.index("playback")]
    figure = new_figure(8.6, 4.4)
    top, bottom = figure.subplots(2, 1, sharex=True)
    is_in_playback = (log.times >= start) & (log.times <= end)
    is_compared_time = (replay.t >= playback_start) & (replay.t <= playback_start + end - start)
    joints = {"index": slice(0, 3), "thumb": slice(9, 11)}
    for n, name in ((0, "index"), (3, "thumb")):
        recorded_angles = np.degrees(log.field("q")[is_in_playback, joints[name]].mean(axis=1))
        repeated_angles = np.degrees(
            replay.values["q"][is_compared_time, joints[name]].mean(axis=1)
        )
        for axes, recorded_values, repeated_values in (
            (top, recorded_angles, repeated_angles),
            (
                bottom,
                log.field("tension")[is_in_playback, n],
                replay.values["tension"][is_compared_time, n],
            ),
        ):
            axes.plot(
                *thinned_curves(log.times[is_in_playback] - start, recorded_values),
                color=DIGIT_COLOURS[name],
                alpha=0.45,
                linewidth=3,
                label=f"{name}, recorded",
            )
            axes.plot(
                *thinned_curves(replay.t[is_compared_time] - playback_start, repeated_values),
                color=DIGIT_COLOURS[name],
                linewidth=1.0,
                label=f"{name}, replayed",
            )
    top.set(
        ylabel="mean joint angle [deg]",
        title="a recorded grasp, and its replay on a hand with other noise",
    )
    top.legend(ncols=2)
    bottom.set(ylabel="tendon tension [N]", xlabel="time [s]")
    bottom.margins(x=0)
    return figure


def bus_tick(folder: Path) -> Any:
    """Plot the frames of one tick on the bus.

    The length of a bar is the longest time that the frame of the bar can take.
    """
    del folder
    (load,) = bus_loads(load_hand("jamia"))
    rows = [row for row in load.rows if row.frames_per_tick >= 1.0]
    figure = new_figure(8.6, 2.9)
    axes = figure.add_subplot()
    lanes = {"host": 2, "drives": 1, "sensor node": 0}
    # The host sends its frames in the order of its queue. Among waiting replies, the frame with the
    # lowest identifier is sent first.
    commands = [
        ("host", "SYNC", "SYNC", INK_COLOUR),
        *(("host", f"{name}_motor", name, DIGIT_COLOURS[name]) for name in DIGIT_COLOURS),
    ]
    reply_bars = [
        *(("drives", f"{name}_motor", name, DIGIT_COLOURS[name]) for name in DIGIT_COLOURS),
        ("sensor node", "tensions", "tensions", INK_COLOUR),
    ]
    at = 0.0
    for lane, message_name, label, colour in [*commands, *reply_bars]:
        us = 1e6 * next(row.frame_s for row in rows if row.sender == message_name)
        axes.barh(lanes[lane], us - 6.0, left=at, color=colour, height=0.55)
        # Write the label of a short frame vertically.
        label_rotation_deg = 90.0 if us < 100.0 else 0.0
        axes.text(at + us / 2.0 - 3.0, lanes[lane], label, ha="center", va="center", color="white", fontsize=7,
                  rotation=label_rotation_deg)  # fmt: skip
        at += us
    axes.axvline(2000.0, color=FAULT_COLOUR, linewidth=1.0)
    axes.text(1990.0, 2.4, "next tick", ha="right", color=FAULT_COLOUR, fontsize=8)
    axes.axvspan(at, 2000.0, color="#eef3f7", zorder=0)
    text = f"free: {2000.0 - at:.0f} us\nfor read-backs, retries,\nthe next computation"
    axes.text(
        (at + 2000.0) / 2.0, 1.0, text, ha="center", va="center", fontsize=8, color=INK_COLOUR
    )
    axes.set(
        yticks=list(lanes.values()), yticklabels=list(lanes), xlim=(0.0, 2000.0), ylim=(-0.5, 2.7)
    )
    axes.set(xlabel="time on the wire [us]",
             title="one tick of jamia at 500 Hz, 1 Mbit/s: SYNC, four commands, four replies, tensions")  # fmt: skip
    axes.grid(visible=False, axis="y")
    return figure
