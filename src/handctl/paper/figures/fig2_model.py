"""Fig. 2 of the paper: kinematic model of a finger, with its links, hinges, and relative and absolute angles."""

from typing import Any

import numpy as np

from handctl.paper import paper_data as src
from handctl.paper.figures.style import BLUE, GREY, ORANGE
from handctl.paper.model import kinematics

MODEL_FIGURE_SIZE_IN = (9.6, 5.0)
POSE_ANGLES_DEG = (25.0, 30.0, 35.0)
ARC_RADII_MM = (9.0, 6.0, 5.0)
"""Radius of the arc that marks the relative angle of each joint [mm]."""


def draw_model_figure(figure: Any) -> None:
    """Draw a finger with bent joints.

    At each joint, draw the angles that sections 4 and 7 of the paper use.
    """
    axes = figure.add_subplot()
    q = np.radians(POSE_ANGLES_DEG)
    theta = np.cumsum(q)
    nodes = 1000.0 * kinematics.points_in_plane(kinematics.paper_digit("index"), q)
    lengths = src.exact_millimetres(src.paper_finger().link_length_m)
    axes.plot(*nodes.T, color=GREY, linewidth=7, alpha=0.4, solid_capstyle="round", zorder=1)
    axes.plot(*nodes[:-1].T, "o", color="white", markeredgecolor="black", markersize=9, zorder=5)
    for i, radius in enumerate(ARC_RADII_MM):
        parent_angle = theta[i] - q[i]
        _draw_ray(axes, nodes[i], parent_angle, 1.7 * radius, BLUE)
        _draw_ray(axes, nodes[i], 0.0, 2.2 * radius, ORANGE)
        _draw_arc(axes, nodes[i], (parent_angle, theta[i]), radius, BLUE, f"q{'₁₂₃'[i]}")
        _draw_arc(axes, nodes[i], (0.0, theta[i]), 1.45 * radius, ORANGE, f"θ{'₁₂₃'[i]}")
        link_middle = (nodes[i] + nodes[i + 1]) / 2.0
        label_offset = 3.4 * np.array([-np.sin(theta[i]), np.cos(theta[i])])
        axes.text(
            *(link_middle + label_offset),
            f"L{'₁₂₃'[i]} = {lengths[i]} mm",
            ha="right",
            va="bottom",
            fontsize=9.5,
        )
    axes.plot([-4.0, -4.0], [-7.0, 7.0], color="black", linewidth=5, solid_capstyle="butt")
    axes.plot([-4.0, 0.0], [0.0, 0.0], color="black", linewidth=5, solid_capstyle="butt", zorder=3)
    axes.text(-4.0, -9.5, "palm", ha="center", fontsize=9.5)
    axes.annotate("tip (X, Y)", nodes[-1], (7, 2), textcoords="offset points", fontsize=9.5)
    axes.plot([], [], color=BLUE, label="q: between neighbouring links, as in section 4")
    axes.plot([], [], color=ORANGE, label="θ: with the x-axis, as in section 7")
    axes.legend(loc="upper left", fontsize=9)
    axes.set(xlabel="X [mm]", ylabel="Y [mm]", xlim=(-14, 62), ylim=(-13, 48), aspect="equal")
    axes.set_title(
        "three hinges about z, in series: θ₁ = q₁, θ₂ = q₁ + q₂, θ₃ = q₁ + q₂ + q₃", fontsize=10
    )


def _draw_ray(axes: Any, start_point: Any, angle: float, length: float, colour: str) -> None:
    """Draw the dashed line from which a joint angle is measured."""
    end = start_point + length * np.array([np.cos(angle), np.sin(angle)])
    axes.plot(*np.column_stack((start_point, end)), "--", color=colour, linewidth=1.0, zorder=2)


def _draw_arc(
    axes: Any,
    centre: Any,
    angle_limits: tuple[float, float],
    radius: float,
    colour: str,
    label: str,
) -> None:
    """Draw the arc of an angle, and the name of the angle next to the middle of the arc."""
    angles = np.linspace(*angle_limits, 40)
    axes.plot(
        *(centre[:, None] + radius * np.array([np.cos(angles), np.sin(angles)])),
        color=colour,
        zorder=3,
    )
    at = angle_limits[0] + 0.45 * (angle_limits[1] - angle_limits[0])
    axes.text(*(centre + (radius + 1.8) * np.array([np.cos(at), np.sin(at)])), label, color=colour, ha="center",
              va="center", fontsize=10, zorder=6)  # fmt: skip
