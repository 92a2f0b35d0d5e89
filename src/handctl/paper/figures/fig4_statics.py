"""Fig. 4 and 6 of the paper: moments at the joints of a straight digit.

At each joint, the figures compare two moments: the moment of a force on the tip, and the moment of
the tendon.
"""

from typing import Any

from handctl.hand.file.section_models import Digit
from handctl.paper import paper_data as src
from handctl.paper.figures.style import BLUE, GREY, ORANGE, RED

STATICS_FIGURE_SIZE_IN = (9.6, 4.2)


def draw_statics_figure(figure: Any) -> None:
    """Draw a finger and the thumb, and the joint moments that a force of 1 N at the tip causes."""
    left_axes, right_axes = figure.subplots(1, 2, width_ratios=(1.0, 0.62), sharey=True)
    _draw_digit(left_axes, src.paper_finger(), "Finger: M₁ = 55F, M₂ = 25F, M₃ = 10F", "T = 18.33F")
    _draw_digit(right_axes, src.paper_thumb(), "Thumb: M₁ = 25F, M₂ = 10F", "T = 8.33F")
    left_axes.set(ylabel="moment per newton at the tip [N mm/N]")
    right_axes.legend(*left_axes.get_legend_handles_labels(), loc="upper right", fontsize=8.5)


def _draw_digit(axes: Any, digit: Digit, title: str, tension: str) -> None:
    """Draw the moments that balance the tip force at a digit's joints, and the moments of the tendon."""
    tip_distances = [float(distance) for distance in src.tip_distances_mm(digit)]
    positions = [tip_distances[0] - distance for distance in tip_distances]
    tendon_moment = tip_distances[0]
    axes.plot(
        [0, tip_distances[0]],
        [tip_distances[0], 0],
        color=BLUE,
        label="required by F at the tip",
        zorder=3,
    )
    axes.plot(positions, tip_distances, "o", color=BLUE, zorder=4)
    axes.plot(
        [0, positions[-1] + 2.0],
        [tendon_moment, tendon_moment],
        color=ORANGE,
        label="available from one tendon on 3 mm pulleys",
        zorder=3,
    )
    for i, (position, distance) in enumerate(zip(positions, tip_distances, strict=True)):
        axes.annotate(
            f"{distance:g}F",
            (position, distance),
            (7, 3),
            textcoords="offset points",
            color=BLUE,
            weight="bold",
        )
        if tendon_moment > distance:
            axes.annotate(
                "",
                (position, tendon_moment),
                (position, distance),
                arrowprops={"arrowstyle": "<->", "color": RED, "shrinkA": 4},
            )
            axes.text(
                position + 0.8,
                (tendon_moment + distance) / 2,
                f"{tendon_moment - distance:g}F\ntoo much",
                color=RED,
                fontsize=8.5,
            )
        axes.text(position, -7.8, f"joint {i + 1}", ha="center", fontsize=8.5, color=GREY)
    axes.text(0.3 * tendon_moment, tendon_moment + 1.2, tension, color="#a87400", fontsize=9)
    _draw_digit_outline(axes, [*positions, tip_distances[0]])
    axes.set(
        xlabel="along the digit [mm]", title=title, xlim=(-4, tip_distances[0] + 6), ylim=(-17, 64)
    )


def _draw_digit_outline(axes: Any, joint_xs: list[float]) -> None:
    """Draw the outline of the digit below the axis of the plot, with the force at the tip of the digit."""
    axes.plot(
        joint_xs,
        [-12.5] * len(joint_xs),
        color=GREY,
        linewidth=6,
        solid_capstyle="round",
        alpha=0.45,
    )
    axes.plot(
        joint_xs[:-1],
        [-12.5] * (len(joint_xs) - 1),
        "o",
        color="white",
        markeredgecolor=GREY,
        markersize=6,
    )
    axes.annotate(
        "",
        (joint_xs[-1], -12.0),
        (joint_xs[-1], -1.5),
        arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.4},
    )
    axes.text(joint_xs[-1] + 1.0, -6.5, "F", weight="bold")
    axes.axhline(0.0, color=GREY, linewidth=0.8)
