"""Real-time priority and locked memory for the process of the controller."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from handctl.runtime.clocks.awake_processors import AwakeProcessors


@dataclass(frozen=True, slots=True)
class GrantedPriority:
    """Permissions that the operating system has granted: real-time priority, locked memory, and awake processors.

    Attributes:
        is_realtime: True if the system has granted SCHED_FIFO, the scheduling class with real-time
            priority.
        is_memory_locked: True if the memory of the process is locked against paging.
        are_processors_awake: True if the system permits that idle processors stay awake while the
            ticks run, see ``awake_processors``.
    """

    is_realtime: bool
    is_memory_locked: bool
    are_processors_awake: bool = False

    def __str__(self) -> str:
        """List the granted and the refused permissions in one line."""
        priority_text = (
            "SCHED_FIFO" if self.is_realtime else "no real-time priority (not permitted)"
        )
        memory = ", memory locked" if self.is_memory_locked else ", memory not locked"
        return (
            priority_text
            + memory
            + (", processors kept awake" if self.are_processors_awake else "")
        )


def request_priority(level: int = 60) -> GrantedPriority:
    """Request the scheduling class SCHED_FIFO and locked memory.

    The result says which of the two requests the system has refused. A refusal raises no error.
    """
    # The memory is locked before SCHED_FIFO is requested. Locking the memory fills hundreds of MB.
    # Under SCHED_FIFO, no other process on the same core could run while the memory is locked.
    is_memory_locked = _lock_memory()
    return GrantedPriority(_set_fifo_scheduling(level), is_memory_locked)


def prepare_priority() -> GrantedPriority:
    """Lock the memory, and test whether the system will grant SCHED_FIFO.

    The function :func:`realtime_priority` requests SCHED_FIFO later. The start of a control loop
    takes a quarter of a second. During the start of the control loop, the process has no real-time
    priority, so that other processes can use the core.
    """
    is_memory_locked = _lock_memory()
    processors = AwakeProcessors()
    with realtime_priority(processors) as is_realtime:
        return GrantedPriority(is_realtime, is_memory_locked, processors.are_kept_awake)


@contextmanager
def realtime_priority(processors: AwakeProcessors, level: int = 60) -> Iterator[bool]:
    """Run a ``with`` block under SCHED_FIFO on awake processors.

    Yield True if the system has granted SCHED_FIFO.

    Args:
        processors: the idle processors, which the ``with`` block keeps awake.
        level: priority within SCHED_FIFO.
    """
    try:
        with processors.keep_awake():
            yield _set_fifo_scheduling(level)
    finally:
        _restore_scheduling()


def restore_priority() -> None:
    """Return to ordinary scheduling and unlock the memory, after the control loop has ended."""
    _restore_scheduling()
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).munlockall()


def _restore_scheduling() -> None:
    """Return from SCHED_FIFO to ordinary scheduling. Any other scheduling class stays unchanged."""
    if not sys.platform.startswith("linux"):
        return
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _set_fifo_scheduling(level: int) -> bool:
    """Enter SCHED_FIFO, and return True if the system grants it.

    Child processes start with ordinary scheduling.
    """
    if not sys.platform.startswith("linux"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(level))
    except (PermissionError, OSError):
        return False
    return True


MCL_CURRENT = 1
MCL_FUTURE = 2
MCL_ONFAULT = 4
"""Flags of ``mlockall``. Source: Linux ``mman.h``."""
MADV_POPULATE_READ = 22
"""Advice for ``madvise`` that loads all pages of a mapping, since Linux 5.14. Source: ``mman-common.h``."""
COMPILER_LIBRARY = "libllvmlite"
"""Library of the compiler, which no tick uses.

The library has 150 MB, more than all other libraries of a run together.
"""


def _lock_memory() -> bool:
    """Lock all present and future memory pages of this process.

    All pages of the libraries are loaded, except those of the compiler. The first use of a page
    that is not loaded can take milliseconds.

    Return True if the system allows the process to lock its memory.
    """
    if not sys.platform.startswith("linux"):
        return False
    libc = ctypes.CDLL(None, use_errno=True)
    # With MCL_ONFAULT, Linux locks the loaded pages now, and each other page when it is loaded.
    # Without MCL_ONFAULT, Linux loads all pages, and the start of a run takes 0.05 s longer.
    if libc.mlockall(MCL_CURRENT | MCL_ONFAULT) or not _load_libraries(libc):
        return bool(libc.mlockall(MCL_CURRENT | MCL_FUTURE) == 0)
    return bool(libc.mlockall(MCL_FUTURE) == 0)


def _load_libraries(libc: ctypes.CDLL) -> bool:
    """Load all pages of the files that are mapped into this process, except the compiler.

    Return False if the kernel is too old, or if it cannot load a page.
    """
    for mapping in Path("/proc/self/maps").read_text().splitlines():
        addresses, permissions, _, _, _, *path = mapping.split(maxsplit=5)
        if permissions[0] != "r" or not path or path[0][0] != "/" or COMPILER_LIBRARY in path[0]:
            continue
        start, end = (int(address, 16) for address in addresses.split("-"))
        if libc.madvise(ctypes.c_void_p(start), ctypes.c_size_t(end - start), MADV_POPULATE_READ):
            return False
    return True
