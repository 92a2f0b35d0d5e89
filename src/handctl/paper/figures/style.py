"""Style of all figures of the paper: colours, sizes, and the way in which figures are saved."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from handctl.output_files import save_figure
from handctl.paper.page import FIGURE_FILE_PREFIX

BLUE = "#3b6fb6"
ORANGE = "#d9822b"
GREEN = "#3c9d5d"
RED = "#d01c1c"
PURPLE = "#7a5fb5"
GREY = "#6b6b6b"
"""All figures of the paper and the figures of a run use the colours above."""
DIGIT_COLOURS = {"index": BLUE, "middle": ORANGE, "ring": GREEN, "thumb": "#b8436f"}
"""Colour of each digit."""
PLOT_SETTINGS: Any = {
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "svg.hashsalt": "handctl",
}
FIGURE_DPI = 160


def write_figure(
    folder: Path, name: str, size_inch: tuple[float, float], draw_content: Callable[[Any], None]
) -> Path:
    """Draw a figure, and write it as a PNG file and an SVG file.

    Args:
        folder: folder for both files.
        name: name of the figure, as in `page.FIGURE_CAPTIONS`.
        size_inch: width and height of the figure [inch].
        draw_content: function that draws on the figure.

    Returns:
        The path of the SVG file.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context(PLOT_SETTINGS):
        figure = Figure(figsize=size_inch, layout="constrained")
        FigureCanvasAgg(figure)
        draw_content(figure)
        save_figure(figure, folder / f"{FIGURE_FILE_PREFIX}{name}.png", FIGURE_DPI)
        path = folder / f"{FIGURE_FILE_PREFIX}{name}.svg"
        save_figure(figure, path)
    return path
