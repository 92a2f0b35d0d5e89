"""Test that the fault catalogue, the fault table, the fault campaign, the tests and the documents agree.

The fault campaign simulates every fault of the catalogue. The catalogue covers the communication
faults of AUTOSAR and the failure kinds of PX4.
"""

from pathlib import Path

import pytest

from handctl.campaign.fault_matrix import FAULT_MATRIX, TEST_PLACE_BY_UNTESTED_FAULT
from handctl.drives.motor_description import VERIFIABLE_PROTOCOLS
from handctl.safety.faults.fault import (
    CHECKED_BY_FAULT_TABLE,
    INDIRECTLY_VISIBLE,
    INVISIBLE_FAULT,
    VISIBLE_FAULT,
)
from handctl.safety.faults.host import ON_HARDWARE
from handctl.safety.faults.markdown import (
    catalogue_markdown,
    fault_sections,
    fault_table_markdown,
    hardware_checklist,
    late_reactions_markdown,
    reacts_too_late,
)
from handctl.safety.faults.table import FAULT_CATALOGUE, FAULT_TABLE, remedy_for

REPOSITORY = Path(__file__).parents[2]
FAULT_COUNT_BY_LETTER = {"B": 18, "N": 17, "T": 9, "H": 15, "I": 11}
CATALOGUE_IDS = [
    f"{letter}{number:02}"
    for letter, size in FAULT_COUNT_BY_LETTER.items()
    for number in range(1, size + 1)
]
"""Identifiers of all faults: 68 identifiers from the first fault catalogue, and the later identifiers N17 and I11."""
CATALOGUE_ENTRY_BY_ID = {entry.id: entry for entry in FAULT_CATALOGUE}

AUTOSAR_FAULTS = {
    "repetition": "B05", "loss": "B01 B02 B03", "delay": "B04", "insertion": "B06 B10", "masquerade": "B06 N13 H13",
    "wrong address": "B10 N13", "wrong sequence": "B07", "corruption": "B08 B09", "asymmetric information": "B17",
    "subset of receivers": "B17", "blocked access": "B11 B12",
}  # fmt: skip
"""Communication faults that AUTOSAR lists, each with the corresponding faults of the fault catalogue of handctl.

Source: FAULTS, section 2.6.
"""
PX4_FAILURE_KINDS = ("off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent")
PX4_FAULTS_BY_QUANTITY = {
    "link": ("N02", "N15", "B08", "B06", "N15", "B04", "B03"),
    "joint encoder": ("N02", "N04", "N05", "N06", "N15", "B04", "B03"),
    "spool encoder": ("B02", "N04", "N05", "N06", "N15", "B04", "B03"),
    "tension": ("N02", "T05", "T06", "T04", "N15", "B04", "B03"),
    "temperature": ("-no frame of its own", "-changes in minutes", "N09", "N09", "-changes in minutes",
                    "-changes in minutes", "-changes in minutes"),
    "voltage": ("-the drive judges it", "-the drive judges it", "N10", "N10", "-the drive judges it",
                "-the drive judges it", "-the drive judges it"),
}  # fmt: skip
"""Fault in the fault catalogue of handctl for each failure kind of PX4 and each measured quantity.

An entry that starts with - gives the reason why the failure kind does not apply to the measured
quantity.
"""


def test_the_catalogue_has_every_row_once_and_in_order() -> None:
    assert len(CATALOGUE_IDS) == 70
    assert [entry.id for entry in FAULT_CATALOGUE] == CATALOGUE_IDS


def test_table_and_catalogue_agree_on_what_a_tick_can_judge() -> None:
    table_rows = {fault.row for fault in FAULT_TABLE}
    assert table_rows <= set(CATALOGUE_IDS)
    ids_checked_elsewhere = {
        entry.id for entry in FAULT_CATALOGUE if entry.checked_by != CHECKED_BY_FAULT_TABLE
    }
    assert {
        entry.id for entry in FAULT_CATALOGUE if entry.checked_by == CHECKED_BY_FAULT_TABLE
    } <= table_rows
    assert table_rows & ids_checked_elsewhere <= {"B18", "N12"}, (
        "only these rows are checked before arming and in every tick"
    )


def test_every_row_has_its_visibility_in_each_protocol() -> None:
    for entry in FAULT_CATALOGUE:
        for visibility in map(entry.visibility, VERIFIABLE_PROTOCOLS):
            verdict, _, why = visibility.partition(": ")
            assert verdict in (VISIBLE_FAULT, INDIRECTLY_VISIBLE, INVISIBLE_FAULT), entry.id
            assert why or verdict == VISIBLE_FAULT, f"{entry.id}: replaced by what, or lost why?"


def test_every_fault_is_injected_or_has_a_reason() -> None:
    campaign_ids = {row.id for row in FAULT_MATRIX}
    for entry in FAULT_CATALOGUE:
        if entry.tested_by == "campaign":
            assert entry.id in campaign_ids, entry.id
        elif entry.tested_by != "soak":
            assert (REPOSITORY / entry.tested_by).exists(), entry.id
    assert campaign_ids <= set(CATALOGUE_IDS)
    assert TEST_PLACE_BY_UNTESTED_FAULT.keys() | campaign_ids >= set(CATALOGUE_IDS) - {
        id_ for id_ in CATALOGUE_IDS if id_[0] == "I"
    }


def test_the_campaign_allows_no_more_time_than_the_catalogue() -> None:
    for row in FAULT_MATRIX:
        entry = CATALOGUE_ENTRY_BY_ID[row.id]
        if row.accepted_faults[:1] == ("B11b",):  # second stage of the fault B11, after ten ticks
            assert row.max_ticks == 11
            continue
        assert row.max_ticks * 2.0 + row.max_extra_ms <= entry.max_reaction_time_ms(500.0), row
        extra_delay_ms_by_protocol = {
            p: row.extra_ms_by_protocol.get(p, 0.0) + 2.0 * row.extra_ticks.get(p, 0)
            for p in row.protocols
        }
        assert extra_delay_ms_by_protocol.get("odrive", 0.0) <= entry.odrive_extra_ms, row
        for protocol in ("mit", "cia402"):
            assert row.max_ticks * 2.0 + row.max_extra_ms + extra_delay_ms_by_protocol.get(
                protocol, 0.0
            ) <= entry.max_reaction_time_ms(500.0), row


REQUIRED_TICKS = """\
B01 2 B02 5 B03 102 B04 4 B05 2 B06 2 B07 2 B08 4 B09 2 B10 2 B11 3 B12 1 B13 21 B14 1 B15 3 B16 1 B17 4
N01 2 N02 4 N04 22 N05 3 N06 200 N07 52 N08 2 N09 22 N10 2 N11 2 N13 2 N14 22 N15 22 N16 21
T01 3 T02 12 T03 2 T04 200 T05 42 T06 4 T08 4
H01 1 H02 1 H03 1 H04 1 H05 3 H06 1 H07 1 H08 200 H09 640 H10 1 H13 2 I07 2
"""
"""Longest permitted reaction time of the controller to each fault [ticks]. Source: FAULTS, sections 2.1 to 2.5."""


def test_a_reaction_later_than_required_has_a_reason() -> None:
    words = REQUIRED_TICKS.split()
    required_ticks_by_id = dict(zip(words[::2], map(int, words[1::2]), strict=True))
    for entry in FAULT_CATALOGUE:
        assert entry.required_ticks == required_ticks_by_id.get(entry.id, 0), entry.id
        needs_reason = (entry.ticks or entry.ms) and reacts_too_late(entry)
        assert bool(entry.why) == bool(needs_reason), (
            f"{entry.id}: late detection, and no other, needs a reason"
        )


def test_the_pages_agree_with_the_code() -> None:
    evidence_page = (REPOSITORY / "docs" / "evidence" / "faults.md").read_text()
    assert catalogue_markdown() in evidence_page
    assert late_reactions_markdown() in evidence_page
    assert hardware_checklist() in evidence_page
    fault_page_text = (REPOSITORY / "docs" / "reference" / "faults.md").read_text()
    assert fault_table_markdown() in fault_page_text
    assert fault_sections() in fault_page_text


def test_every_fault_says_in_one_line_what_to_do_about_it() -> None:
    for fault in FAULT_TABLE:
        assert len(fault.remedy) <= 120, fault.id
        for text in (fault.cause, fault.remedy):
            assert text[0].isupper(), fault.id
            assert text.endswith("."), fault.id
            assert "\n" not in text, fault.id
        assert remedy_for(f"{fault.id} {fault.title}: here (1): WARN") == fault.remedy
    assert remedy_for("index: 24 N in 3 s") == ""


@pytest.mark.parametrize("autosar_fault", AUTOSAR_FAULTS)
def test_each_fault_of_the_autosar_list_is_a_fault_of_the_table(autosar_fault: str) -> None:
    assert set(AUTOSAR_FAULTS[autosar_fault].split()) <= set(CATALOGUE_IDS)


def test_each_cell_of_the_px4_table_is_a_fault_or_has_a_reason() -> None:
    cells = [cell for row in PX4_FAULTS_BY_QUANTITY.values() for cell in row]
    assert len(AUTOSAR_FAULTS) == 11
    assert len(cells) == 6 * len(PX4_FAILURE_KINDS)
    for cell in cells:
        assert cell in CATALOGUE_IDS or (cell.startswith("-") and len(cell) > 10), cell


def test_faults_that_need_hardware_are_listed() -> None:
    assert {id_ for id_, _ in ON_HARDWARE} >= {"B12", "B13", "B14", "B15", "B16", "B18"}
