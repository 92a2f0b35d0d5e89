"""All figures: names, sizes, and the functions that draw them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from handctl.paper.bench.force_displacement import curves
from handctl.paper.figures import hand, measured, model, path, statics, torques
from handctl.paper.figures.style import draw

Content = Callable[[Any], None]
"""Function that draws on a figure."""


def contents(results: Mapping[str, Any] | None) -> dict[str, tuple[tuple[float, float], Content]]:
    """Return size [inch] and content of each figure. Without results the measured figures are left out."""
    drawn: dict[str, tuple[tuple[float, float], Content]] = {
        "fig1-hand": (hand.SIZE, hand.hand),
        "fig2-model": (model.SIZE, model.model),
        "fig3-path": (path.SIZE, path.path),
        "fig4-statics": (statics.SIZE, statics.statics),
        "fig7-torques": (torques.SIZE, torques.torques),
        "fig7-eq10": (torques.SIZE_EQ10, torques.eq10),
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
        results: results of `experiments.measure`, None to leave the measured figures out.

    Returns:
        SVG file of each figure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return {name: draw(folder, name, size, content) for name, (size, content) in contents(results).items()}
