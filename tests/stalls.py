"""Whether the machine stood still: a test of the clock that failed in such a moment has told nothing.

A virtual machine is now and then not run for tens of milliseconds, and a controller that meets that ends its run, as it
should. A sleeper on each core, in a process of its own, sees it from outside of what is tested.
"""

import contextlib
import os
import subprocess
import sys
import time

NAP_S = 0.002
STALL_S = 0.010
"""A nap that ends so much too late is a stall: a core that is only busy wakes a sleeper within some milliseconds."""


class StallMeter:
    """Sleepers that tell when they woke up late; they start with the object and end with :meth:`close`.

    Attributes:
        pids: of the sleepers, one a core.
    """

    def __init__(self) -> None:
        command = [sys.executable, "-I", "-S", __file__]
        self._sleepers = [
            subprocess.Popen([*command, str(core)], stdout=subprocess.PIPE) for core in os.sched_getaffinity(0)
        ]
        for sleeper in self._sleepers:
            assert sleeper.stdout
            sleeper.stdout.readline()
            os.set_blocking(sleeper.stdout.fileno(), False)
        self.pids = [sleeper.pid for sleeper in self._sleepers]
        self._unread: list[tuple[float, float]] = []

    def longest_since(self, begin: float) -> float:
        """The longest stall that ended after a moment of ``time.monotonic`` [s]; zero if there was none."""
        for sleeper in self._sleepers:
            assert sleeper.stdout
            for line in (sleeper.stdout.read() or b"").splitlines():
                ended, late = map(float, line.split())
                self._unread.append((ended, late))
        self._unread = [(ended, late) for ended, late in self._unread if ended > begin]
        return max((late for _, late in self._unread), default=0.0)

    def close(self) -> None:
        """End the sleepers."""
        for sleeper in self._sleepers:
            sleeper.kill()
            sleeper.communicate()


def _sleep(core: int) -> None:
    """Nap on one core until nobody listens any more, and tell of each stall when it ended and how long it was [s]."""
    os.sched_setaffinity(0, {core})
    parent, last = os.getppid(), time.monotonic()
    print("ready", flush=True)
    while os.getppid() == parent:
        time.sleep(NAP_S)
        now = time.monotonic()
        if now - last - NAP_S > STALL_S:
            print(now, now - last - NAP_S, flush=True)
        last = now


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        _sleep(int(sys.argv[1]))
