"""Test which faults are reported after events of the buses, the host and the recorder."""

from handctl.safety.tick_verdict import EventReport, filter_error_frames, locate_reports


def faults_of_reports(*event_reports: EventReport) -> list[tuple[str, str, float]]:
    return [(fault.id, where, value) for fault, where, value in locate_reports(event_reports)]


def test_bus_events_become_faults() -> None:
    assert faults_of_reports(("enodev", "can0", 19.0)) == [("B16", "can0", 19.0)]
    assert faults_of_reports(("ebadf", "", 9.0)) == [("B16", "ebadf", 9.0)], (
        "the kind, if there is no place"
    )
    assert faults_of_reports(("bus_on", "can0", 1.0)) == []
    reports = (("enodev", "can0", 1.0), ("other", "x", 2.0), ("ebadf", "can1", 3.0))
    assert faults_of_reports(*reports) == [("B16", "can0", 1.0), ("B16", "can1", 3.0)]
    assert faults_of_reports(("error_passive", "can0", 1.0)) == [
        ("B13a", "can0", 1.0),
        ("B13b", "can0", 1.0),
    ], "two stages"
    assert faults_of_reports() == []


def test_recorder_events_become_faults() -> None:
    assert faults_of_reports(("recorder", "disk_low", 7.0)) == [("H08", "disk_low", 7.0)]
    assert faults_of_reports(("recorder", "gone", 1.0), ("bus", "disk_full", 1.0)) == [
        ("H10", "gone", 1.0)
    ]
    assert faults_of_reports(("disk_full", "can0", 1.0)) == []


def test_only_missing_acknowledges_mean_alone_on_the_bus() -> None:
    missing_acknowledge_report, other_report = (
        ("error_frame", "can0 no acknowledge", 3.0),
        ("error_frame", "can0 overload", 2.0),
    )
    located_faults = locate_reports(
        filter_error_frames(
            [other_report, missing_acknowledge_report, missing_acknowledge_report],
            has_node_answered=False,
        )
    )
    assert [(fault.id, name, value) for fault, name, value in located_faults] == [
        ("B18", "can0 no acknowledge", 3.0)
    ]
    other_kind = filter_error_frames(
        [other_report, ("enobufs", "protocol", 1.0)], has_node_answered=False
    )
    assert [fault.id for fault, _, _ in locate_reports(other_kind)] == ["B15"]
    assert (
        locate_reports(filter_error_frames([missing_acknowledge_report], has_node_answered=True))
        == []
    )


def test_missing_acknowledges_are_reported_only_until_a_node_has_answered() -> None:
    """The fault B18 (alone on the bus) is reported only before the hand is armed, and only until a node has replied.

    A reply proves that the bus has other nodes than the host.
    """
    missing_acknowledge_report = ("error_frame", "can0 no acknowledge", 3.0)
    for word in ("no acknowledge", "bus error", "protocol"):
        error_event = ("error_frame", f"can0 {word}", 1.0)
        assert filter_error_frames(
            [error_event, ("enobufs", "can0", 1.0), error_event], has_node_answered=False
        ) == [
            ("enobufs", "can0", 1.0),
            error_event,
        ]
    assert filter_error_frames(
        [missing_acknowledge_report, ("enobufs", "can0", 1.0)], has_node_answered=True
    ) == [("enobufs", "can0", 1.0)]
    assert (
        filter_error_frames([("error_frame", "can0 overload", 2.0)], has_node_answered=False) == []
    )
