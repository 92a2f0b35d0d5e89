"""Noticing that the whole machine slept: CLOCK_BOOTTIME goes on in a suspend, CLOCK_MONOTONIC stands still."""

import time
from collections.abc import Callable

from handctl.controller.types import IoEvent

LEAST_NS = 20_000_000
"""The two clocks are read one after the other; only more than this is a suspend [ns]."""


def boot_ns() -> int:
    """Time since the machine was started, suspends included [ns]; where there is no such clock, without them."""
    clock: int = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    return time.clock_gettime_ns(clock)


class SuspendWatch:
    """Compares the two clocks whenever it is asked."""

    def __init__(self, boot: Callable[[], int] = boot_ns, monotonic: Callable[[], int] = time.monotonic_ns) -> None:
        """Args: the two clocks [ns]."""
        self._boot, self._monotonic = boot, monotonic
        self._apart_ns = boot() - monotonic()

    def events(self) -> list[IoEvent]:
        """A suspend since the last call, with its length [ms]."""
        apart_ns = self._boot() - self._monotonic()
        slept_ns, self._apart_ns = apart_ns - self._apart_ns, apart_ns
        return [IoEvent("suspended", "host", slept_ns // 1_000_000)] if slept_ns > LEAST_NS else []
