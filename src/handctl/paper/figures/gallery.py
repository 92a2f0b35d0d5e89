"""All figures: names, sizes, and the functions that draw them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from handctl.paper.bench.force_displacement import curves
from handctl.paper.figures import fig1_hand, fig2_model, fig3_path, fig4_statics, fig7_torques, measured
from handctl.paper.figures.style import draw

Content = Callable[[Any], None]
"""Function that draws on a figure."""


def contents(results: Mapping[str, Any] | None) -> dict[str, tuple[tuple[float, float], Content]]:
    """Return size [inch] and content of each figure.

    Without results, figures of measurements are omitted.
    """
    drawn: dict[str, tuple[tuple[float, float], Content]] = {
        "fig1-hand": (fig1_hand.SIZE, fig1_hand.hand),
        "fig2-model": (fig2_model.SIZE, fig2_model.model),
        "fig3-path": (fig3_path.SIZE, fig3_path.path),
        "fig4-statics": (fig4_statics.SIZE, fig4_statics.statics),
        "fig7-torques": (fig7_torques.SIZE, fig7_torques.torques),
        "fig7-eq10": (fig7_torques.SIZE_EQ10, fig7_torques.eq10),
    }
    if results is not None:
        bench = curves(results["force_displacement"])
        loads = results["payload"]
        drawn |= {
            "fig5-force-displacement": (
                measured.SIZE_FORCE,
                lambda fig: measured.force_displacement(fig, bench),
            ),
            "fig8-payload": (measured.SIZE_PAYLOAD, lambda fig: measured.payloads(fig, loads)),
        }
    return drawn


def draw_all(folder: Path, results: Mapping[str, Any] | None) -> dict[str, Path]:
    """Draw every figure as PNG and SVG.

    Args:
        folder: folder to write to, created if it does not exist.
        results: results of `experiments.measure`, None to omit the figures of measurements.

    Returns:
        Path of the SVG file of each figure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return {name: draw(folder, name, size, content) for name, (size, content) in contents(results).items()}
