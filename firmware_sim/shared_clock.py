"""A clock shared with the controller on this machine, which pauses where the machine is too slow.

The operating system may stop the simulator for many milliseconds. The answers of the simulator are
then late, although the simulated hand works correctly. A controller that uses the shared clock
waits for the answers. The simulator never advances beyond the gate, a time that the controller sets
in every tick.

The file of the clock has six 64-bit integers, which both processes map:

    version | gate [ns] | sum of the pauses [ns] | ticks sent | ticks answered | reached [ns]

The simulator writes the version and the last two numbers, the controller writes the others. All times
are CLOCK_MONOTONIC minus the pauses, without the time scale.
"""

import mmap
import os
import time
from array import array
from pathlib import Path

from firmware_sim.description import SimulatorError

VERSION = 1
GATE, PAUSED, SENT, ANSWERED, REACHED = 1, 2, 3, 4, 5
"""Indices of the integers in the file."""
COUNT = 6
OPEN_GATE = 2**63 - 1
"""Gate without a controller."""
MAX_GATE_WAIT_NS = 120_000_000
"""Longest wait at the gate [ns of wall time]. A controller that stays away for longer has stopped or died.

This wait is shorter than the delay at which the plant's clock slips, and longer than the longest
pause for a late controller.
"""


class SharedClock:
    """Clock of a simulator with the pauses and the gate of a controller. See ``server.ServerClock``.

    Before ``publish`` no controller shares it, and its time is CLOCK_MONOTONIC times the scale.

    Attributes:
        scale: plant time per wall time.
    """

    def __init__(self, scale: float = 1.0) -> None:
        """Start without a controller.

        Args:
            scale: plant time per wall time.
        """
        self.scale = scale
        self._path: Path | None = None
        self._numbers = memoryview(array("q", [VERSION, OPEN_GATE, *[0] * (COUNT - 2)]))

    def publish(self, path: Path) -> None:
        """Create the file of the clock, so that a controller can share it.

        Args:
            path: path of the file. A file that a killed simulator left is replaced.

        Raises:
            SimulatorError: the file cannot be created.
        """
        try:
            path.unlink(missing_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
            try:
                os.write(descriptor, self._numbers)
                self._numbers = memoryview(mmap.mmap(descriptor, self._numbers.nbytes)).cast("q")
            finally:
                os.close(descriptor)
        except OSError as error:
            raise SimulatorError(f"clock file {path}: {error.strerror}") from error
        self._path = path

    def now_ns(self) -> int:
        """Return the present time, at most the gate [ns]."""
        now, gate = time.monotonic_ns() - self._numbers[PAUSED], self._numbers[GATE]
        if gate < now <= gate + MAX_GATE_WAIT_NS:
            now = gate
        return int(now * self.scale)

    def ticks_sent(self) -> int:
        """Return the number of ticks whose frames the controller has sent."""
        return self._numbers[SENT]

    def note_answered(self, ticks: int) -> None:
        """Report that all frames of a number of ticks are answered."""
        self._numbers[ANSWERED] = ticks

    def note_reached(self, t_ns: int) -> None:
        """Report the time that the plant has reached [ns]."""
        self._numbers[REACHED] = int(t_ns / self.scale)

    def close(self) -> None:
        """Remove the file. A controller that still maps it waits no longer than for a stopped simulator."""
        if self._path:
            self._path.unlink(missing_ok=True)
