"""Detect stalls of the machine.

A host sometimes pauses a virtual machine for tens of milliseconds. If the machine stalls during a
test in real time, the controller must end its run, and the test fails. A test that fails because of
a stall does not show a defect in the code. To detect stalls independently of the tested processes,
one process on each core sleeps again and again, and measures how late it wakes up.
"""

import contextlib
import os
import subprocess
import sys
import time

SLEEP_PERIOD_S = 0.002
"""Duration of one sleep of a process that measures stalls [s]."""
MIN_STALL_S = 0.010
"""If a sleeping process wakes up late by at least this time, the machine has stalled [s].

Even a busy core wakes a sleeping process within some milliseconds.
"""


class ComputerPauseMeter:
    """Detector of stalls: one sleeping process on each core reports if it wakes up late.

    The sleeping processes run until :meth:`close` is called.

    Attributes:
        pids: process ids of the sleeping processes, one for each core.
    """

    def __init__(self) -> None:
        """Start the sleeping processes and wait until each process has started."""
        command = [sys.executable, "-I", "-S", __file__]
        self._sleepers = [
            subprocess.Popen([*command, str(core)], stdout=subprocess.PIPE)
            for core in os.sched_getaffinity(0)
        ]
        for sleeper in self._sleepers:
            assert sleeper.stdout
            sleeper.stdout.readline()
            os.set_blocking(sleeper.stdout.fileno(), False)
        self.pids = [sleeper.pid for sleeper in self._sleepers]
        self._unread: list[tuple[float, float]] = []

    def longest_stall_since(self, start_time_s: float) -> float:
        """Return the duration of the longest stall that ended after a given time of ``time.monotonic`` [s].

        If the machine had no stall, return zero.
        """
        for sleeper in self._sleepers:
            assert sleeper.stdout
            for line in (sleeper.stdout.read() or b"").splitlines():
                ended, late = map(float, line.split())
                self._unread.append((ended, late))
        self._unread = [(ended, late) for ended, late in self._unread if ended > start_time_s]
        return max((late for _, late in self._unread), default=0.0)

    def close(self) -> None:
        """End the sleeping processes."""
        for sleeper in self._sleepers:
            sleeper.kill()
            sleeper.communicate()


def _report_stalls(core: int) -> None:
    """Sleep on one core again and again, until the parent process has ended.

    Report the end and the duration of each stall [s].
    """
    os.sched_setaffinity(0, {core})
    parent_pid = os.getppid()
    last_time_s = time.monotonic()
    print("ready", flush=True)
    while os.getppid() == parent_pid:
        time.sleep(SLEEP_PERIOD_S)
        now_s = time.monotonic()
        if now_s - last_time_s - SLEEP_PERIOD_S > MIN_STALL_S:
            print(now_s, now_s - last_time_s - SLEEP_PERIOD_S, flush=True)
        last_time_s = now_s


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        _report_stalls(int(sys.argv[1]))
