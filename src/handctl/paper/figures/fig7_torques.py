"""Fig. 7 of the paper: components of the torque that closes a digit.

A second figure shows the torque T_1 of Eq. 10, computed from the printed and from the corrected
equation.
"""

from typing import Any

import numpy as np

from handctl.paper.figures.style import BLUE, GREEN, GREY, ORANGE, PURPLE, RED
from handctl.paper.model.motion import (
    CLOSED_JOINT_ANGLE_DEG,
    CLOSING_DURATIONS_S,
    TORQUE_CAUSES,
    closing_torque_t1,
    closing_torques,
)

TORQUES_FIGURE_SIZE_IN = (9.6, 9.0)
EQ10_FIGURE_SIZE_IN = (9.0, 3.6)
TORQUE_CAUSE_COLOURS = dict(zip(TORQUE_CAUSES, (BLUE, RED, GREEN, ORANGE, PURPLE), strict=True))
LINK_TORQUE_CAUSES = TORQUE_CAUSES[:3]
"""Torque components that Eq. 3 to 12 of the paper describe."""


def draw_torque_figure(figure: Any) -> None:
    """Draw the torques that close a finger and the thumb at three speeds.

    Below each plot, a second plot shows the torques caused by the links on a larger scale.
    """
    rows = figure.subplots(
        4, len(CLOSING_DURATIONS_S), sharey="row", height_ratios=(1.15, 1, 1.15, 1)
    )
    for pair, (name, title) in enumerate((("index", "finger"), ("thumb", "thumb"))):
        for column, duration in enumerate(CLOSING_DURATIONS_S):
            motion = closing_torques(name, duration)
            total_axes = rows[2 * pair][column]
            link_axes = rows[2 * pair + 1][column]
            for torque_cause in TORQUE_CAUSES:
                total_axes.plot(
                    1e3 * motion.times,
                    1e3 * motion.torque_by_cause[torque_cause],
                    color=TORQUE_CAUSE_COLOURS[torque_cause],
                    label=torque_cause,
                )
            total = sum(motion.torque_by_cause.values(), np.zeros(len(motion.times)))
            total_axes.plot(
                1e3 * motion.times,
                1e3 * total,
                color="black",
                linewidth=1.0,
                linestyle="--",
                label="sum",
            )
            for torque_cause in LINK_TORQUE_CAUSES:
                link_axes.plot(
                    1e3 * motion.times,
                    1e3 * motion.torque_by_cause[torque_cause],
                    color=TORQUE_CAUSE_COLOURS[torque_cause],
                )
            total_axes.set_title(
                f"{title}, {CLOSED_JOINT_ANGLE_DEG:g}° in {duration:g} s", fontsize=9.5
            )
            link_axes.set_title("links alone (Eq. 3-12)", fontsize=9, weight="normal")
            for axes in (total_axes, link_axes):
                axes.margins(x=0)
                axes.axhline(0.0, color=GREY, linewidth=0.7)
                _add_tension_axis(axes, motion.moment_arm_m, column == len(CLOSING_DURATIONS_S) - 1)
            if column == 0:
                total_axes.set(ylabel="torque [mN m]")
                link_axes.set(ylabel="torque [mN m]")
            if pair == 1:
                link_axes.set(xlabel="time [ms]")
    handles, labels = rows[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=6, fontsize=9)


def _add_tension_axis(axes: Any, moment_arm_m: float, is_labelled: bool) -> None:
    """Add an axis that shows the torque as a tension of the tendon."""
    # The torques are converted from mN m to N m. Division of a torque in mN m by the moment arm in
    # mm gives a tension in N.
    factor = 1e-3 / moment_arm_m
    side = axes.secondary_yaxis(
        "right", functions=(lambda torque: torque * factor, lambda force: force / factor)
    )
    if is_labelled:
        side.set_ylabel("tension [N]")
    else:
        side.set_yticklabels([])


def draw_eq10_figure(figure: Any) -> None:
    """Draw the torque T_1 of Eq. 10, computed from the printed and from the corrected equation.

    Both plots show both curves. The first plot has the scale of the printed equation, and the
    second plot has the scale of the corrected equation.
    """
    times, printed_torque, correct_torque = closing_torque_t1(CLOSING_DURATIONS_S[1])
    printed_axes, enlarged_axes = figure.subplots(1, 2)
    for axes in (printed_axes, enlarged_axes):
        axes.plot(1e3 * times, 1e3 * printed_torque, color=RED, label="Eq. 10 as printed")
        axes.plot(1e3 * times, 1e3 * correct_torque, color=BLUE, label="corrected")
        axes.axhline(0.0, color=GREY, linewidth=0.7)
        axes.margins(x=0)
        axes.set(xlabel="time [ms]", ylabel="T₁ [mN m]")
    factor = float(np.abs(printed_torque).max() / np.abs(correct_torque).max())
    printed_axes.set_title(f"as printed: {factor:.0f} times too large")
    limit = 1.6e3 * float(np.abs(correct_torque).max())
    enlarged_axes.set(ylim=(-limit, limit))
    enlarged_axes.set_title("enlarged: even at rest the wrong sign")
    printed_axes.legend(fontsize=8.5)
    for at in (0, -1):
        enlarged_axes.plot(
            1e3 * times[at], 1e3 * printed_torque[at], "o", color=RED, markersize=5, clip_on=False
        )
        enlarged_axes.plot(
            1e3 * times[at], 1e3 * correct_torque[at], "o", color=BLUE, markersize=5, clip_on=False
        )
