"""Fig. 1 of the paper: the hand in three dimensions, drawn from the hand file."""

from itertools import pairwise
from typing import Any

import numpy as np

from handctl.hand.digit import Array, DigitModel
from handctl.hand.formats.urdf import PALM_BOX_MARGIN_M, PALM_THICKNESS_M
from handctl.hand.kinematics import joint_points
from handctl.paper import paper_data as src
from handctl.paper.figures.style import DIGIT_COLOURS

HAND_FIGURE_SIZE_IN = (7.2, 5.6)
POSE_ANGLES_DEG = {"index": 24.0, "middle": 30.0, "ring": 36.0, "thumb": 30.0}
"""Angle of all joints of a digit in the figure, for each digit [deg]."""
LABEL_OFFSETS_MM = {
    "index": (4, 0, 8),
    "middle": (4, 0, 8),
    "ring": (-8, -4, -14),
    "thumb": (0, 0, 8),
}
"""Offset of the label of each digit [mm]."""
FACES_AROUND_BAR = 24
RINGS_ON_BAR_END = 6
"""The two constants above are the number of faces around a bar, and the number of rings on the round end of a bar."""
LIGHT_DIRECTION = np.array([0.35, -0.45, 0.82])
"""Direction from which the light comes."""
VIEW_ANGLES_DEG = (24.0, -58.0)
"""Elevation and azimuth of the view [deg]."""


def draw_hand_figure(figure: Any) -> None:
    """Draw the palm, and then the digits.

    The figure draws all digits as one collection of faces, so that near faces hide far faces.
    """
    from matplotlib.patheffects import withStroke
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped,unused-ignore]

    axes = figure.add_subplot(projection="3d", computed_zorder=False)
    palm = _palm_faces()
    axes.add_collection3d(
        Poly3DCollection(
            palm, facecolors=[_shaded_colour(face, "#b9bec6") for face in palm], zorder=1
        )
    )
    faces: list[Array] = []
    colours: list[Any] = []
    for name, colour in DIGIT_COLOURS.items():
        model = DigitModel.from_hand(src.paper_hand(), name)
        nodes = 1000.0 * joint_points(
            model, np.radians(np.full(model.joint_count, POSE_ANGLES_DEG[name]))
        )
        for start, end in pairwise(nodes):
            link_faces = _capsule_faces(start, end, 1000.0 * model.radius)
            faces += link_faces
            colours += [_shaded_colour(face, colour) for face in link_faces]
        label_position = (nodes[0] + nodes[1]) / 2.0 + np.array(LABEL_OFFSETS_MM[name])
        outline = [withStroke(linewidth=2.5, foreground="white")]
        axes.text(
            *label_position,
            name,
            color=colour,
            weight="bold",
            ha="center",
            zorder=9,
            path_effects=outline,
        )
    links = Poly3DCollection(
        faces, facecolors=colours, edgecolors=colours, linewidths=0.25, zorder=3
    )
    axes.add_collection3d(links)
    _set_axes(axes)


def _set_axes(axes: Any) -> None:
    """Set the limits, the labels and the title of the axes."""
    axes.set(
        xlabel="x, out of the palm [mm]",
        ylabel="y, thumb to fingers [mm]",
        zlabel="z, along the hinges [mm]",
    )
    axes.set(xlim=(-12, 62), ylim=(-37, 37), zlim=(-37, 37))
    axes.set_box_aspect((1, 1, 1), zoom=1.05)
    axes.view_init(*VIEW_ANGLES_DEG)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    finger, thumb = (
        " + ".join(f"{length}" for length in src.exact_millimetres(d.link_length_m))
        for d in _finger_and_thumb()
    )
    joints = sum(len(digit.joints) for digit in src.paper_hand().digit)
    text = f"fingers {finger} mm, thumb {thumb} mm; {joints} hinges along z, {len(src.paper_hand().tendon)} tendons"
    axes.set_title(text, fontsize=9.5, weight="normal", loc="center")


def _finger_and_thumb() -> tuple[Any, Any]:
    """Return two digits of the paper's hand: one finger and the thumb."""
    return src.paper_finger(), src.paper_thumb()


def _palm_faces() -> list[Array]:
    """Return the six sides of the box that represents the palm."""
    mounts = np.array([digit.mount_position_m for digit in src.paper_hand().digit])
    low = 1000.0 * (mounts.min(axis=0) - PALM_BOX_MARGIN_M)
    high = 1000.0 * (mounts.max(axis=0) + PALM_BOX_MARGIN_M)
    # The box lies behind the plane on which the digits are mounted.
    low[0] = -1000.0 * PALM_THICKNESS_M
    high[0] = 0.0
    faces = []
    for axis in range(3):
        first_axis, second_axis = (other_axis for other_axis in range(3) if other_axis != axis)
        for level in (low[axis], high[axis]):
            face = np.full((4, 3), level)
            face[:, first_axis] = low[first_axis]
            face[:, second_axis] = low[second_axis]
            face[1:3, first_axis] = high[first_axis]
            face[2:4, second_axis] = high[second_axis]
            faces.append(face)
    return faces


def _capsule_faces(start_point: Array, end_point: Array, radius: float) -> list[Array]:
    """Return the faces of a bar whose far end is round."""
    axis = (end_point - start_point) / np.linalg.norm(end_point - start_point)
    side = np.cross(axis, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    up = np.cross(axis, side)
    quarter_turn_angles = np.linspace(0.0, np.pi / 2, RINGS_ON_BAR_END)
    # The first rings of corners are along the straight part of the bar. The other rings are around
    # the round end of the bar.
    ring_centres_and_radii = [
        (start_point + (end_point - start_point) * fraction, radius)
        for fraction in np.linspace(0.0, 0.9, 5)
    ]
    ring_centres_and_radii += [
        (end_point + axis * radius * np.sin(a), radius * np.cos(a)) for a in quarter_turn_angles
    ]
    turn = np.linspace(0.0, 2.0 * np.pi, FACES_AROUND_BAR + 1)
    circle = np.outer(np.cos(turn), side) + np.outer(np.sin(turn), up)
    ring_points = [centre + size * circle for centre, size in ring_centres_and_radii]
    return [
        np.array([a[i], a[i + 1], b[i + 1], b[i]])
        for a, b in pairwise(ring_points)
        for i in range(FACES_AROUND_BAR)
    ]


def _shaded_colour(face_corners: Array, colour: str) -> tuple[float, float, float]:
    """Return the colour of a face under a fixed light.

    Both sides of a face have the same colour.
    """
    from matplotlib.colors import to_rgb

    normal = np.cross(face_corners[2] - face_corners[0], face_corners[3] - face_corners[1])
    length = float(np.linalg.norm(normal))
    # The brightness of a face is at least 0.55, which is the ambient light. The brightness above
    # 0.55 depends on the angle between the face and the light.
    brightness = (
        0.55
        + 0.45
        * abs(float(normal @ LIGHT_DIRECTION) / (length * float(np.linalg.norm(LIGHT_DIRECTION))))
        if length
        else 1.0
    )
    red, green, blue = (
        min(1.0, brightness * colour_component + 0.06) for colour_component in to_rgb(colour)
    )
    return red, green, blue
