"""Test the rehearsal of ticks.

Shortly before a tick is due, the clock executes the beginning of the previous tick again.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from handctl.log.read.reader import RunLog
from handctl.replay.controller_rebuild import rebuild_controller
from handctl.runtime.clocks.real_clock import RealClock
from handctl.runtime.clocks.rehearsal import (
    MARGIN_NS,
    MAX_PERIOD_SHARE,
    SHORTEST_PERIOD_NS,
    Rehearsal,
    rehearsal_for_period,
)

PERIOD_NS = 2_000_000
TICK_NS = 70_000
GOLDEN_LOGS = sorted((Path(__file__).parents[2] / "logs" / "golden").glob("*.mcap"))


class WallClock:
    """A simulated CLOCK_MONOTONIC. The simulated time advances when the loop sleeps or executes a tick."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, wake_up_delay_ns: int = 0) -> None:
        self.now_ns = 10_000_000
        self.wake_up_delay_ns = wake_up_delay_ns
        self.tick_ns = TICK_NS
        self.tick_starts_ns: list[int] = []
        self.executed_steps = 0
        monkeypatch.setattr(time, "monotonic_ns", self.read)
        monkeypatch.setattr(time, "sleep", self.sleep)

    def read(self) -> int:
        self.now_ns += 100
        return self.now_ns

    def sleep(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9) + self.wake_up_delay_ns

    def execute_tick(self) -> Iterator[None]:
        self.tick_starts_ns.append(self.now_ns)
        for share in (0.6, 0.4):
            if share < 0.5:
                yield
            self.now_ns += int(share * self.tick_ns)
            self.executed_steps += 1


def test_a_rehearsal_ends_shortly_before_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = WallClock(monkeypatch)
    clock = RealClock(PERIOD_NS, busy_wait=True, rehearsal=Rehearsal(wall.execute_tick, PERIOD_NS))
    clock.start()
    lateness = [clock.wait(k) for k in range(1000)]
    assert max(lateness) < 1000
    assert len(wall.tick_starts_ns) == 1000, "the assumed duration of the first one fits as well"
    assert wall.executed_steps > 1500
    last_deadline_ns = clock.start_ns + 999 * PERIOD_NS
    time_before_deadline_ns = last_deadline_ns - wall.tick_starts_ns[-1]
    assert TICK_NS < time_before_deadline_ns < 1.5 * TICK_NS + MARGIN_NS


def test_a_single_late_wake_up_leaves_the_rehearsal_out(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = WallClock(monkeypatch)
    clock = RealClock(PERIOD_NS, busy_wait=True, rehearsal=Rehearsal(wall.execute_tick, PERIOD_NS))
    clock.start()
    for k in range(1000):
        clock.wait(k)
    rehearsed_tick_count = len(wall.tick_starts_ns)
    wall.wake_up_delay_ns = MARGIN_NS + 10_000
    assert clock.wait(1000) < 1000
    assert len(wall.tick_starts_ns) == rehearsed_tick_count


def test_a_process_that_always_wakes_up_late_sleeps_for_a_shorter_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall = WallClock(monkeypatch, wake_up_delay_ns=80_000)
    clock = RealClock(PERIOD_NS, busy_wait=True, rehearsal=Rehearsal(wall.execute_tick, PERIOD_NS))
    clock.start()
    lateness = [clock.wait(k) for k in range(1000)]
    assert max(lateness[300:]) < 1000
    assert len(wall.tick_starts_ns) > 700


def test_a_process_that_wakes_up_too_late_does_not_lose_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wall = WallClock(monkeypatch, wake_up_delay_ns=190_000)
    rehearsal = Rehearsal(wall.execute_tick, PERIOD_NS)
    clock = RealClock(PERIOD_NS, busy_wait=True, rehearsal=rehearsal)
    clock.start()
    for k in range(2000):
        clock.wait(k)
    assert TICK_NS + wall.wake_up_delay_ns > MAX_PERIOD_SHARE * PERIOD_NS
    lead_times_ns = []
    for k in range(2000, 4000):
        lead_times_ns.append(rehearsal.lead_time_ns(clock.wake_up_delay.expected_ns))
        clock.wait(k)
    assert sum(lead_ns > 0 for lead_ns in lead_times_ns) < 200, (
        "the process rarely wakes up earlier"
    )


def test_a_long_first_step_leaves_the_second_step_out(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = WallClock(monkeypatch, wake_up_delay_ns=40_000)
    clock = RealClock(PERIOD_NS, busy_wait=True, rehearsal=Rehearsal(wall.execute_tick, PERIOD_NS))
    clock.start()
    for k in range(1000):
        clock.wait(k)
    steps = wall.executed_steps
    wall.wake_up_delay_ns = 10_000
    wall.tick_ns = 2 * TICK_NS
    assert clock.wait(1000) < 1000
    assert wall.executed_steps == steps + 1


@pytest.mark.parametrize("period_ns", [SHORTEST_PERIOD_NS, PERIOD_NS])
def test_no_rehearsal_takes_a_large_share_of_the_period(
    monkeypatch: pytest.MonkeyPatch, period_ns: int
) -> None:
    wall = WallClock(monkeypatch)
    wall.tick_ns = int(MAX_PERIOD_SHARE * period_ns)
    rehearsal = Rehearsal(wall.execute_tick, period_ns)
    clock = RealClock(period_ns, busy_wait=True, rehearsal=rehearsal)
    clock.start()
    lateness = [clock.wait(k) for k in range(10_000)]
    assert max(lateness) < 1000
    assert len(wall.tick_starts_ns) < 1000, (
        "in few ticks the clock tries whether a rehearsal fits now"
    )


@pytest.mark.parametrize("period_ns", [500_000, 1_000_000])
def test_short_periods_have_no_rehearsals(monkeypatch: pytest.MonkeyPatch, period_ns: int) -> None:
    wall = WallClock(monkeypatch)
    wall.tick_ns = 10_000
    rehearsal = rehearsal_for_period(wall.execute_tick, period_ns)
    clock = RealClock(period_ns, busy_wait=True, rehearsal=rehearsal)
    clock.start()
    assert max(clock.wait(k) for k in range(10_000)) < 1000
    assert not wall.tick_starts_ns


def test_rehearsals_begin_again_after_an_interruption(monkeypatch: pytest.MonkeyPatch) -> None:
    wall = WallClock(monkeypatch)
    clock = RealClock(PERIOD_NS, busy_wait=True, rehearsal=Rehearsal(wall.execute_tick, PERIOD_NS))
    clock.start()
    for k in range(100):
        clock.wait(k)
    wall.tick_ns = 3 * PERIOD_NS // 4
    clock.wait(100)
    wall.tick_ns = TICK_NS
    rehearsed_tick_count = len(wall.tick_starts_ns)
    assert max(clock.wait(k) for k in range(101, 501)) < 1000
    assert len(wall.tick_starts_ns) > rehearsed_tick_count + 100


@pytest.mark.parametrize("log_path", GOLDEN_LOGS, ids=lambda path: path.stem)
def test_a_rehearsal_changes_no_later_tick(log_path: Path) -> None:
    """Rehearse every tick, and compare the states of all ticks with the log."""
    with RunLog(log_path) as log, np.errstate(all="ignore"):
        controller = rebuild_controller(log)
        state = controller.initial_state()
        for logged_tick in log.ticks():
            inputs = state, logged_tick.tick_in
            state, tick_output = controller.tick(*inputs)
            controller.begin_tick(*inputs).decide(())
            assert tick_output.state_hash == logged_tick.state_hash
