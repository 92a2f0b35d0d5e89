"""Test every fault just below and just above its limit.

The tests check the action of each fault, too, and whether only an operator is allowed to clear the
fault.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from handctl.core.detectors import fault_detection as compiled_judge
from handctl.core.detectors.residuals import COMMAND_DIFFERENCE
from handctl.safety import tick_verdict as judgement
from handctl.safety.faults.fault import (
    CLEARED_BY_ITSELF,
    CLEARED_BY_OPERATOR,
    FAULT_PLACE_TENDON,
    Fault,
)
from handctl.safety.faults.table import (
    ACTION_NUMBERS,
    DEBOUNCE_TICKS,
    DETECTOR_ROWS,
    FAULT_BY_ID,
    FAULT_TABLE,
    FAULTS_BY_EVENT_KIND,
)
from handctl.safety.safety_action import RelaxMethod, SafetyAction
from handctl.safety.safety_limits import SafetyLimits, tick_count_for_time
from handctl.safety.tick_verdict import TickVerdict
from tests.safety.fault_cases import (
    ALTERNATIVE_INPUTS_BY_FAULT,
    CASE_BY_FAULT,
    EIGHT_TENDON_LIMITS,
    INPUT_AT_REST,
    TickInput,
    drive_temperatures,
    filtered_residuals,
    input_without_torque,
    measured_tensions,
    merge_inputs,
    monitor_at_rest,
    reset_monitor_for_input,
)
from tests.safety.synthetic_monitor import SyntheticMonitor, call_interpreted

SAFETY_PAGE = Path(__file__).parents[2] / "docs/explanation/safety.md"


def judge_ticks(
    *tick_inputs: TickInput, monitor: SyntheticMonitor | None = None
) -> tuple[SyntheticMonitor, list[TickVerdict]]:
    """Let the safety monitor judge several ticks in a row.

    Return the monitor and its verdict on each tick.
    """
    monitor = monitor or monitor_at_rest()
    return monitor, [
        monitor.judge(reset_monitor_for_input(monitor, tick_input), tick_input.reports)
        for tick_input in tick_inputs
    ]


def check_fault_alone(
    fault_id: str, *tick_inputs: TickInput, monitor: SyntheticMonitor | None = None
) -> tuple[SyntheticMonitor, list[SafetyAction], list[tuple[str, str]]]:
    """Let the safety monitor judge several ticks, and evaluate only the fault ``fault_id``.

    Return the monitor after the judged ticks, the action that the monitor demands in each tick, and
    the findings that the monitor reports.
    """
    monitor, actions, reported = monitor or monitor_at_rest(), [], []
    for tick_input in tick_inputs:
        verdict = monitor.judge(reset_monitor_for_input(monitor, tick_input), tick_input.reports)
        fault_rows = [row for row, (fault, _) in enumerate(DETECTOR_ROWS) if fault.id == fault_id]
        ticks_present = [int(monitor.view("fault_ticks")[row].max()) for row in fault_rows]
        ticks_present += [
            reported_fault.ticks
            for reported_fault in verdict.reported_faults
            if reported_fault.id == fault_id
        ]
        is_debounced = max(ticks_present, default=0) >= FAULT_BY_ID[
            fault_id
        ].debounce_ticks or fault_id in {mark.id for mark in verdict.latched_faults}
        actions.append(FAULT_BY_ID[fault_id].action if is_debounced else SafetyAction.PASS)
        assert verdict.action >= actions[-1], "the largest wins"
        reported += [(f.fault.id, f.part_name) for f in verdict.findings if f.fault.id == fault_id]
    return monitor, actions, reported


def test_every_row_has_a_case_and_is_there_once() -> None:
    assert [fault.id for fault in FAULT_TABLE] == list(CASE_BY_FAULT)


def test_hand_without_disturbance_has_no_fault() -> None:
    monitor, verdicts = judge_ticks(*[INPUT_AT_REST] * 50)
    assert (monitor.latched, monitor.reported_faults) == ((), ())
    assert {verdict.action for verdict in verdicts} == {SafetyAction.PASS}
    assert not any(verdict.findings for verdict in verdicts)


@pytest.mark.parametrize("fault_id", CASE_BY_FAULT)
def test_a_fault_counts_after_its_ticks_and_is_reported_once(fault_id: str) -> None:
    case = CASE_BY_FAULT[fault_id]
    _, actions, reported = check_fault_alone(
        fault_id, *[case.input_with_fault] * (case.debounce_ticks - 1)
    )
    assert (actions, reported) == ([SafetyAction.PASS] * (case.debounce_ticks - 1), [])
    _, actions, reported = check_fault_alone(
        fault_id, *[case.input_with_fault] * (case.debounce_ticks + 5)
    )
    assert actions == [SafetyAction.PASS] * (case.debounce_ticks - 1) + [case.action] * 6
    assert reported == [(fault_id, case.faulty_part)]


def test_a_drive_with_a_small_limit_disobeys_at_a_tenth_of_it() -> None:
    """Reproduce a defect: for weak drives, the threshold of the fault N14 (a command is not obeyed) was too high.

    The threshold was 15 N even for a drive with a limit of 60 N.
    """
    tick_input = filtered_residuals(COMMAND_DIFFERENCE, m1=6.1)
    _, _, reported = check_fault_alone("N14", tick_input)
    assert reported == [("N14", "m1")]


@pytest.mark.parametrize("fault_id", CASE_BY_FAULT)
def test_just_below_its_threshold_it_never_counts(fault_id: str) -> None:
    _, actions, reported = check_fault_alone(
        fault_id, *[CASE_BY_FAULT[fault_id].input_below_limit] * 100
    )
    assert set(actions) == {SafetyAction.PASS}
    assert not reported


@pytest.mark.parametrize("fault_id", ALTERNATIVE_INPUTS_BY_FAULT)
def test_every_sign_of_a_fault_is_detected(fault_id: str) -> None:
    for tick_input in ALTERNATIVE_INPUTS_BY_FAULT[fault_id]:
        _, actions, _ = check_fault_alone(
            fault_id, *[tick_input] * CASE_BY_FAULT[fault_id].debounce_ticks
        )
        assert actions[-1] == CASE_BY_FAULT[fault_id].action


@pytest.mark.parametrize("fault_id", CASE_BY_FAULT)
def test_interrupted_fault_counts_from_zero(fault_id: str) -> None:
    case = CASE_BY_FAULT[fault_id]
    if case.debounce_ticks == 1:
        return
    input_below_debounce = [case.input_with_fault] * (case.debounce_ticks - 1)
    _, actions, _ = check_fault_alone(
        fault_id, *input_below_debounce, INPUT_AT_REST, *input_below_debounce, INPUT_AT_REST
    )
    assert set(actions) == {SafetyAction.PASS}


@pytest.mark.parametrize("fault_id", CASE_BY_FAULT)
def test_latched_fault_stays_until_cleared(fault_id: str) -> None:
    case = CASE_BY_FAULT[fault_id]
    monitor, _, _ = check_fault_alone(fault_id, *[case.input_with_fault] * case.debounce_ticks)
    _, actions, reported = check_fault_alone(fault_id, *[INPUT_AT_REST] * 100, monitor=monitor)
    assert set(actions) == {case.action if case.is_latched else SafetyAction.PASS}
    assert not reported
    monitor.clear_latched()
    _, actions, _ = check_fault_alone(fault_id, INPUT_AT_REST, monitor=monitor)
    assert actions == [SafetyAction.PASS]
    _, actions, reported = check_fault_alone(
        fault_id, *[case.input_with_fault] * case.debounce_ticks, monitor=monitor
    )
    assert actions[-1] == case.action, "it can come again"
    assert [name for name, _ in reported] == [fault_id], "and is reported again"


@pytest.mark.parametrize(
    "fault_id", [id_ for id_, case in CASE_BY_FAULT.items() if case.is_latched]
)
def test_clearing_a_present_fault_has_no_effect(fault_id: str) -> None:
    case = CASE_BY_FAULT[fault_id]
    monitor, _, _ = check_fault_alone(
        fault_id, *[case.input_with_fault] * (case.debounce_ticks + 3)
    )
    monitor.clear_latched()
    _, actions, _ = check_fault_alone(fault_id, case.input_with_fault, monitor=monitor)
    assert actions == [case.action]
    _, actions, _ = check_fault_alone(fault_id, INPUT_AT_REST, monitor=monitor)
    assert actions == [case.action], "it has latched again"


@pytest.mark.parametrize("fault_id", CASE_BY_FAULT)
def test_a_silent_drive_is_no_fault_while_torque_is_off(fault_id: str) -> None:
    case = CASE_BY_FAULT[fault_id]
    _, actions, _ = check_fault_alone(
        fault_id, *[input_without_torque(case.input_with_fault)] * (case.debounce_ticks + 1)
    )
    assert actions[-1] == (SafetyAction.PASS if case.is_found_only_while_armed else case.action)


def test_a_missing_sample_is_neither_tension_nor_temperature() -> None:
    nan_values = {f"t{i}": math.nan for i in range(len(EIGHT_TENDON_LIMITS.tendons))}
    _, verdicts = judge_ticks(
        *[merge_inputs(measured_tensions(**nan_values), drive_temperatures(**nan_values))] * 30
    )
    assert {verdict.action for verdict in verdicts} == {SafetyAction.PASS}


def test_each_row_is_one_line_for_the_operator() -> None:
    for fault in FAULT_TABLE:
        assert fault.title
        assert fault.detection
        assert "\n" not in fault.title + fault.detection
        assert fault.cleared_by in ("by the operator", "by itself")
        assert fault.is_latched == CASE_BY_FAULT[fault.id].is_latched
        assert fault.action < SafetyAction.RELAX or fault.is_latched, (
            "only a person ends a relax or a cut"
        )


FAULTS_OF_TENSION_LOOP = {
    "N04",
    "N05b",
    "N06b",
    "N12",
    "N13",
    "N14",
    "N14b",
    "N17",
    "T04b",
    "T05b",
    "B06",
    "H13",
}
"""Faults after which the tension loop is not reliable.

Measurements of the tension loop are possibly wrong, or a drive possibly does not obey the commands
of the loop.
"""


def test_faults_of_the_tension_loop_relax_without_it() -> None:
    relax_method_by_fault = {
        fault_row.id: fault_row.relax_method
        for fault_row in FAULT_TABLE
        if fault_row.action >= SafetyAction.RELAX
    }
    assert {
        relaxing_fault
        for relaxing_fault, release in relax_method_by_fault.items()
        if release is RelaxMethod.OPEN_LOOP
    } == FAULTS_OF_TENSION_LOOP
    assert {
        relaxing_fault
        for relaxing_fault, release in relax_method_by_fault.items()
        if release is RelaxMethod.FAST_TENSION_LOOP
    } == {
        "T03",
        "T06",
    }


def test_properties_of_faults_are_consistent() -> None:
    for fault in FAULT_TABLE:
        if fault.makes_tension_unreliable or fault.shows_torque_after_cut:
            assert fault.is_latched, fault.id
            assert FAULT_PLACE_TENDON in fault.fault_places, fault.id
        if fault.caused_by_lateness:
            assert fault.is_latched, fault.id
        if fault.makes_tension_unreliable:
            assert fault.needs_load_cell, fault.id
        if fault.needs_load_cell or fault.needs_joint_encoders:
            assert FAULT_PLACE_TENDON in fault.fault_places, fault.id


def test_the_safety_page_lists_how_each_fault_relaxes() -> None:
    rows = [
        line.split("|")
        for line in SAFETY_PAGE.read_text().splitlines()
        if line.startswith("| RELAX ")
    ]
    listed = {row[1].strip(): set(re.findall(r"[A-Z]\d\d[a-c]?", row[3])) for row in rows}
    for release in (RelaxMethod.FAST_TENSION_LOOP, RelaxMethod.OPEN_LOOP):
        # A fault that disables the motors at once does not relax the hand.
        relaxing_faults = {
            fault_row.id
            for fault_row in FAULT_TABLE
            if fault_row.relax_method is release and fault_row.action is SafetyAction.RELAX
        }
        assert listed[release.value] == relaxing_faults


def test_a_fault_is_either_found_or_reported() -> None:
    """Each fault is either found by a detector, or reported by a bus or the host.

    A detector has one row in the fault table for each kind of part in which it can find the fault.
    """
    for fault in FAULT_TABLE:
        assert bool(fault.fault_places) != bool(fault.reports), fault.id
        assert [kind for row_fault, kind in DETECTOR_ROWS if row_fault is fault] == list(
            fault.fault_places
        )
        assert fault.name or "hand" not in fault.fault_places
    assert len(DETECTOR_ROWS) <= len(monitor_at_rest().view("fault_ticks")), (
        "there is room for how long each is present"
    )
    assert [fault.debounce_ticks for fault, _ in DETECTOR_ROWS] == DEBOUNCE_TICKS.tolist()
    assert [fault.action for fault, _ in DETECTOR_ROWS] == ACTION_NUMBERS.tolist()
    assert {
        fault.id for faults_of_kind in FAULTS_BY_EVENT_KIND.values() for fault in faults_of_kind
    } == {f.id for f in FAULT_TABLE if f.reports}


@pytest.mark.parametrize(("duration_s", "period_s", "minimum_ticks", "expected_ticks"), [
    (0.030, 0.005, 4, 6), (0.030, 0.002, 4, 15), (0.030, 0.01, 4, 4), (0.025, 0.002, 3, 13), (0.025, 0.02, 3, 3),
])  # fmt: skip
def test_a_time_is_rounded_to_ticks(
    duration_s: float, period_s: float, minimum_ticks: int, expected_ticks: int
) -> None:
    assert tick_count_for_time(duration_s, period_s, minimum_ticks) == expected_ticks


def fault_trace(fault_id: str) -> list[tuple[SafetyAction, int]]:
    """Return the action and the number of findings of one fault in each tick.

    In the first tick, the input is just below the limit of the fault. In the following ticks, the
    fault is present. In the last tick, the hand is at rest, and the fault is absent.

    The debouncing runs as Python code, without compilation. With debouncing, a fault counts only
    after some ticks in a row.
    """
    case, monitor, actions_and_counts = CASE_BY_FAULT[fault_id], monitor_at_rest(), []
    rows_of_fault = {row for row, (fault, _) in enumerate(DETECTOR_ROWS) if fault.id == fault_id}
    for tick_input in [
        case.input_below_limit,
        *[case.input_with_fault] * (case.debounce_ticks + 1),
        INPUT_AT_REST,
    ]:
        rows, ticks_before = (
            reset_monitor_for_input(monitor, tick_input),
            monitor.view("fault_ticks").copy(),
        )
        monitor.tick(rows)
        monitor.set_state_values({"fault_ticks": ticks_before})
        monitor.found_values[
            [row for row in range(len(DETECTOR_ROWS)) if row not in rows_of_fault]
        ] = math.nan
        demanded_action = call_interpreted(
            compiled_judge.debounce_faults, monitor.state_tables, monitor.found_values
        )
        reports = tick_input.reports if judgement.FAULT_BY_ID[fault_id].reports else ()
        verdict = monitor.conclude(demanded_action, reports)
        actions_and_counts.append((verdict.action, len(verdict.findings)))
    return actions_and_counts


@pytest.fixture
def redeclare_fault(monkeypatch: pytest.MonkeyPatch) -> Iterator[object]:
    """Return a function that replaces the declaration of a fault in the fault table by a changed declaration."""

    def declare_fault(changed_fault: Fault) -> None:
        changed_rows = tuple(
            (changed_fault if fault.id == changed_fault.id else fault, kind)
            for fault, kind in DETECTOR_ROWS
        )
        monkeypatch.setattr(judgement, "DETECTOR_ROWS", changed_rows)
        monkeypatch.setattr(
            judgement, "FAULT_BY_ID", FAULT_BY_ID | {changed_fault.id: changed_fault}
        )
        monkeypatch.setattr(judgement, "FAULTS_BY_EVENT_KIND", {
            kind: tuple(changed_fault for fault in faults_of_kind if fault.id == changed_fault.id)
            for kind, faults_of_kind in FAULTS_BY_EVENT_KIND.items()
        })  # fmt: skip
        debounce, actions = DEBOUNCE_TICKS.copy(), ACTION_NUMBERS.copy()
        for row, (fault, _) in enumerate(changed_rows):
            debounce[row], actions[row] = fault.debounce_ticks, fault.action
        monkeypatch.setattr(judgement, "DEBOUNCE_TICKS", debounce)
        monkeypatch.setattr(compiled_judge, "DEBOUNCE_TICKS", debounce)
        monkeypatch.setattr(compiled_judge, "ACTION_NUMBERS", actions)

    return declare_fault


@pytest.mark.parametrize("fault_id", CASE_BY_FAULT)
def test_a_changed_row_would_be_noticed(fault_id: str, redeclare_fault) -> None:
    """Change each value in the declaration of a fault by one step, and check that the fault is then judged differently.

    If the judgement differs, the test cases of the fault notice a wrong declaration.
    """
    fault = FAULT_BY_ID[fault_id]
    other_clearing = CLEARED_BY_ITSELF if fault.is_latched else CLEARED_BY_OPERATOR
    changed = [
        replace(fault, debounce_ticks=fault.debounce_ticks + 1),
        replace(fault, cleared_by=other_clearing),
    ]
    changed += (
        [replace(fault, debounce_ticks=fault.debounce_ticks - 1)]
        if fault.debounce_ticks > 1
        else []
    )
    changed += [
        replace(fault, action=SafetyAction(fault.action + step))
        for step in (-1, 1)
        if 0 <= fault.action + step <= 4
    ]
    redeclare_fault(fault)
    expected_trace = fault_trace(fault_id)
    for mutant in changed:
        if (mutant.action, mutant.is_latched) == (
            SafetyAction.PASS,
            True,
        ) or fault.action == mutant.action == SafetyAction.PASS:
            continue  # a latched fault without an action has no effect
        redeclare_fault(mutant)
        assert fault_trace(fault_id) != expected_trace, mutant


THRESHOLD_STEP_BY_FAULT = {
    "B02": {"silent_ticks": 1}, "N02": {"silent_ticks": 1}, "H03": {"stalled_ticks": 1},
    "N09a": {"temperature_soft": 0.2}, "N09b": {"temperature_hard": 0.2},
    "T06": {"tension_rail": 0.1},
}  # fmt: skip


@pytest.mark.parametrize("fault_id", THRESHOLD_STEP_BY_FAULT)
@pytest.mark.parametrize("step_sign", [-1, 1])
def test_a_moved_threshold_would_be_noticed(fault_id: str, step_sign: int) -> None:
    name, step = next(iter(THRESHOLD_STEP_BY_FAULT[fault_id].items()))
    moved: SafetyLimits = replace(
        EIGHT_TENDON_LIMITS, **{name: getattr(EIGHT_TENDON_LIMITS, name) + step_sign * step}
    )
    case, monitor = CASE_BY_FAULT[fault_id], monitor_at_rest()
    monitor.replace_limits(moved)
    _, actions, _ = check_fault_alone(
        fault_id,
        *[case.input_with_fault if step_sign > 0 else case.input_below_limit] * case.debounce_ticks,
        monitor=monitor,
    )
    assert actions[-1] == (SafetyAction.PASS if step_sign > 0 else case.action)
