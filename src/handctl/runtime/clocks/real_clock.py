"""Real time of a run.

Each tick has an absolute deadline on CLOCK_MONOTONIC. The time of the run can be slower or faster
than wall time.

The module ``lockstep`` contains another clock, for virtual time.
"""

import time
from dataclasses import dataclass, field
from functools import partial
from typing import Protocol

from handctl.runtime.clocks.awake_processors import AwakeProcessors
from handctl.runtime.clocks.expected_time import ExpectedTime
from handctl.runtime.clocks.rehearsal import Rehearsal

INITIAL_WAKE_UP_DELAY_NS = 50_000
"""Assumed delay of the first wake-up [ns of wall time].

``time.sleep`` returns 15 to 50 us late, even under SCHED_FIFO.
"""
BUSY_WAIT_NS = 20_000
"""Time before each deadline in which the process reads the clock in a loop [ns of wall time].

Only a process with real-time priority reads the clock in a loop. If a wake-up takes longer than
expected, the loop is shorter.
"""
MAX_BUSY_WAIT_LEAD_NS = 100_000
"""Longest time before a deadline at which the process wakes up to read the clock in a loop [ns of wall time]."""


class TickClock(Protocol):
    """Clock of the control loop. A time is a time of the run, unless a docstring says wall time."""

    def start(self) -> None:
        """Start the time of the run. The next tick is tick 0."""
        ...

    def wait(self, k: int) -> int:
        """Wait for the deadline of tick k, and return the lateness: the time since the deadline [ns], 0 or more."""
        ...

    def now_ns(self) -> int:
        """Return the time since the start of the run [ns]."""
        ...

    def clock_statistics(self) -> dict[str, str]:
        """Return facts about the clock as texts, by the name of the fact.

        The recorder writes the facts about the clock at the end of the log.
        """
        ...


@dataclass
class RealClock:
    """Clock of a run in real time, based on CLOCK_MONOTONIC.

    The deadline of tick k is the start of the run plus k periods.

    With a time scale of 0.1, one second of the run takes ten seconds of wall time.

    Attributes:
        period_ns: control period [ns of the time of the run].
        time_scale: seconds of the run per second of wall time.
        busy_wait: True to read the clock repeatedly before each deadline, without sleeping. These
            readings are useful only with real-time priority.
        rehearsal: rehearsal of each tick before its deadline, or None. A rehearsal is useful only
            with ``busy_wait``.
        processors: the idle processors. While they are kept awake, they sleep in some of the waits.
        wake_up_delay: expected delay of a wake-up of the process.
        delay_after_processor_sleep: expected delay of a wake-up if the idle processors slept as well.
        start_ns: reading of the clock at tick 0 [ns of wall time].
        pause_count: number of pauses of the clock so far. Only the shared clock can pause.
        paused_ns: total duration of the clock's pauses [ns of wall time].
    """

    period_ns: int
    time_scale: float = 1.0
    busy_wait: bool = False
    rehearsal: Rehearsal | None = None
    processors: AwakeProcessors = field(default_factory=AwakeProcessors)
    wake_up_delay: ExpectedTime = field(
        default_factory=partial(ExpectedTime, INITIAL_WAKE_UP_DELAY_NS)
    )
    delay_after_processor_sleep: ExpectedTime = field(
        default_factory=partial(ExpectedTime, INITIAL_WAKE_UP_DELAY_NS)
    )
    start_ns: int = 0
    pause_count: int = 0
    paused_ns: int = 0

    def start(self) -> None:
        """Start the time of the run. The deadline of tick 0 is one period after this call."""
        self.start_ns = self._read_clock_ns() + int(self.period_ns / self.time_scale)

    def wait(self, k: int) -> int:
        """Wait for the deadline of tick k, and return the time since the deadline [ns], see ``TickClock``."""
        return int(
            self._wait_until(self._deadline_ns(k)) * self.time_scale
        )  # convert wall time to the time of the run

    def now_ns(self) -> int:
        """Return the time since the start of the run [ns]."""
        return self.convert_to_run_time(time.monotonic_ns())

    def clock_statistics(self) -> dict[str, str]:
        """Return facts about the clock, see ``TickClock``."""
        return {}

    def convert_to_run_time(self, monotonic_ns: int) -> int:
        """Convert a CLOCK_MONOTONIC time stamp to a time of the run [ns]."""
        return int((monotonic_ns - self.start_ns) * self.time_scale)

    def _read_clock_ns(self) -> int:
        """Return the reading of the clock [ns of wall time]."""
        return time.monotonic_ns()

    def _deadline_ns(self, k: int) -> int:
        """Return the deadline of tick k, as a reading of the clock [ns of wall time]."""
        return self.start_ns + int(k * self.period_ns / self.time_scale)

    def _wait_until(self, deadline_ns: int) -> int:
        """Wait until the clock reads the deadline, and return the time since the deadline [ns of wall time]."""
        do_processors_sleep = self.processors.begin_wait()
        delay = self.delay_after_processor_sleep if do_processors_sleep else self.wake_up_delay
        delay_ns = delay.expected_ns
        lead_ns = int(min(delay_ns + BUSY_WAIT_NS, MAX_BUSY_WAIT_LEAD_NS)) if self.busy_wait else 0
        rehearsal = self.rehearsal
        rehearsal_lead_ns = rehearsal.lead_time_ns(delay_ns) if rehearsal else 0
        lead_ns = max(lead_ns, rehearsal_lead_ns)
        waiting_ns = deadline_ns - self._read_clock_ns() - lead_ns
        if waiting_ns > 0:
            sleep = self.processors.sleep if do_processors_sleep else time.sleep
            sleep(waiting_ns / 1e9)
        if lead_ns:
            remaining_ns = deadline_ns - self._read_clock_ns()
            if waiting_ns > 0:
                delay.follow(lead_ns - remaining_ns)
            if rehearsal and rehearsal_lead_ns:
                rehearsal.rehearse(remaining_ns)
            elif rehearsal:
                rehearsal.shorten_expected_duration()
        while (
            now := self._read_clock_ns()
        ) < deadline_ns:  # sleep can return too early, so the loop reads the clock again
            if not self.busy_wait:
                time.sleep((deadline_ns - now) / 1e9)
        return now - deadline_ns
