"""A load cell that reads an end of its range gives no information about the tension."""

import math
from dataclasses import replace

import pytest

from handctl.safety.safety_action import SafetyAction
from tests.safety.fault_cases import (
    input_without_torque,
    measured_tensions,
    merge_inputs,
    state_input,
)
from tests.safety.synthetic_monitor import SyntheticMonitor, synthetic_limits

LOAD_CELL_RAIL_LIMITS = replace(synthetic_limits(2), tension_rail=243.9, tension_low=-4.0)


@pytest.mark.parametrize("rail_tension_N", [243.9, 249.0, -4.0, -6.0])
def test_a_cell_at_a_rail_relaxes_the_hand_at_the_third_tick(rail_tension_N: float) -> None:
    monitor = SyntheticMonitor(LOAD_CELL_RAIL_LIMITS)
    actions = [
        monitor.judge(measured_tensions(t0=5.0, t1=rail_tension_N).state_values).action
        for _ in range(3)
    ]
    assert actions == [SafetyAction.PASS, SafetyAction.PASS, SafetyAction.RELAX]
    assert [(mark.id, mark.part_name) for mark in monitor.latched] == [("T06", "t1")]


@pytest.mark.parametrize("tension", [-2.0, 0.0, 100.0, math.nan])
def test_tensions_possible_for_a_tendon_are_no_fault(tension: float) -> None:
    monitor = SyntheticMonitor(LOAD_CELL_RAIL_LIMITS)
    force = {0: 5.0, 1: tension}
    explained_rows = state_input(measured_force=force, asked=force)
    tick_input = merge_inputs(measured_tensions(t0=5.0, t1=tension), explained_rows)
    for _ in range(10):
        assert monitor.judge(tick_input.state_values).action == SafetyAction.PASS


def test_a_saturated_load_cell_is_reported_once_with_its_reading_for_any_tare() -> None:
    """With a tare of -3 N, a load cell with a broken wire reads -3 N.

    Even an intact load cell can read -3 N for a moment.
    """
    tick_input = merge_inputs(measured_tensions(t1=-3.0), state_input(saturated={1: 1}))
    assert SyntheticMonitor(LOAD_CELL_RAIL_LIMITS).tick(tick_input.state_values)["T06"] == {
        "t1": -3.0
    }
    assert "T06" not in SyntheticMonitor(LOAD_CELL_RAIL_LIMITS).tick(
        input_without_torque(tick_input).state_values
    )
    high = merge_inputs(measured_tensions(t0=250.0, t1=244.0), state_input(saturated={1: 1}))
    assert SyntheticMonitor(LOAD_CELL_RAIL_LIMITS).tick(high.state_values)["T06"] == {
        "t0": 250.0,
        "t1": 244.0,
    }
