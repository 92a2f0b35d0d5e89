"""All figures of the page about the paper: names, sizes, and the functions that draw them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from handctl.paper.bench.force_displacement import curves_of_tendons
from handctl.paper.figures import (
    fig1_hand,
    fig2_model,
    fig3_path,
    fig4_statics,
    fig7_torques,
    measured_figures,
)
from handctl.paper.figures.style import write_figure

DrawFunction = Callable[[Any], None]
"""Function that draws on a figure."""


def figure_contents(
    experiment_results: Mapping[str, Any] | None,
) -> dict[str, tuple[tuple[float, float], DrawFunction]]:
    """Return a dict with the size [inch] and the drawing function of each figure, by the name of the figure.

    Without results of experiments, the dict does not contain the figures about measurements.
    """
    figure_functions: dict[str, tuple[tuple[float, float], DrawFunction]] = {
        "fig1-hand": (fig1_hand.HAND_FIGURE_SIZE_IN, fig1_hand.draw_hand_figure),
        "fig2-model": (fig2_model.MODEL_FIGURE_SIZE_IN, fig2_model.draw_model_figure),
        "fig3-path": (fig3_path.PATH_FIGURE_SIZE_IN, fig3_path.draw_path_figure),
        "fig4-statics": (fig4_statics.STATICS_FIGURE_SIZE_IN, fig4_statics.draw_statics_figure),
        "fig7-torques": (fig7_torques.TORQUES_FIGURE_SIZE_IN, fig7_torques.draw_torque_figure),
        "fig7-eq10": (fig7_torques.EQ10_FIGURE_SIZE_IN, fig7_torques.draw_eq10_figure),
    }
    if experiment_results is not None:
        curves = curves_of_tendons(experiment_results["force_displacement"])
        payload_results = experiment_results["payload"]
        figure_functions |= {
            "fig5-force-displacement": (
                measured_figures.FORCE_FIGURE_SIZE_IN,
                lambda fig: measured_figures.draw_force_displacement(fig, curves),
            ),
            "fig8-payload": (
                measured_figures.PAYLOAD_FIGURE_SIZE_IN,
                lambda fig: measured_figures.draw_payloads(fig, payload_results),
            ),
        }
    return figure_functions


def draw_all_figures(folder: Path, experiment_results: Mapping[str, Any] | None) -> dict[str, Path]:
    """Draw every figure as PNG and SVG.

    Args:
        folder: folder to write to, created if it does not exist.
        experiment_results: results of `experiments.run_experiments`. If the results are None, the
            figures about measurements are left out.

    Returns:
        Path of the SVG file of each figure, by the name of the figure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    return {
        name: write_figure(folder, name, size, content)
        for name, (size, content) in figure_contents(experiment_results).items()
    }
