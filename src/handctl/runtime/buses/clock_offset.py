"""Offset from the wall clock to CLOCK_MONOTONIC, for the reception times of frames.

The kernel stamps frames with the wall clock.

Both clocks run at the same rate. The offset changes only when the wall clock is set. The bus
requests a new measurement when a frame has an impossible time stamp. Where reading a clock is a
system call (user-mode Linux), two readings per tick cost as much as the exchange itself. Source:
man 2 clock_gettime, man 7 vdso.
"""

import time

USES_PER_MEASUREMENT = 256
"""Number of uses of each measurement.

A small step of the wall clock is noticed after at most this number of uses.
"""
READINGS_PER_MEASUREMENT = 3
"""Number of clock readings per measurement."""


class ClockOffset:
    """Offset between the clocks, measured every ``USES_PER_MEASUREMENT`` uses."""

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
        """Measure the offset.

        The fastest of several readings is used, because a reading may be interrupted.
        """
        readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(READINGS_PER_MEASUREMENT)]
        before, wall, after = min(readings, key=_reading_duration)
        self._offset_ns = (before + after) // 2 - wall
        self._uses_left = USES_PER_MEASUREMENT


def _reading_duration(reading: tuple[int, int, int]) -> int:
    """Return the duration of a reading (before, wall clock, after) [ns]."""
    return reading[2] - reading[0]
