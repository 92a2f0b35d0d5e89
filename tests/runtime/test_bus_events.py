"""Test the decoding of error frames with constants from the Linux header file.

The bus reports a state of the CAN controller, such as bus off, for as long as the state lasts.
"""

import errno

import pytest

from handctl.drives.frame import ERROR_FLAG
from handctl.runtime.buses.bus_events import BusEvents


def event_kinds(events: BusEvents) -> set[str]:
    return {kind for kind, _, _ in events.take_events()}


@pytest.mark.parametrize(
    ("can_id", "status_byte", "expected_kinds"),
    [
        (0x001, 0, {"error_frame"}),
        (0x004, 0x01, {"error_frame"}),
        (0x004, 0x02, {"error_frame", "enobufs"}),
        (0x004, 0x04, {"error_frame", "error_warning"}),
        (0x004, 0x08, {"error_frame", "error_warning"}),
        (0x004, 0x10, {"error_frame", "error_passive"}),
        (0x004, 0x20, {"error_frame", "error_passive"}),
        (0x004, 0x40, {"error_frame", "error_active"}),
        (0x040, 0, {"error_frame", "bus_off"}),
        (0x100, 0, {"error_frame", "restarted"}),
        (0x044, 0x30, {"error_frame", "bus_off", "error_passive"}),
    ],
)
def test_error_frame_gives_the_events_of_its_class(
    can_id: int, status_byte: int, expected_kinds: set[str]
) -> None:
    """The numbers in the test cases are CAN_ERR_* and CAN_ERR_CRTL_* in the Linux header ``can/error.h``."""
    events = BusEvents("can0")
    events.add_error_frame(ERROR_FLAG | can_id, bytes((0, status_byte, 0, 0, 0, 0, 0, 0)))
    assert event_kinds(events) == expected_kinds


def test_an_error_frame_names_its_classes() -> None:
    events = BusEvents("can0")
    events.add_error_frame(ERROR_FLAG | 0x28, bytes(8))
    assert events.take_events() == [("error_frame", "can0 protocol, no acknowledge", 1)]


@pytest.mark.parametrize("frame_data", [b"", b"\x01"])
def test_a_short_error_frame_is_an_error_frame(frame_data: bytes) -> None:
    events = BusEvents("can0")
    events.add_error_frame(ERROR_FLAG | 0x04, frame_data)
    assert event_kinds(events) == {"error_frame"}


def test_passive_lasts_until_the_controller_reports_another_state() -> None:
    events = BusEvents("can0")
    events.add_error_frame(ERROR_FLAG | 0x04, bytes((0, 0x20)))
    events.take_events()
    for _ in range(3):
        assert events.take_events() == [("error_passive", "can0", 1)]
    events.add_error_frame(
        ERROR_FLAG | 0x04, bytes((0, 0x01))
    )  # an overflow does not change the state of the CAN controller
    assert "error_passive" in event_kinds(events)
    events.add_error_frame(ERROR_FLAG | 0x04, bytes((0, 0x08)))
    events.take_events()
    assert events.take_events() == []


@pytest.mark.parametrize("restart_event", ["restarted", "down"])
def test_bus_off_lasts_until_a_restart(restart_event: str) -> None:
    events = BusEvents("can0")
    events.add_error_frame(ERROR_FLAG | 0x44, bytes((0, 0x20)))
    events.take_events()
    assert event_kinds(events) == {"bus_off", "error_passive"}
    if restart_event == "restarted":
        events.add_error_frame(ERROR_FLAG | 0x100, bytes(8))
    else:
        events.count_failure(errno.ENETDOWN, "enobufs")
    events.take_events()
    assert events.take_events() == []


def test_counts_of_a_kind_are_added_up() -> None:
    events = BusEvents("can0")
    events.count_failure(errno.ENOBUFS, "enodev", 3)
    events.count_failure(errno.EAGAIN, "enodev", 2)
    events.count_failure(errno.ENETDOWN, "enodev")
    events.count_failure(None, "enodev")
    assert events.take_events() == [
        ("enobufs", "can0", 5),
        ("enetdown", "can0", 1),
        ("enodev", "can0", 1),
    ]
    assert events.take_events() == []


def test_a_lost_interface_is_reported_at_every_call() -> None:
    events = BusEvents("can0")
    events.count_failure(errno.ENODEV, "enobufs")
    for _ in range(3):
        assert events.take_events() == [("enodev", "can0", 1)]
