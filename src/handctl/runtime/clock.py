"""Time of a run: absolute deadlines on CLOCK_MONOTONIC, possibly slowed; nobody sleeps in lockstep (``lockstep``)."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

SPIN_NS = 60_000
"""The last stretch before a deadline is spun, not slept, when the process has real-time priority [ns of wall time]."""


class Clock(Protocol):
    """What the loop asks of time."""

    def begin(self) -> None:
        """Time begins: tick 0 is next."""
        ...

    def wait(self, k: int) -> int:
        """Wait for tick k's deadline; how late it is now [ns of the run's time], 0 or more."""
        ...

    def now_ns(self) -> int:
        """Time since the start of the run [ns of the run's time]."""
        ...


@dataclass
class RealClock:
    """Deadlines at start + k * period on CLOCK_MONOTONIC; with scale 0.1 the run's second takes ten.

    Attributes:
        period_ns: control period [ns of the run's time].
        scale: run time per wall time.
        spin: whether to spin before the deadline (worth it only with real-time priority).
    """

    period_ns: int
    scale: float = 1.0
    spin: bool = False
    start_ns: int = 0

    def begin(self) -> None:
        """Tick 0 is one period from now."""
        self.start_ns = time.monotonic_ns() + int(self.period_ns / self.scale)

    def wait(self, k: int) -> int:
        """See ``Clock``."""
        deadline = self.start_ns + int(k * self.period_ns / self.scale)
        early = deadline - time.monotonic_ns() - (SPIN_NS if self.spin else 0)
        if early > 0:
            time.sleep(early / 1e9)
        while (now := time.monotonic_ns()) < deadline:
            if not self.spin:
                time.sleep((deadline - now) / 1e9)
        return int((now - deadline) * self.scale)

    def now_ns(self) -> int:
        """See ``Clock``."""
        return self.of(time.monotonic_ns())

    def of(self, monotonic_ns: int) -> int:
        """The run's time of a CLOCK_MONOTONIC time stamp [ns]."""
        return int((monotonic_ns - self.start_ns) * self.scale)


@dataclass(frozen=True, slots=True)
class Priority:
    """What the operating system granted.

    Attributes:
        realtime: SCHED_FIFO.
        locked: memory locked against paging.
    """

    realtime: bool
    locked: bool

    def __str__(self) -> str:
        granted = "SCHED_FIFO" if self.realtime else "no real-time priority (not permitted)"
        return granted + (", memory locked" if self.locked else ", memory not locked")


def take_priority(level: int = 60) -> Priority:
    """Ask for SCHED_FIFO and locked memory; what is refused is said in the result, never an error."""
    locked = _lock_memory()  # first: it fills hundreds of MB, and what else wants this core must not wait for that
    return Priority(_fifo(level), locked)


def prepare_priority() -> Priority:
    """Lock the memory, and try what :func:`urgent` will get: to start a loop takes a quarter of a second, in which
    nobody need wait for it."""
    locked = _lock_memory()
    with urgent() as granted:
        return Priority(granted, locked)


@contextmanager
def urgent(level: int = 60) -> Iterator[bool]:
    """SCHED_FIFO for a block; whether it was granted."""
    try:
        yield _fifo(level)
    finally:
        _ordinary()


def give_back_priority() -> None:
    """An ordinary process again: what comes after the loop may be preempted and paged."""
    _ordinary()
    if sys.platform.startswith("linux"):
        import ctypes

        ctypes.CDLL(None).munlockall()


def _ordinary() -> None:
    if not sys.platform.startswith("linux"):
        return
    import os

    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _fifo(level: int) -> bool:
    if not sys.platform.startswith("linux"):
        return False
    import os

    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(level))
    except (PermissionError, OSError):
        return False
    return True


MCL_CURRENT, MCL_FUTURE = 1, 2
"""Source: Linux ``mman.h``."""


def _lock_memory() -> bool:
    if not sys.platform.startswith("linux"):
        return False
    import ctypes

    return bool(ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT | MCL_FUTURE) == 0)
