"""Rehearsal of a tick shortly before its deadline, so that the caches contain the code and the data of the tick.

Between two ticks, other programs use the caches of the processor. When other programs have used the
caches, a tick takes longer than directly after another tick. In the last microseconds before a
deadline, the clock only waits. While the clock waits, the control loop executes the beginning of
the last tick again and discards the result. A tick has no side effects, so a rehearsal changes
nothing.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

MAX_PERIOD_SHARE = 1 / 8
"""Largest share of a control period that is reserved for the wake-up of the process and a rehearsal.

On a slow processor or at a high rate, wake-up and rehearsal take longer than this share. In that case,
there are no rehearsals.
"""
MARGIN_NS = 5_000
"""Time between the expected end of a rehearsal and the deadline [ns]."""
INITIAL_DURATION_NS = 150_000
"""Assumed duration of the first rehearsal [ns]."""
INITIAL_WAKE_UP_DELAY_NS = 30_000
"""Assumed delay of the first wake-up [ns]."""
RISE_SHARE = 1 / 4
FALL_SHARE = 1 / 16
"""Fractions of the difference between measured and expected time by which the expected time rises and falls."""
MAX_GROWTH = 1.25
"""Largest factor by which an expected time grows at once.

An interruption by the operating system can make a single rehearsal or a single wake-up very long.
"""
RETRY_SHARE = 1 / 1024
"""Share by which ``expected_ns`` falls in each tick for which a rehearsal takes too long.

As a result, the clock sometimes tries whether a rehearsal has become shorter.
"""


@dataclass
class Rehearsal:
    """Rehearsals of ticks during one run, and an estimate of the duration of the next rehearsal.

    Attributes:
        execute_steps: function that executes two steps of the last tick again, and yields between
            them.
        period_ns: control period [ns of wall time].
        expected_ns: expected duration of the next rehearsal [ns].
        expected_delay_ns: expected delay of the next wake-up of the process [ns].
    """

    execute_steps: Callable[[], Iterator[None]]
    period_ns: int
    expected_ns: float = INITIAL_DURATION_NS
    expected_delay_ns: float = INITIAL_WAKE_UP_DELAY_NS

    @property
    def lead_time_ns(self) -> int:
        """Return the time before a deadline at which the process must wake up for a rehearsal [ns].

        If the lead time exceeds the permitted fraction of the control period, return 0.
        """
        lead_ns = int(self.expected_delay_ns + self.expected_ns + MARGIN_NS)
        return lead_ns if lead_ns <= MAX_PERIOD_SHARE * self.period_ns else 0

    def observe_wake_up(self, delay_ns: int) -> None:
        """Store the delay of a wake-up, the difference between the planned and the actual time [ns]."""
        self.expected_delay_ns = _follow_time(self.expected_delay_ns, delay_ns)

    def rehearse(self, remaining_ns: int) -> None:
        """Execute two steps of the last tick again, if the time until the deadline is long enough.

        If the time that remains after the first step is shorter than the first step, the second
        step is left out.

        Args:
            remaining_ns: time until the deadline [ns].
        """
        if not self.lead_time_ns:
            self.expected_ns -= RETRY_SHARE * self.expected_ns
            return
        if remaining_ns < self.expected_ns:
            return
        start_ns = time.monotonic_ns()
        for _ in self.execute_steps():
            step_ns = time.monotonic_ns() - start_ns
            if remaining_ns - step_ns < step_ns:
                duration_ns = 2 * step_ns  # an upper estimate, because the second step is left out
                break
        else:
            duration_ns = time.monotonic_ns() - start_ns
        self.expected_ns = _follow_time(self.expected_ns, duration_ns)


def _follow_time(expected_ns: float, measured_ns: float) -> float:
    """Update an expected time with a measured time, and return the result. The result rises faster than it falls."""
    difference_ns = measured_ns - expected_ns
    share = RISE_SHARE if difference_ns > 0 else FALL_SHARE
    return min(expected_ns + share * difference_ns, MAX_GROWTH * expected_ns)
