"""Time of a run: absolute deadlines on CLOCK_MONOTONIC, with an optional scale.

The virtual time of lockstep is in ``lockstep``.
"""

import time
from dataclasses import dataclass
from typing import Protocol

SPIN_NS = 60_000
"""Time before a deadline in which a process with real-time priority spins instead of sleeping [ns of wall time].

``time.sleep`` returns about 50 us late, even under SCHED_FIFO.
"""


class Clock(Protocol):
    """Clock of the control loop. All times are in the run's time unless wall time is stated."""

    def start(self) -> None:
        """Start the run's time. The next tick is tick 0."""
        ...

    def wait(self, k: int) -> int:
        """Wait for the deadline of tick k and return the lateness [ns], 0 or more."""
        ...

    def now_ns(self) -> int:
        """Return the time since the start of the run [ns]."""
        ...

    def facts(self) -> dict[str, str]:
        """Return facts about the clock for the end of the log, by name."""
        ...


@dataclass
class RealClock:
    """Clock with deadlines at start + k * period on CLOCK_MONOTONIC.

    With scale 0.1, one second of the run takes ten seconds.

    Attributes:
        period_ns: control period [ns of the run's time].
        scale: run time divided by wall time.
        spin: True to spin before each deadline, useful only with real-time priority.
        start_ns: reading of the clock at tick 0 [ns of wall time].
        pauses: number of pauses of a clock that can pause, see ``shared``.
        paused_ns: sum of the pauses [ns of wall time].
    """

    period_ns: int
    scale: float = 1.0
    spin: bool = False
    start_ns: int = 0
    pauses: int = 0
    paused_ns: int = 0

    def start(self) -> None:
        """Start the run's time. The deadline of tick 0 is one period from now."""
        self.start_ns = self._read_ns() + int(self.period_ns / self.scale)

    def wait(self, k: int) -> int:
        """Wait for the deadline of tick k and return the lateness [ns], see ``Clock``."""
        return int(self._wait_until(self._deadline(k)) * self.scale)  # from wall time to the run's time

    def now_ns(self) -> int:
        """Return the time since the start of the run [ns]."""
        return self.of(time.monotonic_ns())

    def facts(self) -> dict[str, str]:
        """Return facts about the clock, see ``Clock``."""
        return {}

    def of(self, monotonic_ns: int) -> int:
        """Convert a CLOCK_MONOTONIC time stamp to the run's time [ns]."""
        return int((monotonic_ns - self.start_ns) * self.scale)

    def _read_ns(self) -> int:
        """Return the reading of the clock [ns of wall time]."""
        return time.monotonic_ns()

    def _deadline(self, k: int) -> int:
        """Return the reading of the clock at the deadline of tick k [ns of wall time]."""
        return self.start_ns + int(k * self.period_ns / self.scale)

    def _wait_until(self, deadline: int) -> int:
        """Wait until the clock reads the deadline, and return the lateness [ns of wall time]."""
        early = deadline - self._read_ns() - (SPIN_NS if self.spin else 0)
        if early > 0:
            time.sleep(early / 1e9)
        while (now := self._read_ns()) < deadline:  # sleep may return early, so the loop also does the spinning
            if not self.spin:
                time.sleep((deadline - now) / 1e9)
        return now - deadline
