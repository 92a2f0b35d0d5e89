"""Provide invented results of the paper's experiments.

Tests of pages and figures use the invented results instead of simulated results.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handctl.hand.tendons import TendonElasticity
from handctl.paper import paper_data as src
from handctl.paper.bench import payload
from handctl.paper.figures.all_figures import draw_all_figures


@pytest.fixture(scope="session")
def measured_results() -> dict[str, Any]:
    """Return invented results of tendon tests and load tests.

    The invented results cover two tendons with noise, and one load test for each combination of
    object diameter and load axis.
    """
    rng = np.random.default_rng(11)
    tendon_tests = []
    for knee in map(float, src.KNEE_TENSIONS_N):
        elasticity = TendonElasticity(1e5, 0.4e5, knee, 0.3e-3, 30.0)
        travel = np.linspace(1e-4, elasticity.stretch(242.0), 1500)
        force = np.array([elasticity.elastic_tension(x) for x in travel.tolist()]) + rng.normal(
            scale=0.5, size=len(travel)
        )
        tendon_tests.append(
            {"knee_N": knee, "travel_m": (travel + 4e-4).tolist(), "force_N": force.tolist()}
        )
    load_tests = [
        slip_test_result(diameter, axis, k)
        for k, diameter in enumerate(payload.DIAMETERS_MM)
        for axis in payload.LOAD_DIRECTIONS
    ]
    return {"force_displacement": {"ropes": tendon_tests}, "payload": load_tests}


def slip_test_result(diameter_mm: float, load_axis: str, case_index: int) -> dict[str, Any]:
    """Return the results of a test in which the load grows to 20 N, and the object slips at 8 to 14 N."""
    load = 8.0 + 3.0 * case_index
    moved = np.interp(np.linspace(0.0, 20.0, 200), [0.0, load, 20.0], [0.0, 0.3, 6.0])
    names = src.paper_hand().digit_names
    return {
        "diameter_mm": diameter_mm,
        "axis": load_axis,
        "tension_N": dict.fromkeys(names, 34.0),
        "normal_N": dict.fromkeys(names, 6.0),
        "palm_N": 12.0,
        "load_N": load,
        "ended": ("creep", "moved", "held")[case_index],
        "payload_kg": load / 9.81,
        "trace_N": np.linspace(0.0, 20.0, 200).tolist(),
        "trace_mm": moved.tolist(),
    }


@pytest.fixture(scope="session")
def drawn_figure_files(
    measured_results: dict[str, Any], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """Draw all figures of the paper once, and return the SVG file of each figure."""
    return draw_all_figures(tmp_path_factory.mktemp("figures"), measured_results)
