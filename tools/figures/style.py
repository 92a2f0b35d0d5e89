"""Define the common style of all figures: fonts, colours, and the handctl version in the metadata of each file."""

import io
import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

FIGURES_FOLDER = Path(__file__).parents[2] / "docs" / "figures"
DIGIT_COLOURS = {"index": "#3b6fb6", "middle": "#d9822b", "ring": "#3c9d5d", "thumb": "#b8436f"}
"""Colour of each digit. The figures of a run and the viewer use the same colours."""
TRUTH_COLOUR = "#000000"
COMMAND_COLOUR = "#7a7a7a"
ESTIMATE_COLOUR = "#3b6fb6"
RAW_COLOUR = "#c9c9c9"
FAULT_COLOUR = "#d01c1c"
"""Colour of faults in figures.

The constants before FAULT_COLOUR are the colours of true values, commands, estimates and raw
readings.
"""
INK_COLOUR = "#22303c"
BLOCK_COLOURS = {
    "host": "#dbe7f5",
    "wire": "#f6e3c8",
    "hardware": "#dcefdf",
    "log": "#ece2f4",
    "safety": "#f8d9d9",
}
"""Colour of a block in diagrams, by the subject of the block.

The lines and texts of a diagram have other colours.
"""
PLOT_SETTINGS: dict[str, Any] = {
    "font.family": "DejaVu Sans", "font.size": 9, "axes.titlesize": 10, "axes.labelsize": 9, "axes.grid": True,
    "grid.alpha": 0.3, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False,
    "legend.fontsize": 8, "svg.hashsalt": "handctl", "svg.fonttype": "path", "figure.facecolor": "white",
    "lines.linewidth": 1.3, "figure.dpi": 100,
}  # fmt: skip
CREATOR_TEXT = f"handctl {version('handctl')}"
"""Name and version of the program, for the metadata of every figure."""


def apply_style() -> None:
    """Apply the style to all figures of the present process, including the figures that handctl draws."""
    import matplotlib

    for key, value in PLOT_SETTINGS.items():
        matplotlib.rcParams[key] = value  # type: ignore[index]


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of ``width`` x ``height`` [inch] in the common style."""
    apply_style()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Any, name: str, folder: Path = FIGURES_FOLDER) -> list[Path]:
    """Write a figure as an SVG and a PNG file, both with the version of handctl in the metadata."""
    written = []
    for kind, metadata in (
        ("svg", {"Creator": CREATOR_TEXT, "Date": None}),
        ("png", {"Software": CREATOR_TEXT}),
    ):
        path = folder / f"{name}.{kind}"
        buffer = io.BytesIO()
        figure.savefig(buffer, format=kind, metadata=metadata, dpi=110)
        content = buffer.getvalue()
        path.write_bytes(without_blanks(content) if kind == "svg" else content)
        written.append(path)
    return written


def without_blanks(content: bytes) -> bytes:
    """Remove the blanks at the line ends of an SVG file that matplotlib has written.

    The program git would report these blanks.
    """
    return b"\n".join(map(bytes.rstrip, content.split(b"\n")))


def stamp_picture(source: Path, path: Path) -> None:
    """Copy a PNG file that handctl has drawn, and add the version of handctl to the metadata of the copy."""
    from PIL import Image, PngImagePlugin

    info = PngImagePlugin.PngInfo()
    info.add_text("Software", CREATOR_TEXT)
    with Image.open(source) as image:
        image.save(path, pnginfo=info, optimize=True)


def drawn_by(path: Path) -> str:
    """Return the program name and version that are stored in the metadata of a figure, or an empty text."""
    if path.suffix == ".svg":
        text = path.read_text(encoding="utf-8")
        match = re.search(r"<dc:title>(.*?)</dc:title>", text)
        return match[1] if match else ""
    from PIL import Image

    with Image.open(path) as image:
        info = image.info
    comment = info.get("comment", b"")
    return str(info.get("Software", "")) or (
        comment.decode() if isinstance(comment, bytes) else str(comment)
    )
