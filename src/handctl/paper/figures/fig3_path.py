"""Fig. 3: workspace of the tips of finger and thumb.

The figure shows the curve of Eq. 1-2, the limits of the hand, and the area that the tips could
reach if all joints moved independently.
"""

from typing import Any

import numpy as np
from scipy.ndimage import binary_closing, gaussian_filter

from handctl.hand.digit import Array
from handctl.hand.inverse_kinematics import coordinate_limits
from handctl.paper.figures.style import BLUE, GREY, RED
from handctl.paper.model import kinematics

PATH_FIGURE_SIZE_IN = (9.6, 4.5)
AREA_GRID_CELL_MM = 0.25
"""Edge length of the square cells of which the drawn area consists [mm]."""
SAMPLE_COUNTS = {"index": 161, "thumb": 900}
"""Number of sampled angles of each joint, by digit."""
HEIGHT_RANGE_MM = (-12.0, 60.0)
POSES_DEG = (0.0, 30.0, 60.0, 90.0)


def draw_path_figure(figure: Any) -> None:
    """Draw the reachable positions of finger and thumb side by side, on the same scale."""
    left_axes, right_axes = figure.subplots(1, 2, width_ratios=(110, 58), sharey=True)
    _draw_digit(left_axes, "index", "Finger: Eq. 1-2", (-46, 64))
    _draw_digit(right_axes, "thumb", "Thumb: the same with 15 and 10 mm", (-24, 34))
    left_axes.set(ylabel="Y [mm]")
    right_axes.legend(loc="upper left", fontsize=8.5)


def _draw_digit(axes: Any, name: str, title: str, x: tuple[float, float]) -> None:
    """Draw a digit in several poses, the curve of its tip, and the area that the tip could reach."""
    model = kinematics.paper_digit(name)
    _draw_reachable_area(
        axes, kinematics.reachable_tips(name, SAMPLE_COUNTS[name]), x, HEIGHT_RANGE_MM
    )
    low, high = coordinate_limits(model)
    full_path = kinematics.fingertip_path(name, np.linspace(low, high, 400))
    axes.plot(*full_path.T, color=BLUE, linewidth=2.2, label="tip, θ₁ = θ₂ = θ₃ = θ", zorder=4)
    for degrees in POSES_DEG:
        nodes = 1000.0 * kinematics.points_in_plane(
            model, np.full(model.joint_count, np.radians(degrees))
        )
        axes.plot(*nodes.T, color=GREY, linewidth=1.1, marker="o", markersize=2.8, zorder=3)
    for degrees in range(0, 101, 10):
        tip = kinematics.fingertip_path(name, np.radians([degrees]))[0]
        axes.plot(*tip, "o", color=BLUE, markersize=4, zorder=5)
        if degrees in (*POSES_DEG, 100):
            label_offset = (5, 4) if degrees < 45 else (-7, 6 if degrees < 75 else -5)
            side = "left" if degrees < 45 else "right"
            axes.annotate(
                f"{degrees:g}°",
                tip,
                label_offset,
                textcoords="offset points",
                fontsize=8.5,
                color=BLUE,
                ha=side,
                zorder=6,
            )
    finger_length_mm = 1000.0 * sum(model.lengths)
    axes.plot(finger_length_mm, 0.0, "s", color=RED, markersize=6, fillstyle="none", zorder=6)
    axes.annotate(
        f"{finger_length_mm:g} mm",
        (finger_length_mm, 0.0),
        (-4, -14),
        textcoords="offset points",
        fontsize=8.5,
        color=RED,
        ha="center",
    )
    axes.set(xlabel="X [mm]", title=title, xlim=x, ylim=HEIGHT_RANGE_MM, aspect="equal")


def _draw_reachable_area(
    axes: Any, tip_positions: Array, x_limits: tuple[float, float], y_limits: tuple[float, float]
) -> None:
    """Fill the grid cells that contain a sampled position of the fingertip, and the gaps between these cells."""
    bins = [
        np.arange(low, high + AREA_GRID_CELL_MM, AREA_GRID_CELL_MM)
        for low, high in (x_limits, y_limits)
    ]
    # Without the filling, empty cells between two samples would look like positions that the tip
    # cannot reach.
    reached_cells = binary_closing(
        np.histogram2d(tip_positions[:, 0], tip_positions[:, 1], bins=bins)[0] > 0, iterations=3
    )
    smoothed_area = gaussian_filter(reached_cells.astype(float), 1.5).T
    cell_centres = [(edges[:-1] + edges[1:]) / 2.0 for edges in bins]
    axes.contourf(*cell_centres, smoothed_area, levels=[0.5, 1.5], colors=["#cfe3f3"], zorder=1)
    axes.contour(
        *cell_centres, smoothed_area, levels=[0.5], colors=["#8db9da"], linewidths=0.8, zorder=2
    )
    axes.plot(
        [],
        [],
        "s",
        color="#cfe3f3",
        markeredgecolor="#8db9da",
        markersize=9,
        label="independent joints",
    )
    axes.plot([], [], color=GREY, marker="o", markersize=2.8, linewidth=1.1, label="links")
