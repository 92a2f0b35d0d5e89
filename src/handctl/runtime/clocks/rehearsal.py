"""Rehearsal of a tick shortly before its deadline, so that the caches contain the code and the data of the tick.

Between two ticks, other programs use the caches of the processor. When other programs have used the
caches, a tick takes longer than directly after another tick. In the last microseconds before a
deadline, the clock only waits. While the clock waits, the control loop executes the beginning of
the last tick again and discards the result. A tick has no side effects, so a rehearsal changes
nothing.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from handctl.runtime.clocks.expected_time import ExpectedTime

SHORTEST_PERIOD_NS = 1_500_000
"""Shortest control period with rehearsals [ns of wall time].

At a control rate of 1 kHz, the caches still contain the last tick, and rehearsals do not shorten the ticks.
"""
MAX_PERIOD_SHARE = 1 / 8
"""Largest share of a control period that is reserved for the wake-up of the process and a rehearsal.

On a slow processor or at a high rate, wake-up and rehearsal take longer than this share. In that case,
there are no rehearsals.
"""
MARGIN_NS = 5_000
"""Time between the expected end of a rehearsal and the deadline [ns]."""
INITIAL_DURATION_NS = 150_000
"""Assumed duration of the first rehearsal [ns]."""
RETRY_SHARE = 1 / 1024
"""Share by which the expected duration falls in each tick for which a rehearsal takes too long.

As a result, the clock sometimes tries whether a rehearsal has become shorter.
"""


def rehearsal_for_period(
    execute_steps: Callable[[], Iterator[None]], period_ns: int
) -> "Rehearsal | None":
    """Return the rehearsal of the ticks of a run, or None if the control period is too short for rehearsals.

    Args:
        execute_steps: see ``Rehearsal``.
        period_ns: control period [ns of wall time].
    """
    return Rehearsal(execute_steps, period_ns) if period_ns >= SHORTEST_PERIOD_NS else None


@dataclass
class Rehearsal:
    """Rehearsals of ticks during one run, and an estimate of the duration of the next rehearsal.

    Attributes:
        execute_steps: function that executes two steps of the last tick again, and yields between
            them.
        period_ns: control period [ns of wall time].
        duration: expected duration of the next rehearsal.
    """

    execute_steps: Callable[[], Iterator[None]]
    period_ns: int
    duration: ExpectedTime = field(default_factory=lambda: ExpectedTime(INITIAL_DURATION_NS))

    def lead_time_ns(self, wake_up_delay_ns: float) -> int:
        """Return the time before a deadline at which the process must wake up for a rehearsal [ns].

        If the lead time exceeds the permitted fraction of the control period, return 0.

        Args:
            wake_up_delay_ns: expected delay of the wake-up [ns].
        """
        lead_ns = int(wake_up_delay_ns + self.duration.expected_ns + MARGIN_NS)
        return lead_ns if lead_ns <= MAX_PERIOD_SHARE * self.period_ns else 0

    def shorten_expected_duration(self) -> None:
        """Reduce the expected duration a little, because there is no time for a rehearsal in this tick."""
        self.duration.expected_ns -= RETRY_SHARE * self.duration.expected_ns

    def rehearse(self, remaining_ns: int) -> None:
        """Execute two steps of the last tick again, if the time until the deadline is long enough.

        If the time that remains after the first step is shorter than the first step, the second
        step is left out.

        Args:
            remaining_ns: time until the deadline [ns].
        """
        if remaining_ns < self.duration.expected_ns:
            return
        start_ns = time.monotonic_ns()
        for _ in self.execute_steps():
            step_ns = time.monotonic_ns() - start_ns
            if remaining_ns - step_ns < step_ns:
                duration_ns = 2 * step_ns  # an upper estimate, because the second step is left out
                break
        else:
            duration_ns = time.monotonic_ns() - start_ns
        self.duration.follow(duration_ns)
