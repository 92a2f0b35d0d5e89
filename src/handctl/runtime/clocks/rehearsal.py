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
MAX_GROWTH = 1.25
"""Largest factor by which ``expected_ns`` grows after a rehearsal that took longer than expected.

An interruption by the operating system can make a single rehearsal very long.
"""
DECAY_SHARE = 1 / 64
"""Share by which ``expected_ns`` falls in each tick.

As a result, the expected duration is longer than most rehearsals of the last ticks.
"""


@dataclass
class Rehearsal:
    """Rehearsals of a run, with their expected duration.

    Attributes:
        execute_steps: function that executes steps of the last tick again, and yields after each step.
        expected_ns: expected duration of the next rehearsal [ns].
    """

    execute_steps: Callable[[], Iterator[None]]
    expected_ns: float = INITIAL_DURATION_NS

    def lead_time_ns(self, period_ns: int) -> int:
        """Return the time before a deadline at which the rehearsal must begin [ns].

        If the lead time is too long for the control period ``period_ns``, return 0.
        """
        lead_ns = int(self.expected_ns + MARGIN_SHARE * period_ns)
        return lead_ns if lead_ns <= MAX_PERIOD_SHARE * period_ns else 0

    def rehearse(self, remaining_ns: int, period_ns: int) -> None:
        """Execute steps of the last tick again, if the time until the deadline is long enough.

        If another step of the same length does not fit, the remaining steps are left out.

        Args:
            remaining_ns: time until the deadline [ns].
            period_ns: control period [ns].
        """
        duration_ns = 0
        if remaining_ns >= self.expected_ns and self.lead_time_ns(period_ns):
            start_ns = time.monotonic_ns()
            for _ in self.execute_steps():
                step_ns = time.monotonic_ns() - start_ns - duration_ns
                duration_ns += step_ns
                if remaining_ns - duration_ns < step_ns:
                    duration_ns += (
                        step_ns  # the steps that are left out belong to the next rehearsal
                    )
                    break
        if duration_ns > self.expected_ns:
            self.expected_ns = min(duration_ns, MAX_GROWTH * self.expected_ns)
        else:
            self.expected_ns -= DECAY_SHARE * self.expected_ns
