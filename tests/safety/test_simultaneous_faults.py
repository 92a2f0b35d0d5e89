"""Test the reactions to several faults at once.

The controller executes the most severe action, latched faults stay, and further faults never weaken
the action.
"""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handctl.core.tick_types import HandMode
from handctl.safety.faults.table import FAULT_TABLE
from handctl.safety.safety_action import SafetyAction
from handctl.safety.tick_verdict import LatchedFault
from tests.safety.fault_cases import (
    CASE_BY_FAULT,
    INPUT_AT_REST,
    TickInput,
    event_report,
    late_motor_frames,
    measured_tensions,
    merge_inputs,
    monitor_at_rest,
    reset_monitor_for_input,
    state_input,
)
from tests.safety.synthetic_monitor import SyntheticMonitor
from tests.safety.test_fault_table import judge_ticks

FAULTS_WHILE_ARMED = [
    id_
    for id_ in CASE_BY_FAULT
    if CASE_BY_FAULT[id_].input_with_fault.state_values.get("mode", {...: HandMode.ACTIVE})[...]
    in (4, 5)
]
FAULT_PAIRS = list(pairwise([*FAULTS_WHILE_ARMED, FAULTS_WHILE_ARMED[0]])) + [
    (a, b) for a in ("B02", "T03", "N09b") for b in FAULTS_WHILE_ARMED if a != b
]


def verdict_on_input(monitor: SyntheticMonitor, tick_input: TickInput):
    return monitor.judge(reset_monitor_for_input(monitor, tick_input), tick_input.reports)


def test_every_fault_of_the_active_mode_is_paired() -> None:
    assert set(CASE_BY_FAULT) - set(FAULTS_WHILE_ARMED) == {"B18", "N16"}


@pytest.mark.parametrize(("first_fault_id", "second_fault_id"), FAULT_PAIRS)
def test_two_simultaneous_faults_are_reported_with_the_more_severe_action(
    first_fault_id: str, second_fault_id: str
) -> None:
    a, b = CASE_BY_FAULT[first_fault_id], CASE_BY_FAULT[second_fault_id]
    merged_input = merge_inputs(a.input_with_fault, b.input_with_fault)
    monitor, verdicts = judge_ticks(*[merged_input] * max(a.debounce_ticks, b.debounce_ticks))
    assert verdicts[-1].action >= max(a.action, b.action)
    reported = {(f.fault.id, f.part_name) for verdict in verdicts for f in verdict.findings}
    assert {(first_fault_id, a.faulty_part), (second_fault_id, b.faulty_part)} <= reported
    for id_, case in ((first_fault_id, a), (second_fault_id, b)):
        assert (LatchedFault(id_, case.faulty_part) in monitor.latched) == case.is_latched


@pytest.mark.parametrize(
    ("first_fault_id", "second_fault_id"),
    [*FAULT_PAIRS, ("B02", "N16"), ("N16", "B02"), ("B18", "T03"), ("N16", "T09")],
)
def test_a_second_fault_neither_ends_nor_hides_the_first(
    first_fault_id: str, second_fault_id: str
) -> None:
    """In this test, the first fault ends before the second fault begins.

    The first fault stays latched, and the second fault is still reported.
    """
    a, b = CASE_BY_FAULT[first_fault_id], CASE_BY_FAULT[second_fault_id]
    monitor, first_verdicts = judge_ticks(*[a.input_with_fault] * a.debounce_ticks, INPUT_AT_REST)
    _, verdicts = judge_ticks(*[b.input_with_fault] * b.debounce_ticks, monitor=monitor)
    expected = max(b.action, a.action if a.is_latched else SafetyAction.PASS)
    assert verdicts[-1].action >= expected
    reported = [f.fault.id for verdict in (*first_verdicts, *verdicts) for f in verdict.findings]
    assert second_fault_id in reported
    _, (verdict_after,) = judge_ticks(INPUT_AT_REST, monitor=monitor)
    latched_actions = [case.action for case in (a, b) if case.is_latched]
    assert verdict_after.action >= max(latched_actions, default=SafetyAction.PASS)
    monitor.clear_latched()
    _, (verdict_without_fault,) = judge_ticks(INPUT_AT_REST, monitor=monitor)
    assert verdict_without_fault.action == SafetyAction.PASS
    assert monitor.latched == ()


def test_the_same_fault_of_two_instances_is_two_faults() -> None:
    monitor, (verdict,) = judge_ticks(late_motor_frames(m0=6))
    _, (two,) = judge_ticks(late_motor_frames(m1=6), monitor=monitor)
    assert [f.part_name for f in verdict.findings if f.fault.id == "B02"] == ["m0"]
    assert [f.part_name for f in two.findings if f.fault.id == "B02"] == ["m1"]
    assert [mark.part_name for mark in monitor.latched if mark.id == "B02"] == ["m0", "m1"]


def test_instances_do_not_share_their_debounce_counts() -> None:
    left_input, right_input = measured_tensions(t0=244.0), measured_tensions(t1=244.0)
    _, verdicts = judge_ticks(
        left_input, right_input, left_input, right_input, left_input, right_input
    )
    assert {verdict.action for verdict in verdicts} == {SafetyAction.PASS}


def test_two_events_of_one_bus_in_one_tick_are_one_tick() -> None:
    two_overflow_reports = TickInput(
        reports=(
            *event_report("enobufs", "can0", 1).reports,
            *event_report("enobufs", "can0", 2).reports,
        )
    )
    _, verdicts = judge_ticks(two_overflow_reports)
    assert verdicts[0].action == SafetyAction.PASS
    _, verdicts = judge_ticks(two_overflow_reports, two_overflow_reports)
    assert verdicts[-1].action == SafetyAction.RELAX
    assert len(verdicts[-1].findings) == 1


INPUTS_WITH_MANY_FRAMES = {id_: state_input(frames=6 * 64 + 1) for id_ in ("B11a", "B11b")}
"""Inputs with too many frames.

The number of frames exceeds the limit even if ticks were missed because of another fault of the
test.
"""
INPUT_BY_FAULT = {
    id_: INPUTS_WITH_MANY_FRAMES.get(id_, CASE_BY_FAULT[id_].input_with_fault)
    for id_ in FAULTS_WHILE_ARMED
}
fault_ids = st.lists(st.sampled_from(FAULTS_WHILE_ARMED), max_size=4)
inputs_with_faults = fault_ids.map(lambda ids: merge_inputs(*(INPUT_BY_FAULT[i] for i in ids)))
fault_sequences = st.lists(st.tuples(inputs_with_faults, fault_ids, st.booleans()), max_size=30)


@given(fault_sequences)
def test_additional_faults_never_weaken_the_action(
    ticks: list[tuple[TickInput, list[str], bool]],
) -> None:
    """The test makes two runs with the same requests to clear faults.

    The second run has additional faults in some ticks. The action in the second run is never weaker
    than in the first run.
    """
    monitor_with_fewer_faults, monitor_with_more_faults = monitor_at_rest(), monitor_at_rest()
    for tick_input, added_faults, cleared in ticks:
        if cleared:
            monitor_with_fewer_faults.clear_latched()
            monitor_with_more_faults.clear_latched()
        verdict_with_fewer_faults = verdict_on_input(monitor_with_fewer_faults, tick_input)
        verdict_with_more_faults = verdict_on_input(
            monitor_with_more_faults,
            merge_inputs(tick_input, *(INPUT_BY_FAULT[i] for i in added_faults)),
        )
        assert verdict_with_more_faults.action >= verdict_with_fewer_faults.action
        assert set(monitor_with_fewer_faults.latched) <= set(monitor_with_more_faults.latched)


@given(fault_sequences)
def test_latches_only_grow_between_clearings(
    ticks: list[tuple[TickInput, list[str], bool]],
) -> None:
    monitor, reported = monitor_at_rest(), list[tuple[str, str]]()
    for tick_input, _, cleared in ticks:
        latched_before = () if cleared else monitor.latched
        if cleared:
            monitor.clear_latched()
        verdict = verdict_on_input(monitor, tick_input)
        assert monitor.latched[: len(latched_before)] == latched_before, (
            "in the order in which they came"
        )
        assert len(set(monitor.latched)) == len(monitor.latched)
        actions = {fault.id: fault.action for fault in FAULT_TABLE}
        assert verdict.action >= max(
            (actions[mark.id] for mark in monitor.latched), default=SafetyAction.PASS
        )
        reported += [(f.fault.id, f.part_name) for f in verdict.findings]
        assert {(mark.id, mark.part_name) for mark in monitor.latched} <= set(reported), (
            "nothing latches in silence"
        )


def test_actions_are_ordered() -> None:
    assert (
        SafetyAction.PASS
        < SafetyAction.WARN
        < SafetyAction.HOLD
        < SafetyAction.RELAX
        < SafetyAction.CUT
    )
