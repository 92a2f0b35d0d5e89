"""Detection of a suspend of the machine.

During a suspend, the clock CLOCK_BOOTTIME continues, and CLOCK_MONOTONIC stands still.
"""

import time
from collections.abc import Callable

from handctl.core.tick_types import IoEvent

MIN_SUSPEND_NS = 20_000_000
"""Shortest suspend that is reported [ns]."""
MAX_READ_DURATION_NS = 1_000_000
"""Longest accepted duration of a reading of both clocks [ns].

A reading that takes longer has been interrupted, and is discarded.
"""


def read_boot_clock_ns() -> int:
    """Return the time since the machine was started [ns].

    The result includes the time of suspends if the system has CLOCK_BOOTTIME.
    """
    clock: int = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    return time.clock_gettime_ns(clock)


class SuspendWatch:
    """Detector of suspends of the machine. Each call of ``take_events`` compares CLOCK_BOOTTIME and CLOCK_MONOTONIC."""

    def __init__(
        self,
        read_boot_clock: Callable[[], int] = read_boot_clock_ns,
        read_monotonic_clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Store the present difference between the two clocks, as the reference of the first ``take_events``.

        Args:
            read_boot_clock: clock that continues during a suspend [ns].
            read_monotonic_clock: clock that stops during a suspend [ns].
        """
        self._boot = read_boot_clock
        self._monotonic = read_monotonic_clock
        self._difference_ns = self._clock_difference()

    def _clock_difference(self) -> int | None:
        """Return the boot clock minus the monotonic clock [ns].

        If the reading of the clocks was interrupted, return None.
        """
        time_before = self._monotonic()
        boot_time_ns = self._boot()
        return (
            boot_time_ns - time_before
            if self._monotonic() - time_before < MAX_READ_DURATION_NS
            else None
        )

    def take_events(self) -> list[IoEvent]:
        """Return an event with the duration [ms] if the machine was suspended since the last call."""
        difference_ns = self._clock_difference()
        if difference_ns is None:
            return []
        suspend_ns = 0 if self._difference_ns is None else difference_ns - self._difference_ns
        self._difference_ns = difference_ns
        return (
            [IoEvent("suspended", "host", suspend_ns // 1_000_000)]
            if suspend_ns > MIN_SUSPEND_NS
            else []
        )
