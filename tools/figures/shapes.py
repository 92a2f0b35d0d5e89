"""Draw the blocks, arrows and labels of diagrams. Each diagram has its own unit of length."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from tools.figures.style import BLOCK_COLOURS, INK_COLOUR, new_figure

PlanePoint = tuple[float, float]


def new_plane(width: float, height: float, size: PlanePoint) -> tuple[Any, Any]:
    """Return a figure of ``width`` x ``height`` [inch], and axes of ``size`` units without a frame."""
    figure = new_figure(width, height)
    axes = figure.add_subplot()
    axes.set(xlim=(0.0, size[0]), ylim=(0.0, size[1]), aspect="equal")
    axes.axis("off")
    return figure, axes


def draw_block(
    axes: Any,
    corner: PlanePoint,
    size: PlanePoint,
    text: str,
    subject: str = "host",
    fontsize: float = 8.5,
) -> None:
    """Draw a block with a text in its middle. The argument ``subject`` selects the colour of the block."""
    from matplotlib.patches import FancyBboxPatch

    style = "round,pad=0,rounding_size=0.12"
    axes.add_patch(
        FancyBboxPatch(
            corner,
            *size,
            boxstyle=style,
            facecolor=BLOCK_COLOURS[subject],
            edgecolor=INK_COLOUR,
            linewidth=0.9,
        )
    )
    middle = (corner[0] + size[0] / 2.0, corner[1] + size[1] / 2.0)
    axes.text(
        *middle,
        text,
        ha="center",
        va="center",
        fontsize=fontsize,
        color=INK_COLOUR,
        linespacing=1.35,
    )


def draw_area(axes: Any, corner: PlanePoint, size: PlanePoint, text: str) -> None:
    """Draw a dashed frame around an area for blocks.

    ``text`` is the title of the area, at its upper left corner.
    """
    from matplotlib.patches import Rectangle

    axes.add_patch(
        Rectangle(
            corner, *size, fill=False, edgecolor="#8896a3", linewidth=0.9, linestyle=(0, (4, 3))
        )
    )
    axes.text(
        corner[0] + 0.1,
        corner[1] + size[1] - 0.12,
        text,
        ha="left",
        va="top",
        fontsize=8,
        color="#5b6b79",
    )


def draw_arrow(
    axes: Any,
    points: Sequence[PlanePoint],
    text: str = "",
    at: PlanePoint | None = None,
    colour: str = INK_COLOUR,
    two_heads: bool = False,
) -> None:
    """Draw an arrow along a line of points.

    Args:
        axes: axes of the diagram.
        points: corners of the line. The tip of the arrow is at the last corner.
        text: label of the arrow.
        at: position of the label's middle. The default is just above the middle of the longest part
            of the line.
        colour: colour of line and label.
        two_heads: True for an arrow with a tip at each end.
    """
    xs, ys = zip(*points[:-1], strict=True) if len(points) > 2 else ((), ())
    if xs:
        axes.plot(xs, ys, color=colour, linewidth=1.1, solid_capstyle="round")
    style = {"arrowstyle": "<|-|>" if two_heads else "-|>", "color": colour, "linewidth": 1.1, "mutation_scale": 9,
             "shrinkA": 0, "shrinkB": 0}  # fmt: skip
    axes.annotate("", xy=points[-1], xytext=points[-2], arrowprops=style)
    if text:
        pairs = list(pairwise(points))
        (x0, y0), (x1, y1) = max(
            pairs, key=lambda ends: abs(ends[0][0] - ends[1][0]) + abs(ends[0][1] - ends[1][1])
        )
        text_position = at or ((x0 + x1) / 2.0, (y0 + y1) / 2.0 + 0.14)
        axes.text(
            *text_position,
            text,
            ha="center",
            va="center",
            fontsize=7.5,
            color=colour,
            linespacing=1.2,
        )


def draw_note(axes: Any, text_position: PlanePoint, text: str, **text_style: Any) -> None:
    """Write a text at a position in the diagram."""
    axes.text(
        *text_position,
        text,
        **{"ha": "left", "va": "center", "fontsize": 7.5, "color": INK_COLOUR, "linespacing": 1.3}
        | text_style,
    )


def draw_circle(
    axes: Any, centre: PlanePoint, radius: float, subject: str = "hardware", text: str = ""
) -> None:
    """Draw a circle with a text in its middle."""
    from matplotlib.patches import Circle

    axes.add_patch(
        Circle(
            centre, radius, facecolor=BLOCK_COLOURS[subject], edgecolor=INK_COLOUR, linewidth=0.9
        )
    )
    draw_note(axes, centre, text, ha="center")
