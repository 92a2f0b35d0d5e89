"""Small pictures of a run as SVG text: poses of the hand, lateness of the ticks, bus load."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import HandMode
from handctl.drives.frame import EXTENDED_FLAG, FDF
from handctl.drives.frame_time import frame_time_s
from handctl.hand.description import Hand
from handctl.hand.kinematics import link_rotations
from handctl.hand.link_tree import LinkTree
from handctl.log.attached_meshes import attached_meshes
from handctl.log.read.reader import RunLog
from handctl.report.run_figure import DIGIT_COLOURS, PASSIVE_PHASES, digit_colours

Array = NDArray[np.float64]

BUS_LOAD_WINDOW_S = 0.1
"""Length of the time window over which the bus load is averaged [s]."""
POSES_PER_ROW = 4
"""Number of hand pictures in one row."""
OBLIQUE_SHIFT = (0.55, 0.3)
"""Shift of the oblique projection to the right and upwards, for each unit of distance along the hinge axes.

The shift separates digits whose hinges lie on the same line.
"""
PALM_COLOUR = "#e3e6ea"
LIGHT_DIRECTION = np.array([0.4, 0.5, -0.77])
"""Unit vector in the palm frame that points from a mesh to the light."""
MESH_DPI = 160
"""Resolution at which meshes are drawn in a picture [dots per inch]."""
MIN_ARROW_FORCE_N = 0.2
"""Smallest force drawn as an arrow [N]."""
ARROW_LENGTH_M_PER_N = 0.004
"""Length of a force arrow for each newton of force [m/N]."""


def draw_poses(log: RunLog, hand: Hand) -> str:
    """Draw the pose of the hand in the middle of each active phase, and return the picture as SVG.

    The arrows show the forces of the object on the fingertips.
    """
    pose_ticks = _middle_ticks_of_phases(log)
    if not pose_ticks:
        return "<p>The hand acts in no phase of this run.</p>"
    figure, grid = _new_figure(
        min(len(pose_ticks), POSES_PER_ROW), 2.6, 2.9, -(-len(pose_ticks) // POSES_PER_ROW)
    )
    tree = LinkTree.from_hand(hand)
    digits = tree.digits
    q = log.field("q")
    force = log.field("tip_force")
    meshes, _ = attached_meshes(hand, log.header.attachments)
    palm = meshes["palm"].triangles.reshape(-1, 3) if "palm" in meshes else np.zeros((0, 3))
    limits = _picture_limits(tree, palm)
    colours = digit_colours(hand)
    for axes in grid:
        axes.set_axis_off()
    for axes, (name, index) in zip(grid, pose_ticks, strict=False):
        if "palm" in meshes:
            _draw_mesh(axes, meshes["palm"].triangles, PALM_COLOUR)
        else:
            _draw_palm(axes, hand)
        paths = tree.points(q[index])
        turned_link_rotations = link_rotations(tree.poses(q[index]))
        # In this projection, a digit with a larger z lies behind the other digits, so it is drawn
        # before them.
        for d in sorted(range(len(digits)), key=lambda d: -float(digits[d].mount_position[2])):
            # The object pushes the fingertip against the direction in which the digit closes, which
            # is the y axis of the last link.
            push_force = (
                -max(float(force[index, d]), 0.0)
                * turned_link_rotations[digits[d].joints][-1, :, 1]
            )
            link_mesh_list = [
                meshes.get(f"{digits[d].name}_link{i + 1}") for i in range(len(paths[d]) - 1)
            ]
            for mesh, position, rotation in zip(
                link_mesh_list, paths[d], turned_link_rotations[digits[d].joints], strict=False
            ):
                if mesh:
                    _draw_mesh(axes, mesh.triangles @ rotation.T + position, colours[d])
            _draw_digit(
                axes,
                paths[d],
                push_force,
                colours[d],
                [mesh is not None for mesh in link_mesh_list],
            )
        _write_force_values(axes, force[index], colours)
        axes.set_title(f"{name}, {log.times[index]:.2f} s", fontsize=11)
        axes.set_aspect("equal")
        axes.set(xlim=limits[0], ylim=limits[1])
    _draw_scale_bar(grid[0], limits)
    return _figure_as_svg(figure)


def _project_points(points_m: Array) -> Array:
    """Project points (.., 3) in the palm frame [m] to the plane of the picture.

    The result (.., 2) is in mm. The viewer looks along the axes of the joints, but slightly from
    the side.
    """
    return np.asarray(
        1e3 * (points_m[..., :2] + points_m[..., 2:] * np.array(OBLIQUE_SHIFT)), np.float64
    )


def _picture_limits(
    tree: LinkTree, palm_points: Array
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of a picture that contains the palm and all digits at rest.

    The argument `palm_points` contains the corners of the palm (n, 3).
    """
    digits = _project_points(np.concatenate(tree.points(np.zeros(len(tree.parent)))))
    corners = np.concatenate((digits - 20.0, digits + 10.0, _project_points(palm_points)))
    lower_corner = corners.min(axis=0)
    upper_corner = corners.max(axis=0)
    return (float(lower_corner[0]), float(upper_corner[0])), (
        float(lower_corner[1]),
        float(upper_corner[1]),
    )


def _draw_palm(axes: Any, hand: Hand) -> None:
    """Draw the plate of the palm, to which the digits are attached."""
    mounts = np.array([digit.mount_position_m for digit in hand.digit if digit.mount_on is None])
    (y0, z0) = mounts[:, 1:].min(axis=0) - 0.009
    (y1, z1) = mounts[:, 1:].max(axis=0) + 0.009
    corners = np.array([[0.0, y, z] for y, z in ((y0, z0), (y1, z0), (y1, z1), (y0, z1))])
    axes.fill(*_project_points(corners).T, color=PALM_COLOUR, zorder=0)


def _draw_mesh(axes: Any, triangles: Array, colour: str) -> None:
    """Draw the triangles of a mesh, beginning with the farthest triangles.

    Triangles perpendicular to the light are brighter.

    Args:
        axes: axes of the picture.
        triangles: (n, 3, 3) corners of the triangles in the palm frame [m].
        colour: colour of the mesh.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    unit_normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    unit_normals /= np.maximum(
        np.linalg.norm(unit_normals, axis=1, keepdims=True), np.finfo(float).tiny
    )
    brightness = 0.55 + 0.45 * np.abs(unit_normals @ LIGHT_DIRECTION)
    # Points that are drawn at the same position in the picture differ only in z. The viewer looks
    # towards positive z.
    order = np.argsort(-triangles[:, :, 2].mean(axis=1))
    faces = np.clip(brightness[order, None] * np.array(to_rgb(colour)), 0.0, 1.0)
    # The mesh is drawn as a bitmap. As vector graphics, the triangles of eight poses of the hand
    # would take many megabytes.
    axes.add_collection(
        PolyCollection(list(_project_points(triangles[order])), facecolors=faces, edgecolors=faces, linewidths=0.2,
                       rasterized=True, zorder=1)
    )  # fmt: skip


def _draw_digit(
    axes: Any, joints: Array, push_force: Array, colour: str, has_mesh: Sequence[bool]
) -> None:
    """Draw the links of a digit from the palm to the tip, and the estimated force on the tip as an arrow.

    Args:
        axes: axes of the picture.
        joints: (n + 1, 3) positions of the n joints and the tip in the palm frame [m].
        push_force: (3,) estimated force of the object on the tip in the palm frame [N].
        colour: colour of the links of the digit.
        has_mesh: True for each link that is drawn as a mesh.
    """
    path = _project_points(joints)
    line_segments = [path[i : i + 2] for i, meshed in enumerate(has_mesh) if not meshed]
    for line in line_segments if any(has_mesh) else [path]:
        axes.plot(
            *line.T,
            color=colour,
            linewidth=7,
            alpha=0.9,
            solid_capstyle="round",
            solid_joinstyle="round",
        )
    axes.plot(*path[:-1].T, "o", color="white", markersize=3)
    # For an unknown force or angle, which is NaN, this negated comparison is true. If the force or
    # an angle is NaN, no arrow is drawn.
    if not np.linalg.norm(push_force) >= MIN_ARROW_FORCE_N:
        return
    start, end = _project_points(
        np.array([joints[-1], joints[-1] + ARROW_LENGTH_M_PER_N * push_force])
    )
    style = {"arrowstyle": "-|>", "color": "#222222", "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=end, xytext=start, arrowprops=style, zorder=10)


def _write_force_values(axes: Any, force: Array, colours: list[str]) -> None:
    """Write the values of the forces on the fingertips [N] in the corner of the picture.

    If the values were written next to the arrows, the texts would overlap.
    """
    for d, value in enumerate(force.tolist()):
        if value >= MIN_ARROW_FORCE_N:
            style = {
                "fontsize": 9,
                "color": colours[d],
                "transform": axes.transAxes,
                "va": "bottom",
            }
            axes.text(0.98, 0.3 - 0.09 * d, f"{value:.1f} N", ha="right", **style)


def _draw_scale_bar(
    axes: Any, view_limits: tuple[tuple[float, float], tuple[float, float]]
) -> None:
    """Draw a scale bar of 20 mm into a picture of the hand."""
    x = view_limits[0][1] - 22.0
    y = view_limits[1][0] + 3.0
    axes.plot([x, x + 20.0], [y, y], color="#222222", linewidth=1.5)
    axes.text(x + 10.0, y + 1.5, "20 mm", ha="center", fontsize=8, color="#222222")


def _middle_ticks_of_phases(log: RunLog) -> list[tuple[str, int]]:
    """Return the name of each phase in which the hand is active, and the index of the phase's middle tick."""
    changes = log.phases
    end_ticks = [change.k for change in changes[1:]] + log.k[-1:].tolist()
    middle_ticks = [
        (c.name, int(np.searchsorted(log.k, (c.k + end) // 2)))
        for c, end in zip(changes, end_ticks, strict=True)
    ]
    phases_inside = [
        (name, i) for name, i in middle_ticks if name not in PASSIVE_PHASES and i < len(log)
    ]  # the log can contain the ticks in a different order
    return [(name, i) for name, i in phases_inside if log.mode[i] == int(HandMode.ACTIVE)][
        : 2 * POSES_PER_ROW
    ]


def draw_lateness(log: RunLog) -> str:
    """Draw a histogram of the lateness of the ticks, with a line at a quarter of the control period.

    A tick that is later than a quarter of the control period counts as late.
    """
    lateness_us = log.late_ns / 1e3
    if not lateness_us.any():
        return "<p>No tick began late: this run was in virtual time.</p>"
    figure, (axes,) = _new_figure(1, 6.0, 2.2)
    quarter_period_us = log.header.period_ns / 4e3
    axes.hist(
        lateness_us,
        bins=np.linspace(0.0, max(quarter_period_us, float(lateness_us.max(initial=0.0))), 80),
        color=DIGIT_COLOURS[0],
    )
    axes.axvline(quarter_period_us, color=DIGIT_COLOURS[3], linewidth=0.8)
    axes.text(
        quarter_period_us,
        0.9,
        " quarter period ",
        ha="right",
        fontsize=7,
        transform=axes.get_xaxis_transform(),
    )
    axes.set_yscale("symlog", linthresh=1)
    axes.set(xlabel="lateness [us]", ylabel="ticks")
    return _figure_as_svg(figure)


def draw_bus_loads(log: RunLog, hand: Hand) -> tuple[str, Array]:
    """Draw the load of each bus over time.

    The load is computed from the worst-case time of each frame.

    Returns:
        the picture, and the largest load of each bus (buses,) in any time window of
        `BUS_LOAD_WINDOW_S`. If the run is shorter than the window, the whole run is one window.
    """
    bus_loads = np.zeros((len(log), len(hand.bus)))
    for i, tick in enumerate(log.ticks()):
        for frame in (*tick.tick_in.frames, *tick.frames):
            if frame.bus < len(hand.bus):
                bus = hand.bus[frame.bus]
                fd = bool(frame.flags & FDF)
                size = len(frame.data)
                has_extended_id = bool(frame.can_id & EXTENDED_FLAG)
                bus_loads[i, frame.bus] += frame_time_s(
                    size, fd, bus.bitrate, bus.data_bitrate, has_extended_id
                )
    window = max(1, min(round(BUS_LOAD_WINDOW_S * 1e9 / log.header.period_ns), len(log)))
    averaging_weights = np.ones(window) / (window * log.header.period_ns * 1e-9)
    load = bus_loads
    if len(log):
        load = np.column_stack(
            [np.convolve(column, averaging_weights, "same") for column in bus_loads.T]
        )
    figure, (axes,) = _new_figure(1, 6.0, 2.2)
    for index, name in enumerate(hand.bus_names):
        axes.plot(
            log.times,
            100 * load[:, index],
            color=DIGIT_COLOURS[index % len(DIGIT_COLOURS)],
            linewidth=0.9,
            label=name,
        )
    axes.set(xlabel="time [s]", ylabel="bus load [%]", ylim=(0, None))
    axes.legend(fontsize=7, loc="lower right")
    return _figure_as_svg(figure), load.max(axis=0, initial=0.0)


def _new_figure(columns: int, width: float, height: float, rows: int = 1) -> tuple[Any, list[Any]]:
    """Create a figure with a grid of axes, and return the figure and the axes."""
    # The import of Matplotlib is slow and few commands draw. Therefore only `_new_figure` imports
    # Matplotlib.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width * columns, height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(rows, columns, squeeze=False, sharey=True).flat)


def _figure_as_svg(figure: Any) -> str:
    """Return a figure as an SVG element for an HTML page."""
    text = io.StringIO()
    figure.savefig(text, format="svg", dpi=MESH_DPI, metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
