"""Request to Linux that idle processors stay awake while the control loop runs.

A sleeping processor can take a millisecond to wake up. After the sleep, its caches can contain the
data of other programs. For these reasons, idle processors stay awake during a run.

In a virtual machine, an awake processor uses a processor of the host all the time. A host can limit
the processor time of a virtual machine. A limit of Linux (``cpu.max`` of a control group) counts the
processor time in periods of 100 ms, and stops a virtual machine that has reached the limit until the
end of the period. To stay below such a limit, idle processors sleep before one of eight ticks. The
page "Speed" of the documentation contains the measurements.
"""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CPU_LATENCY_FILE = "/dev/cpu_dma_latency"
"""File through which a process tells Linux how fast idle processors must wake up."""
ZERO_LATENCY = bytes(4)
"""Wake-up time of 0 us to write into ``CPU_LATENCY_FILE``, as a 32-bit integer."""
ANY_LATENCY = (2_000_000_000).to_bytes(4, "little")
"""Wake-up time without a limit. Source: Linux ``pm_qos.h``, PM_QOS_CPU_LATENCY_DEFAULT_VALUE."""
TICKS_PER_PROCESSOR_SLEEP = 8
"""In a virtual machine, idle processors sleep before one of this number of ticks."""
PROCESSOR_FILE = Path("/proc/cpuinfo")
"""File in which Linux describes the processors."""


def is_virtual_machine() -> bool:
    """Return True if the processor reports a hypervisor.

    Only x86 processors report a hypervisor in the file ``PROCESSOR_FILE``. On other processors, the
    result is False.
    """
    try:
        with PROCESSOR_FILE.open(encoding="utf-8") as lines:
            flags = next((line for line in lines if line.startswith("flags")), "")
    except OSError:
        return False
    return "hypervisor" in flags.split()


class AwakeProcessors:
    """Idle processors that stay awake during a run, if the system permits it."""

    def __init__(self) -> None:
        """Leave the processors as they are until :meth:`keep_awake`."""
        self._is_virtual_machine = False
        self._descriptor: int | None = None
        self._wait_count = 0

    @contextmanager
    def keep_awake(self) -> Iterator[bool]:
        """Keep idle processors awake during a ``with`` block, except in the sleeps of :meth:`sleep`.

        Yield True if the system permits that processors stay awake.
        """
        self._is_virtual_machine = is_virtual_machine()
        self._descriptor = _open_latency_request()
        try:
            yield self.are_kept_awake
        finally:
            if self._descriptor is not None:
                os.close(self._descriptor)
            self._descriptor = None

    @property
    def are_kept_awake(self) -> bool:
        """Return True in a ``with`` block of :meth:`keep_awake` that the system permits."""
        return self._descriptor is not None

    def begin_wait(self) -> bool:
        """Count a wait for a tick, and return True if the processors must sleep in this wait.

        The result is True before one of ``TICKS_PER_PROCESSOR_SLEEP`` ticks, if the processors of a
        virtual machine are kept awake.
        """
        self._wait_count += 1
        return (
            self._is_virtual_machine
            and self.are_kept_awake
            and not self._wait_count % TICKS_PER_PROCESSOR_SLEEP
        )

    def sleep(self, duration_s: float) -> None:
        """Let the process sleep for a time [s], and permit that the idle processors sleep meanwhile."""
        if self._descriptor is None:
            time.sleep(duration_s)
            return
        os.write(self._descriptor, ANY_LATENCY)
        time.sleep(duration_s)
        os.write(self._descriptor, ZERO_LATENCY)


def _open_latency_request() -> int | None:
    """Request that idle processors stay awake, and return the file descriptor of the request.

    The request ends when the descriptor is closed. The result is None if the system does not permit
    the request. Source: Linux, Documentation/power/pm_qos_interface.
    """
    try:
        descriptor = os.open(CPU_LATENCY_FILE, os.O_WRONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        os.write(descriptor, ZERO_LATENCY)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor
