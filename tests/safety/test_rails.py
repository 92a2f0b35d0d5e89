"""A load cell at either end of its range says nothing about the rope."""

import math

import pytest

from handctl.safety.action import Action
from handctl.safety.calm import calm
from handctl.safety.faults.table import TABLE
from handctl.safety.judge import SafetyState, judge
from handctl.safety.signals import Limits, Signals

LIMITS = Limits(("a", "b"), (140.0, 140.0), 243.9, ("m", "n"), tension_low=-4.0)


@pytest.mark.parametrize("rail", [243.9, 249.0, -4.0, -6.0])
def test_a_cell_at_a_rail_relaxes_the_hand_at_the_third_tick(rail: float) -> None:
    state, actions = SafetyState(), []
    for _ in range(3):
        state, verdict = judge(state, LIMITS, Signals(armed=True, tension=(5.0, rail)))
        actions.append(verdict.action)
    assert actions == [Action.PASS, Action.PASS, Action.RELAX]
    assert [(mark.id, mark.instance) for mark in state.latched] == [("T06", "b")]


@pytest.mark.parametrize("tension", [-2.0, 0.0, 100.0, math.nan])
def test_what_a_rope_can_do_is_no_fault(tension: float) -> None:
    state = SafetyState()
    for _ in range(10):
        state, verdict = judge(state, LIMITS, Signals(armed=True, tension=(5.0, tension)))
        assert verdict.action == Action.PASS


def t06(signals: Signals) -> list[tuple[str, float]]:
    """What the row finds."""
    (row,) = [fault for fault in TABLE if fault.id == "T06"]
    return list(row.detect(LIMITS, signals))


def test_what_is_at_a_rail_is_told_once_with_what_it_reads_whatever_the_tare() -> None:
    """Of a tare of -3 N a broken wire reads -3 N, which a rope may for a moment."""
    signals = Signals(armed=True, tension=(5.0, -3.0), railed=(("b", -3.0),))
    assert t06(signals) == [("b", -3.0)]
    assert t06(signals._replace(armed=False)) == []
    assert t06(signals._replace(tension=(250.0, 244.0), railed=(("b", 244.0),))) == [("a", 250.0), ("b", 244.0)]
    assert not calm(LIMITS, signals._replace(motor_age=(0, 0)))
