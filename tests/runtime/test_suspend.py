"""A run detects that the machine was suspended. The tests use simulated clocks."""

from handctl.runtime.clocks.suspend_watch import SuspendWatch


def test_a_suspend_is_reported_once_with_its_length():
    now = {"boot": 5_000_000_000, "monotonic": 3_000_000_000}
    watch = SuspendWatch(lambda: now["boot"], lambda: now["monotonic"])
    assert watch.take_events() == []
    now = {"boot": 15_000_000_000, "monotonic": 3_100_000_000}
    assert [tuple(event) for event in watch.take_events()] == [("suspended", "host", 9900)]
    assert watch.take_events() == []


def test_reading_the_clocks_one_after_the_other_is_no_suspend():
    now = {"boot": 0, "monotonic": 0}
    watch = SuspendWatch(lambda: now["boot"], lambda: now["monotonic"])
    now = {"boot": 19_000_000, "monotonic": 0}
    assert watch.take_events() == []


def test_a_pause_between_the_readings_is_no_suspend_and_hides_none():
    now = {"boot": 0, "monotonic": 0}
    pause_ns_by_place = {"before": 0, "after": 0}

    def read_boot_clock():
        now["boot"] = now["boot"] + pause_ns_by_place["before"]
        now["monotonic"] = now["monotonic"] + pause_ns_by_place["before"]
        boot_ns = now["boot"]
        now["boot"] = now["boot"] + pause_ns_by_place["after"]
        now["monotonic"] = now["monotonic"] + pause_ns_by_place["after"]
        return boot_ns

    watch = SuspendWatch(read_boot_clock, lambda: now["monotonic"])
    for where in pause_ns_by_place:
        pause_ns_by_place[where] = 100_000_000
        assert watch.take_events() == []
        pause_ns_by_place[where] = 0
        assert watch.take_events() == []
    pause_ns_by_place["before"] = 100_000_000
    now["boot"] = now["boot"] + 10**9
    assert watch.take_events() == [], "a pause and a suspend are not distinguished yet"
    pause_ns_by_place["before"] = 0
    assert [event.number for event in watch.take_events()] == [1000]


def test_no_suspend_is_reported_without_a_suspend():
    assert SuspendWatch().take_events() == []
