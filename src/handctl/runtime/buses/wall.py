"""What to add to the wall clock, by which the kernel stamps frames, to have CLOCK_MONOTONIC.

Both clocks run at the same rate, so the difference changes only when somebody sets the wall clock; whoever finds that
a stamp cannot be asks for it anew. Where reading a clock is a system call (user-mode Linux), two readings a tick cost
as much as the exchange itself. Source: man 2 clock_gettime, man 7 vdso.
"""

import time

LIFE = 256
"""Times that it is used before it is measured again: bounds how long a small step of the wall clock goes unnoticed."""
TRIES = 3


class WallOffset:
    """The difference, measured now and then."""

    def __init__(self) -> None:
        self._left = 0
        self._offset_ns = 0

    def ns(self) -> int:
        """CLOCK_MONOTONIC less CLOCK_REALTIME [ns]."""
        if not self._left:
            self._measure()
        self._left -= 1
        return self._offset_ns

    def renew(self) -> None:
        """Measure it before it is used again."""
        self._left = 0

    def _measure(self) -> None:
        """The narrowest of some readings: the process may be interrupted between two clocks."""
        readings = [(time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(TRIES)]
        before, wall, after = min(readings, key=_width)
        self._offset_ns, self._left = (before + after) // 2 - wall, LIFE


def _width(reading: tuple[int, int, int]) -> int:
    return reading[2] - reading[0]
