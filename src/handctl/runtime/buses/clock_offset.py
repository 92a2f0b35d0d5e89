"""Offset from the wall clock, by which the kernel stamps frames, to CLOCK_MONOTONIC.

Both clocks run at the same rate. The offset changes only when the wall clock is set. The bus requests a
new measurement when a stamp is impossible. Where reading a clock is a system call (user-mode Linux), two
readings per tick cost as much as the exchange itself. Source: man 2 clock_gettime, man 7 vdso.
"""

import time

LIFE = 256
"""Uses of one measurement. They limit how long a small step of the wall clock goes unnoticed."""
TRIES = 3
"""Readings per measurement."""


class ClockOffset:
    """The offset between the clocks, measured every ``LIFE`` uses."""

    def __init__(self) -> None:
        """Start without a measurement."""
        self._uses_left = 0
        self._offset_ns = 0

    def ns(self) -> int:
        """Return CLOCK_MONOTONIC minus CLOCK_REALTIME [ns]."""
        if not self._uses_left:
            self._measure()
        self._uses_left -= 1
        return self._offset_ns

    def renew(self) -> None:
        """Request a new measurement before the next use."""
        self._uses_left = 0

    def _measure(self) -> None:
        """Measure the offset. The fastest of some readings counts, since a reading may be interrupted."""
        readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(TRIES)]
        before, wall, after = min(readings, key=_width)
        self._offset_ns = (before + after) // 2 - wall
        self._uses_left = LIFE


def _width(reading: tuple[int, int, int]) -> int:
    """Return the duration of a reading (before, wall clock, after) [ns]."""
    return reading[2] - reading[0]
