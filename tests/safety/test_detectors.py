"""Test the fault detectors.

The tests cover causes of drive errors, thresholds of a hand, newly declared faults, and the
generated pages of the documentation.
"""

import pytest

from handctl.core.detectors.node_faults import FAULT_ROW_BY_CAUSE_INDEX
from handctl.drives.contract import DriveFaultCause
from handctl.drives.motor_description import PROTOCOL_TRAITS, VERIFIABLE_PROTOCOLS
from handctl.safety.faults.fault import CatalogueRow, Fault
from handctl.safety.faults.markdown import (
    catalogue_markdown,
    fault_table_markdown,
    hardware_checklist,
    late_reactions_markdown,
    reacts_too_late,
)
from handctl.safety.faults.table import DETECTOR_ROWS
from handctl.safety.safety_action import SafetyAction
from tests.safety.fault_cases import (
    drive_error,
    input_without_torque,
    measured_tensions,
    merge_inputs,
    monitor_at_rest,
)


def test_causes_of_a_drive_s_error() -> None:
    assert len(FAULT_ROW_BY_CAUSE_INDEX) == len(DriveFaultCause)
    tick_input = merge_inputs(
        drive_error(0, DriveFaultCause.OTHER, 9),
        drive_error(1, DriveFaultCause.OVERHEATED, 11),
        drive_error(2, DriveFaultCause.COMMUNICATION_LOST, 12),
    )
    assert monitor_at_rest().tick(tick_input.state_values)["N11"] == {
        "m0": 9.0,
        "m1": 11.0,
        "m2": 12.0,
    }
    assert "N11" not in monitor_at_rest().tick(input_without_torque(tick_input).state_values)
    rows = {
        cause: DETECTOR_ROWS[row][0].id
        for cause, row in zip(DriveFaultCause, FAULT_ROW_BY_CAUSE_INDEX, strict=True)
    }
    assert rows[DriveFaultCause.DROPPED_OUT] == "N01"
    assert rows[DriveFaultCause.WATCHDOG] == "N08"
    assert rows[DriveFaultCause.VOLTAGE] == "N10"
    assert rows[DriveFaultCause.SETTING_MISMATCH] == "N12"
    assert rows[DriveFaultCause.UNKNOWN] == "N11b"


def test_a_tension_above_its_limit_is_detected() -> None:
    nan = float("nan")
    assert monitor_at_rest().tick(measured_tensions(t0=140.0, t1=50.5).state_values)["T03"] == {
        "t1": 50.5
    }
    assert "T03" not in monitor_at_rest().tick(measured_tensions(t0=140.0, t1=50.0).state_values)
    assert monitor_at_rest().tick(measured_tensions(t0=150.0, t1=nan, t2=140.5).state_values)[
        "T03"
    ] == {
        "t0": 150.0,
        "t2": 140.5,
    }


EXAMPLE_FAULT = Fault(
    "X01b",
    "a title",
    "a sign",
    SafetyAction.HOLD,
    "by itself",
    "Why.",
    "Do.",
    debounce_ticks=3,
    reports=("x",),
)


def test_a_row_knows_its_catalogue_row_and_whether_it_latches() -> None:
    assert (EXAMPLE_FAULT.row, EXAMPLE_FAULT.is_latched) == ("X01", False)
    assert fault_table_markdown((EXAMPLE_FAULT,)).splitlines() == [
        "| id | fault | what happens | action | cleared |", "|---|---|---|---|---|",
        "| X01b | a title | a sign | HOLD | by itself |",
    ]  # fmt: skip


@pytest.mark.parametrize(("catalogue_row", "last_columns"), [
    (CatalogueRow("B12", "t", "fault table", ticks=1, required_ticks=1), "2 ms, 1 ticks | campaign |"),
    (CatalogueRow("B12", "t", "fault table", ticks=2, odrive_extra_ms=9),
     "4 ms, 2 ticks, ODrive 9 ms more | campaign |"),
    (CatalogueRow("B12", "t", "fault table", tested_by="x.py"), "1 tick | x.py |"),
    (CatalogueRow("B12", "t", "fault table", ticks=4, ms=15_000), "15008 ms, 7504 ticks | campaign |"),
    (CatalogueRow("B12", "t", "files", tested_by="x.py"), "before torque | x.py |"),
    (CatalogueRow("B12", "t", "files", ms=4), "4 ms, 2 ticks | campaign |"),
])  # fmt: skip
def test_catalogue_row_has_all_columns(catalogue_row: CatalogueRow, last_columns: str) -> None:
    head, line, row = catalogue_markdown((catalogue_row,)).splitlines()
    protocols = [PROTOCOL_TRAITS[name].title for name in VERIFIABLE_PROTOCOLS]
    assert (
        head
        == f"| id | fault | judged by | {' | '.join(protocols)} | latest reaction | tested by |"
    )
    assert line == "|---|---|---" + "|---" * len(protocols) + "|---|---|"
    assert row == f"| B12 | t | B12 CUT | {'detected | ' * len(protocols)}{last_columns}"


def test_a_fault_that_no_tick_judges_names_its_place() -> None:
    assert "| H12 | t | before arming |" in catalogue_markdown(
        (CatalogueRow("H12", "t", "before arming"),)
    )
    assert "| B11a RELAX, B11b CUT |".strip("| ") in catalogue_markdown(
        (CatalogueRow("B11", "t", "fault table", ticks=3),)
    )


def test_rows_later_than_required_are_listed_with_reasons() -> None:
    soon, just = (
        CatalogueRow("A", "t", "fault table", ticks=2, required_ticks=3),
        CatalogueRow("B", "t", "fault table", ticks=3, required_ticks=3),
    )
    row_with_reason = CatalogueRow(
        "C", "u", "fault table", ticks=1, ms=30, required_ticks=5, why="because"
    )
    row_without_deadline = CatalogueRow(
        "D", "t", "fault table", ticks=9
    )  # the reaction to a fault without a required reaction time is never late
    row_in_time = CatalogueRow("E", "t", "fault table", ticks=2, required_ticks=1)
    assert [
        reacts_too_late(row)
        for row in (soon, just, row_with_reason, row_without_deadline, row_in_time)
    ] == [
        False,
        False,
        True,
        False,
        True,
    ]
    assert late_reactions_markdown((soon, just, row_with_reason, row_without_deadline)).splitlines() == [
        "| id | fault | required, ticks | at 500 Hz, ticks | required | takes | why |", "|---|---|---|---|---|---|---|",
        "| C | u | 5 | 16 | 25 ms | 32 ms | because |",
    ]  # fmt: skip
    assert row_with_reason.max_reaction_time_ms(200.0) == 35.0


def test_hardware_checklist_lists_the_tests_in_order() -> None:
    lines = hardware_checklist().splitlines()
    assert lines[:3] == [
        "| id | what to do |",
        "|---|---|",
        "| B12 | short CANH to CANL in motion |",
    ]
    assert lines[-1].startswith("| H05 | kill -9 in a grasp")
