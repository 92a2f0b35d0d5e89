"""Test each fault exactly at its limit, and the text that the fault adds to an event."""

import math

import pytest

from handctl.safety.safety_action import SafetyAction
from handctl.safety.tick_verdict import LatchedFault, locate_reports, second_controller_reports
from tests.safety.fault_cases import (
    EIGHT_TENDON_LIMITS,
    INPUT_AT_REST,
    RELAX_STATE_VALUES,
    TickInput,
    event_report,
    late_motor_frames,
    lost_frames,
    measured_tensions,
    merge_inputs,
    monitor_at_rest,
    reset_monitor_for_input,
    state_input,
)
from tests.safety.test_fault_table import judge_ticks

NAN = math.nan
INPUT_WITHOUT_TENSIONS = measured_tensions(**dict.fromkeys(EIGHT_TENDON_LIMITS.tendons, NAN))


def findings_of_fault(fault_id: str, tick_input: TickInput) -> list[tuple[str, float]]:
    """Run the detectors for one tick, and return the findings of one fault as pairs (part of the hand, value)."""
    monitor = monitor_at_rest()
    return list(
        monitor.tick(reset_monitor_for_input(monitor, tick_input)).get(fault_id, {}).items()
    )


def test_a_latched_fault_remains_in_a_tick_without_symptoms() -> None:
    monitor = monitor_at_rest()
    monitor.latched = (LatchedFault("T03", "t0"), LatchedFault("B12", "can0"))
    verdict = monitor.judge()
    assert monitor.latched == (LatchedFault("T03", "t0"), LatchedFault("B12", "can0"))
    assert (verdict.action, verdict.findings) == (SafetyAction.CUT, ())
    assert monitor_at_rest().judge().action == SafetyAction.PASS


def test_a_finding_has_its_measured_value() -> None:
    _, verdicts = judge_ticks(event_report("bus_off", report_value=7))
    assert [finding.value for verdict in verdicts for finding in verdict.findings] == [7.0]
    assert findings_of_fault("N15", TickInput({"lost": {(0, 0): 0b1010101010101}})) == [
        ("m0", 0.5)
    ], "half of its answers"
    reports = second_controller_reports(["0x123"])
    assert [(f.id, name, value) for f, name, value in locate_reports(reports)] == [
        ("H13", "0x123", 1.0)
    ]


def test_no_replies_are_expected_in_ticks_missed_by_the_host() -> None:
    input_with_late_motors = late_motor_frames(**dict.fromkeys(EIGHT_TENDON_LIMITS.motors, 3))
    assert (
        findings_of_fault("B01", merge_inputs(input_with_late_motors, state_input(missed=3))) == []
    )
    assert findings_of_fault(
        "B01", merge_inputs(input_with_late_motors, state_input(missed=3), late_motor_frames(m1=4))
    ) == [("m1", 4)]
    assert findings_of_fault("B01", late_motor_frames(m0=1)) == [("m0", 1)]


def test_a_node_without_reply_is_reported_after_the_stated_number_of_ticks() -> None:
    silent_ticks = EIGHT_TENDON_LIMITS.silent_ticks_of_single_motor
    assert findings_of_fault("B17", late_motor_frames(m0=silent_ticks - 1)) == []
    assert findings_of_fault("B17", late_motor_frames(m1=silent_ticks)) == [
        ("m1", float(silent_ticks))
    ]


def test_losses_of_a_hundred_ticks_are_reported_with_their_number() -> None:
    assert findings_of_fault("B03a", lost_frames(m1=21)) == [("m1", 21.0)]
    assert findings_of_fault(
        "B03b", merge_inputs(lost_frames(m1=20), TickInput({"lost": {(1, 1): (1 << 21) - 1}}))
    ) == [("m1", 41.0)]


def test_a_tension_at_the_rail_is_a_load_cell_fault_and_below_it_a_tendon_fault() -> None:
    saturation_tension = EIGHT_TENDON_LIMITS.tension_rail
    for row in ("T03", "T03b"):
        findings = findings_of_fault(
            row, measured_tensions(t0=math.nextafter(saturation_tension, 0.0), t1=0.0)
        )
        assert [name for name, _ in findings] == ["t0"], row
        assert findings_of_fault(row, measured_tensions(t0=saturation_tension, t1=0.0)) == [], row


def test_over_tension_remains_at_the_rail_and_below_it_only_after_relaxing() -> None:
    high = merge_inputs(INPUT_WITHOUT_TENSIONS, INPUT_AT_REST)
    high.state_values["measured_tension"][1] = EIGHT_TENDON_LIMITS.tension_rail + 1.0
    assert findings_of_fault("T03c", high) == []
    assert findings_of_fault("T03c", TickInput(high.state_values | RELAX_STATE_VALUES)) == [
        ("t1", EIGHT_TENDON_LIMITS.tension_rail + 1.0)
    ]
    assert (
        findings_of_fault(
            "T03c", TickInput(INPUT_WITHOUT_TENSIONS.state_values | RELAX_STATE_VALUES)
        )
        == []
    )


@pytest.mark.parametrize("fault_id", ["T03", "T03b", "T06"])
def test_unread_tensions_cause_no_fault(fault_id: str) -> None:
    assert findings_of_fault(fault_id, INPUT_WITHOUT_TENSIONS) == []
    inputs = merge_inputs(INPUT_WITHOUT_TENSIONS, INPUT_AT_REST)
    inputs.state_values["measured_tension"][0] = 243.0 if fault_id != "T06" else 300.0
    assert [name for name, _ in findings_of_fault(fault_id, inputs)] == ["t0"], "one of them"
