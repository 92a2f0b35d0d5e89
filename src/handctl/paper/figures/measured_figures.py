"""Fig. 5 of the paper, and a figure of the payload.

Both figures show measurements on the simulated test bench, and mark the values of the paper.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from handctl.paper import paper_data as src
from handctl.paper.bench import payload
from handctl.paper.bench.force_displacement import TendonCurve
from handctl.paper.figures.style import BLUE, GREEN, GREY, ORANGE, PURPLE, RED

FORCE_FIGURE_SIZE_IN = (7.6, 5.0)
PAYLOAD_FIGURE_SIZE_IN = (9.6, 6.4)
AXIS_COLOURS = (BLUE, ORANGE, GREEN)


def draw_force_displacement(figure: Any, curves: Sequence[TendonCurve]) -> None:
    """Draw the force-displacement curves of both tendons, the knees in the paper, and the stress limit of section 5."""
    axes = figure.subplots()
    allowed_tension = float(src.FINGER_GRIP_FORCE_N * src.tension_per_newton(src.paper_finger()))
    axis_limit = 1.12 * float(max(src.KNEE_TENSIONS_N))
    end = 1.08 * max(float(curve.displacement.max()) for curve in curves)
    axes.axhspan(allowed_tension, axis_limit, color=RED, alpha=0.07, linewidth=0)
    axes.axhline(allowed_tension, color=RED, linewidth=1.2)
    wire = src.wire_diameter_mm(allowed_tension)
    text = f"above: more than the 190 MPa allowed in the {wire:.4f} mm wire"
    axes.text(0.985 * end, allowed_tension - 3, text, color=RED, fontsize=8.5, ha="right", va="top")
    for knee, name in zip(src.KNEE_TENSIONS_N, ("section 5", "abstract"), strict=True):
        axes.axhline(float(knee), color=GREY, linewidth=1.0, linestyle=(0, (5, 3)))
        axes.text(
            0.02 * end,
            float(knee) + 3,
            f"“linear up to {knee} N” ({name})",
            color=GREY,
            fontsize=8.5,
        )
    stiffness = curves[0].stiffness
    axes.plot(
        [0, 1e3 * axis_limit / stiffness],
        [0, axis_limit],
        color="black",
        linewidth=0.9,
        linestyle=":",
        zorder=3,
    )
    for curve, colour in zip(curves, (BLUE, ORANGE), strict=True):
        label = f"measured, tendon with its knee at {curve.nominal_knee_N:g} N"
        axes.plot(
            curve.displacement[::4],
            curve.force[::4],
            ".",
            color=colour,
            markersize=3,
            label=label,
            zorder=4,
        )
        if curve.knee is not None:
            position = (1e3 * curve.knee / curve.stiffness, curve.knee)
            axes.plot(
                *position,
                "o",
                color="white",
                markeredgecolor=colour,
                markersize=8,
                markeredgewidth=1.8,
                zorder=6,
            )
            text = f"knee found at {curve.knee:.0f} ± {2 * curve.knee_sigma:.0f} N"
            axes.text(
                0.985 * end,
                curve.knee - 12,
                text,
                color=colour,
                weight="bold",
                ha="right",
                va="top",
            )
    axes.annotate(f"{stiffness / 1000:.1f} N/mm", (0.6, 60.0), (12, -6), textcoords="offset points")
    axes.set(
        xlabel="displacement of the tendon at the spool [mm]", ylabel="tension at the load cell [N]"
    )
    axes.set(
        xlim=(0, end), ylim=(0, axis_limit), title="Tendon of a blocked finger, pulled over the bus"
    )
    axes.legend(loc="lower right", fontsize=8.5, markerscale=4)
    # Stress is proportional to tension. Therefore the axis of the stress differs from the axis of
    # the tension only by a factor.
    factor = src.wire_stress_mpa(1.0, wire)
    stress_axis = axes.secondary_yaxis(
        "right", functions=(lambda force: force * factor, lambda mpa: mpa / factor)
    )
    stress_axis.set_ylabel(f"stress in the {wire:.4f} mm wire [MPa]")


def draw_payloads(figure: Any, payload_results: Sequence[Mapping[str, Any]]) -> None:
    """Draw the payload for each axis and diameter as a bar.

    Draw the displacement of the object as a curve over the increasing load.
    """
    grid = figure.add_gridspec(2, len(payload.LOAD_DIRECTIONS), height_ratios=(1.25, 1.0))
    _draw_payload_bars(figure.add_subplot(grid[0, :]), payload_results)
    first_axes = None
    for column, axis in enumerate(payload.LOAD_DIRECTIONS):
        axes = figure.add_subplot(grid[1, column], sharey=first_axes)
        first_axes = first_axes or axes
        _draw_load_traces(
            axes, axis, [result for result in payload_results if result["axis"] == axis]
        )
        if column == 0:
            axes.set(ylabel="load [kg]")


def _draw_payload_bars(axes: Any, payload_results: Sequence[Mapping[str, Any]]) -> None:
    """Draw the payload of each load case as a bar."""
    width = 0.26
    for k, diameter in enumerate(payload.DIAMETERS_MM):
        rows = {
            result["axis"]: result
            for result in payload_results
            if result["diameter_mm"] == diameter
        }
        positions = np.arange(len(payload.LOAD_DIRECTIONS)) + (k - 1) * width
        heights = [rows[axis]["payload_kg"] for axis in payload.LOAD_DIRECTIONS]
        bars = axes.bar(
            positions,
            heights,
            0.9 * width,
            color=AXIS_COLOURS[k],
            label=f"⌀ {diameter:g} mm",
            zorder=3,
        )
        prefixes = [
            "≥ " if rows[axis]["ended"] == "held" else "" for axis in payload.LOAD_DIRECTIONS
        ]
        axes.bar_label(
            bars,
            [f"{sign}{height:.2f}" for sign, height in zip(prefixes, heights, strict=True)],
            fontsize=8.5,
        )
        bounds = [payload.friction_bound_kg(rows[axis]) for axis in payload.LOAD_DIRECTIONS]
        axes.plot(
            positions, bounds, "_", color="black", markersize=20, markeredgewidth=1.6, zorder=4,
            label="Coulomb's bound, all normal forces before loading" if k == 2 else None)  # fmt: skip
    _draw_lines(axes)
    labels = [f"{axis}: {payload.AXIS_NAMES[axis]}" for axis in payload.LOAD_DIRECTIONS]
    axes.set_xticks(range(len(payload.LOAD_DIRECTIONS)), labels)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="x", visible=False)
    axes.set(
        ylabel="payload [kg]", title="Load at which the object slips, 6 N a finger, friction 0.5"
    )
    axes.set(xlim=(-0.55, len(payload.LOAD_DIRECTIONS) - 0.1), ylim=(0, 2.95))
    axes.legend(loc="upper left", ncols=4, fontsize=8.5)


def _draw_lines(axes: Any) -> None:
    """Draw two lines: the payload in the paper, and the payload with friction on both sides."""
    two_sided_payload_kg = 2.0 * float(src.payload_kg(src.FINGER_COUNT * src.FINGER_GRIP_FORCE_N))
    right_edge = len(payload.LOAD_DIRECTIONS) - 0.6
    for value, colour, text in (
        (float(src.PAYLOAD_KG), RED, f"paper:\n{src.PAYLOAD_KG} kg"),
        (two_sided_payload_kg, PURPLE, f"friction on\nboth sides:\n{two_sided_payload_kg:.3f} kg"),
    ):
        axes.hlines(value, -0.55, right_edge, color=colour, linewidth=1.3, linestyle="--", zorder=2)
        axes.text(right_edge + 0.03, value, text, color=colour, fontsize=8.5, va="center")


def _draw_load_traces(
    axes: Any, load_axis: str, payload_results: Sequence[Mapping[str, Any]]
) -> None:
    """Draw how far the object has moved as the load along one axis increases."""
    gravity = float(src.GRAVITY_M_PER_S2)
    for result, colour in zip(payload_results, AXIS_COLOURS, strict=True):
        axes.plot(
            result["trace_mm"], np.array(result["trace_N"]) / gravity, color=colour, linewidth=1.3
        )
        # The variable below is the first sample at which the load is at least the load at which the
        # object slipped.
        row = int(np.searchsorted(result["trace_N"], result["load_N"]))
        position = result["trace_mm"][min(row, len(result["trace_mm"]) - 1)]
        axes.plot(
            position,
            result["payload_kg"],
            "o",
            color="white",
            markeredgecolor=colour,
            markersize=6,
            zorder=5,
        )
    axes.axhline(float(src.PAYLOAD_KG), color=RED, linewidth=1.0, linestyle="--")
    axes.set(xlim=(0, 3.0), ylim=(0, 2.4), xlabel="object has moved [mm]")
    axes.set_title(f"along {load_axis}", fontsize=9.5)
