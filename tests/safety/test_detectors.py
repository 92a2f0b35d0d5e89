"""Detectors that are made by others, made here and now; and the pages, word by word."""

import pytest

from handctl.drives.causes import Cause
from handctl.safety.action import Action
from handctl.safety.faults.catalogue import Entry
from handctl.safety.faults.fault import Fault, above, io, recorder
from handctl.safety.faults.markdown import catalogue, checklist, fault_table, late, later
from handctl.safety.faults.node import _caused_by
from handctl.safety.signals import Limits, Signals

LIMITS = Limits(("a", "b"), (140.0, 140.0), 240.0, ("m", "n"))


def told(*events: tuple[str, str, int]) -> Signals:
    return Signals(armed=True, io=events)


def test_what_a_bus_reports() -> None:
    detect = io("enodev", "ebadf")
    assert list(detect(LIMITS, told(("enodev", "can0", 19)))) == [("can0", 19.0)]
    assert list(detect(LIMITS, told(("ebadf", "", 9)))) == [("ebadf", 9.0)], "the kind, where no place is told"
    assert list(detect(LIMITS, told(("enobufs", "can0", 1)))) == []
    two = told(("enodev", "can0", 1), ("other", "x", 2), ("ebadf", "can1", 3))
    assert list(detect(LIMITS, two)) == [("can0", 1.0), ("can1", 3.0)]
    assert list(detect(LIMITS, told())) == []


def test_what_the_recorder_reports() -> None:
    detect = recorder("disk_low", "disk_full")
    assert list(detect(LIMITS, told(("recorder", "disk_low", 7)))) == [("disk_low", 7.0)]
    assert list(detect(LIMITS, told(("recorder", "gone", 1), ("bus", "disk_full", 1)))) == []
    assert list(detect(LIMITS, told())) == []


def test_causes_of_a_drive_s_error() -> None:
    detect = _caused_by(Cause.OTHER, Cause.HOT)
    errors = (("m", 9, Cause.OTHER), ("n", 11, Cause.HOT), ("x", 12, Cause.LOST))
    assert list(detect(LIMITS, Signals(armed=True, drive_errors=errors))) == [("m", 9.0), ("n", 11.0)]
    assert list(detect(LIMITS, Signals(armed=False, drive_errors=errors))) == []
    assert list(detect(LIMITS, Signals(armed=True))) == []


def test_above_a_limit() -> None:
    nan = float("nan")
    assert list(above(("a", "b"), (1.0, 3.0), 2.0)) == [("b", 3.0)]
    assert list(above(("a", "b"), (2.0, 2.0), 2.0)) == []
    assert list(above(("a", "b"), (), 2.0)) == []
    assert list(above(("a", "b", "c"), (3.0, nan, 2.5), 2.0)) == [("a", 3.0), ("c", 2.5)]
    assert list(above(("a", "b"), (3.0,), 2.0)) == [("a", 3.0)]


ONE = Fault("X01b", "a title", "a sign", 3, Action.HOLD, "by itself", io("x"))


def test_a_row_knows_its_catalogue_row_and_whether_it_latches() -> None:
    assert (ONE.row, ONE.latched) == ("X01", False)
    assert fault_table((ONE,)).splitlines() == [
        "| id | fault | noticed by | action | ended |", "|---|---|---|---|---|",
        "| X01b | a title | a sign | HOLD | by itself |",
    ]  # fmt: skip


@pytest.mark.parametrize(("entry", "last"), [
    (Entry("B12", "t", "fault table", ticks=1, asked=1), "2 ms, 1 ticks | campaign |"),
    (Entry("B12", "t", "fault table", ticks=2, odrive_ms=9), "4 ms, 2 ticks; ODrive 9 ms more | campaign |"),
    (Entry("B12", "t", "fault table", tried="x.py"), "1 tick | x.py |"),
    (Entry("B12", "t", "fault table", ticks=4, ms=15_000), "15008 ms, 7504 ticks | campaign |"),
    (Entry("B12", "t", "files", tried="x.py"), "before torque | x.py |"),
    (Entry("B12", "t", "files", ms=4), "4 ms, 2 ticks | campaign |"),
])  # fmt: skip
def test_a_row_of_the_page(entry: Entry, last: str) -> None:
    head, line, row = catalogue((entry,)).splitlines()
    assert head == "| id | fault | judged by | MIT | ODrive | CiA 402 | at the latest | tried by |"
    assert line == "|---|---|---|---|---|---|---|---|"
    assert row == f"| B12 | t | B12 CUT | detected | detected | detected | {last}"


def test_a_row_that_no_tick_judges_says_where_it_is() -> None:
    assert "| H12 | t | before arming |" in catalogue((Entry("H12", "t", "before arming"),))
    assert "| B11a RELAX, B11b CUT |".strip("| ") in catalogue((Entry("B11", "t", "fault table", ticks=3),))


def test_rows_that_take_longer_than_asked() -> None:
    soon, just = Entry("A", "t", "fault table", ticks=2, asked=3), Entry("B", "t", "fault table", ticks=3, asked=3)
    longer = Entry("C", "u", "fault table", ticks=1, ms=30, asked=5, why="because")
    free = Entry("D", "t", "fault table", ticks=9)  # no time is given: it cannot be late
    at_once = Entry("E", "t", "fault table", ticks=2, asked=1)
    assert [late(one) for one in (soon, just, longer, free, at_once)] == [False, False, True, False, True]
    assert later((soon, just, longer, free)).splitlines() == [
        "| id | fault | asked, ticks | at 500 Hz, ticks | asked | takes | why |", "|---|---|---|---|---|---|---|",
        "| C | u | 5 | 16 | 25 ms | 32 ms | because |",
    ]  # fmt: skip
    assert longer.latest_ms(200.0) == 35.0


def test_the_list_for_hardware() -> None:
    lines = checklist().splitlines()
    assert lines[:3] == ["| id | what to do |", "|---|---|", "| B12 | short CANH to CANL in motion |"]
    assert lines[-1].startswith("| H05 | kill -9 in a grasp")
