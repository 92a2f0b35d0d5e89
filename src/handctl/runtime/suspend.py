"""Noticing that the whole machine slept: CLOCK_BOOTTIME goes on in a suspend, CLOCK_MONOTONIC stands still."""

import time
from collections.abc import Callable

from handctl.core.types import IoEvent

LEAST_NS = 20_000_000
"""Only more than this is a suspend [ns]."""
TOGETHER_NS = 1_000_000
"""A look at the clocks that took longer was interrupted, and says nothing [ns]."""


def boot_ns() -> int:
    """Time since the machine was started, suspends included [ns]; where there is no such clock, without them."""
    clock: int = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
    return time.clock_gettime_ns(clock)


class SuspendWatch:
    """Compares the two clocks whenever it is asked."""

    def __init__(self, boot: Callable[[], int] = boot_ns, monotonic: Callable[[], int] = time.monotonic_ns) -> None:
        """Args: the two clocks [ns]."""
        self._boot, self._monotonic = boot, monotonic
        self._apart_ns = self._look()

    def _look(self) -> int | None:
        """How far the clocks are apart [ns]; None if something came between the looks at them."""
        before, boot = self._monotonic(), self._boot()
        return boot - before if self._monotonic() - before < TOGETHER_NS else None

    def events(self) -> list[IoEvent]:
        """A suspend since the last call, with its length [ms]."""
        apart_ns = self._look()
        if apart_ns is None:
            return []
        known, self._apart_ns = self._apart_ns, apart_ns
        slept_ns = 0 if known is None else apart_ns - known
        return [IoEvent("suspended", "host", slept_ns // 1_000_000)] if slept_ns > LEAST_NS else []
