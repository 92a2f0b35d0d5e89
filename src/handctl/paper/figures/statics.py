"""Fig. 4 and 6: the moment that a tip force asks for along a straight digit, and the moment that one tendon gives."""

from typing import Any

from handctl.hand.file.sections import Digit
from handctl.paper import sources as src
from handctl.paper.figures.style import BLUE, GREY, ORANGE, RED

SIZE = (9.6, 4.2)


def statics(figure: Any) -> None:
    """Finger and thumb, moments per newton at the tip."""
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 0.62), sharey=True)
    _digit(left, src.finger(), "Finger: M₁ = 55F, M₂ = 25F, M₃ = 10F", "T = 18.33F")
    _digit(right, src.thumb(), "Thumb: M₁ = 25F, M₂ = 10F", "T = 8.33F")
    left.set(ylabel="moment per newton at the tip [N mm/N]")
    right.legend(*left.get_legend_handles_labels(), loc="upper right", fontsize=8.5)


def _digit(axes: Any, digit: Digit, title: str, tension: str) -> None:
    levers = [float(lever) for lever in src.levers(digit)]
    places = [levers[0] - lever for lever in levers]
    given = levers[0]
    axes.plot([0, levers[0]], [levers[0], 0], color=BLUE, label="asked for by F at the tip", zorder=3)
    axes.plot(places, levers, "o", color=BLUE, zorder=4)
    axes.plot(
        [0, places[-1] + 2.0], [given, given], color=ORANGE, label="given by one tendon on 3 mm pulleys", zorder=3
    )
    for i, (place, lever) in enumerate(zip(places, levers, strict=True)):
        axes.annotate(f"{lever:g}F", (place, lever), (7, 3), textcoords="offset points", color=BLUE, weight="bold")
        if given > lever:
            axes.annotate(
                "", (place, given), (place, lever), arrowprops={"arrowstyle": "<->", "color": RED, "shrinkA": 4}
            )
            axes.text(place + 0.8, (given + lever) / 2, f"{given - lever:g}F\ntoo much", color=RED, fontsize=8.5)
        axes.text(place, -7.8, f"joint {i + 1}", ha="center", fontsize=8.5, color=GREY)
    axes.text(0.3 * given, given + 1.2, tension, color="#a87400", fontsize=9)
    _drawing(axes, [*places, levers[0]])
    axes.set(xlabel="along the digit [mm]", title=title, xlim=(-4, levers[0] + 6), ylim=(-17, 64))


def _drawing(axes: Any, nodes: list[float]) -> None:
    """The digit itself below the axis, with the force at its tip."""
    axes.plot(nodes, [-12.5] * len(nodes), color=GREY, linewidth=6, solid_capstyle="round", alpha=0.45)
    axes.plot(nodes[:-1], [-12.5] * (len(nodes) - 1), "o", color="white", markeredgecolor=GREY, markersize=6)
    axes.annotate(
        "", (nodes[-1], -12.0), (nodes[-1], -1.5), arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.4}
    )
    axes.text(nodes[-1] + 1.0, -6.5, "F", weight="bold")
    axes.axhline(0.0, color=GREY, linewidth=0.8)
