"""Rehearsal of a tick shortly before its deadline, so that the caches contain the code and the data of the tick.

Between two ticks, other programs use the caches of the processor. When other programs have used the
caches, a tick takes longer than directly after another tick. In the last microseconds before a
deadline, the clock only waits. While the clock waits, the control loop executes the beginning of
the last tick again and discards the result. A tick has no side effects, so a rehearsal changes
nothing.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

MARGIN_SHARE = 1 / 40
"""Time between the expected end of a rehearsal and the deadline, as a share of the control period.

A process that wakes up late uses this time between rehearsal and deadline.
"""
MAX_PERIOD_SHARE = 1 / 8
"""Largest share of a control period that is reserved for a rehearsal and its margin.

If a rehearsal takes longer than this share, as on a slow processor or at a high control rate, there
are no rehearsals.
"""
INITIAL_DURATION_NS = 200_000
"""Assumed duration of the first rehearsal [ns]."""
MAX_GROWTH = 2
"""Largest factor by which ``expected_ns`` grows after a rehearsal that took longer than expected.

An interruption by the operating system can make a single rehearsal very long.
"""
FALL_SHARE = 1 / 16
"""Share of the difference by which ``expected_ns`` falls after a rehearsal that was shorter than expected."""
DECAY_SHARE = 1 / 1024
"""Share by which ``expected_ns`` falls in each tick without a rehearsal, so that rehearsals begin again."""


@dataclass
class Rehearsal:
    """Rehearsals of a run, with their expected duration.

    Attributes:
        execute: function that executes the last tick again.
        expected_ns: expected duration of the next rehearsal [ns].
    """

    execute: Callable[[], None]
    expected_ns: int = INITIAL_DURATION_NS

    def lead_time_ns(self, period_ns: int) -> int:
        """Return the time before a deadline at which the rehearsal must begin [ns].

        If the lead time is too long for the control period ``period_ns``, return 0.
        """
        lead_ns = self.expected_ns + int(MARGIN_SHARE * period_ns)
        return lead_ns if lead_ns <= MAX_PERIOD_SHARE * period_ns else 0

    def rehearse(self, remaining_ns: int, period_ns: int) -> None:
        """Execute the last tick again, if the time until the deadline is long enough.

        Args:
            remaining_ns: time until the deadline [ns].
            period_ns: control period [ns].
        """
        if remaining_ns < self.expected_ns or not self.lead_time_ns(period_ns):
            self.expected_ns -= int(DECAY_SHARE * self.expected_ns)
            return
        start_ns = time.monotonic_ns()
        self.execute()
        duration_ns = time.monotonic_ns() - start_ns
        if duration_ns > self.expected_ns:
            self.expected_ns = min(duration_ns, MAX_GROWTH * self.expected_ns)
        else:
            self.expected_ns += int(FALL_SHARE * (duration_ns - self.expected_ns))
