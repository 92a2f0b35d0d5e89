"""Rows at their very limits, and what they say of a fault besides that there is one."""

import math

import pytest

from handctl.safety.action import Action
from handctl.safety.calm import calm
from handctl.safety.faults.table import TABLE
from handctl.safety.judge import Latched, SafetyState, judge
from handctl.safety.signals import Signals
from tests.safety.test_table import LIMITS, course, io, tensions, with_

DETECT = {fault.id: fault.detect for fault in TABLE}
QUIET = Signals(armed=True, motor_age=(0, 0), sensor_age=(0, 0), tension=(20.0, 20.0), temperature=(40.0, 40.0))
"""A tick in which nothing is worth telling of residuals and the like."""


def readings(id_: str, signals: Signals) -> list[tuple[str, float]]:
    return list(DETECT[id_](LIMITS, signals))


def test_a_latched_fault_outlives_a_tick_with_nothing_near_any_limit() -> None:
    assert calm(LIMITS, QUIET)
    before = SafetyState(latched=(Latched("T03", "t0"), Latched("B12", "can0")))
    after, verdict = judge(before, LIMITS, QUIET)
    assert after.latched == before.latched
    assert (verdict.action, verdict.findings) == (Action.CUT, ())
    assert judge(SafetyState(), LIMITS, QUIET)[1].action == Action.PASS


def test_a_finding_says_how_large_it_was() -> None:
    _, verdicts = course(io("bus_off", number=7))
    assert [finding.value for verdict in verdicts for finding in verdict.findings] == [7.0]
    assert readings("N15", with_(halved=("m0",))) == [("m0", 0.5)], "half of its answers"
    (row,) = [id_ for id_ in DETECT if readings(id_, with_(foreign=("0x123",)))]
    assert readings(row, with_(foreign=("0x123",))) == [("0x123", 1.0)]


def test_nobody_answers_in_ticks_that_the_host_missed() -> None:
    assert readings("B01", with_(missed=3, motor_age=(3, 3))) == []
    assert readings("B01", with_(missed=3, motor_age=(3, 4))) == [("m1", 4)]
    assert readings("B01", with_(motor_age=(1, 0))) == [("m0", 1)]


def test_a_node_that_does_not_hear_misses_as_many_ticks_as_the_row_says() -> None:
    most = LIMITS.one_silent_ticks
    assert readings("B17", with_(motor_age=(most - 1, 0))) == []
    assert readings("B17", with_(motor_age=(0, most))) == [("m1", float(most))]


def test_alone_on_the_bus_is_one_reading_of_error_frames_that_mean_it() -> None:
    silent = Signals(armed=False, heard=False)
    unheard, other = ("error_frame", "can0 no acknowledge", 3), ("error_frame", "can0 overload", 2)
    assert readings("B18", silent._replace(io=(other, unheard, unheard))) == [("can0 no acknowledge", 3.0)]
    assert readings("B18", silent._replace(io=(other, ("enobufs", "protocol", 1)))) == []


def test_a_tension_at_the_rail_is_the_load_cell_s_and_below_it_the_rope_s() -> None:
    rail = LIMITS.tension_rail
    for row in ("T03", "T03b"):
        assert [name for name, _ in readings(row, tensions(math.nextafter(rail, 0.0), 0.0))] == ["t0"], row
        assert readings(row, tensions(rail, 0.0)) == [], row


def test_over_tension_stays_at_the_rail_as_well_as_below_and_only_behind_relaxing() -> None:
    high = tensions(math.nan, LIMITS.tension_rail + 1.0)
    assert readings("T03c", high) == []
    assert readings("T03c", high._replace(relaxed=True)) == [("t1", LIMITS.tension_rail + 1.0)]
    assert readings("T03c", tensions()._replace(relaxed=True)) == []


@pytest.mark.parametrize("row", ["T03", "T03b", "T06"])
def test_nothing_is_said_of_tensions_that_were_not_read(row: str) -> None:
    assert readings(row, tensions()) == []
    assert [name for name, _ in readings(row, tensions(243.0 if row != "T06" else 300.0))] == ["t0"], "one of two"
