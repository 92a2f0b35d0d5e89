"""A clock that the simulator and the controller on one machine share.

The clock pauses while the machine is too slow.

If the operating system stops the simulator for many milliseconds, the answers of the simulator
arrive late, although the simulated hand has no fault. A controller that uses the shared clock waits
for late answers of the simulator. In every tick, the controller sets a limit for the time of the
clock, called the gate. The clock does not advance beyond the gate until the controller moves the
gate. The simulator waits at the gate for at most ``MAX_GATE_WAIT_NS``.

The clock is a file with six 64-bit integers. Both processes map the file into memory:

    version | gate [ns] | sum of the pauses [ns] | ticks sent | ticks answered | reached [ns]

The simulator writes the version and the last two integers. The controller writes the other
integers. All times in the file are CLOCK_MONOTONIC minus the sum of the pauses. The time scale of
the simulation does not change the times in the file.
"""

import mmap
import os
import time
from array import array
from pathlib import Path

from firmware_sim.description.hand_description import SimulatorError

CLOCK_FILE_VERSION = 1
GATE_INDEX, PAUSED_INDEX, SENT_INDEX, ANSWERED_INDEX, REACHED_INDEX = 1, 2, 3, 4, 5
"""Indices of the integers in the file of the shared clock."""
CLOCK_FILE_INTEGER_COUNT = 6
OPEN_GATE_NS = 2**63 - 1
"""Value of the gate (time limit for the simulator) if no controller uses the clock [ns]."""
MAX_GATE_WAIT_NS = 120_000_000
"""Longest time for which the simulator waits at the gate (the time limit of the controller), as wall time [ns].

A controller that does not move the gate for a longer time has stopped or died.

The longest wait at the gate is shorter than the delay at which the clock of the plant slips. The
longest pause of the clock for a late controller is shorter than the longest wait at the gate.
"""


class SharedClock:
    """The clock of a simulator. A controller can pause the clock, and can set the gate (a time limit for the clock).

    The class ``bus_server.ServerClock`` describes the methods.

    Until ``create_file`` is called, no controller shares the clock, and the time of the clock is
    CLOCK_MONOTONIC times the scale.

    Attributes:
        scale: ratio of plant time to wall time.
    """

    def __init__(self, scale: float = 1.0) -> None:
        """Start without a controller.

        Args:
            scale: ratio of plant time to wall time.
        """
        self.scale = scale
        self._path: Path | None = None
        self._numbers = memoryview(
            array("q", [CLOCK_FILE_VERSION, OPEN_GATE_NS, *[0] * (CLOCK_FILE_INTEGER_COUNT - 2)])
        )

    def create_file(self, path: Path) -> None:
        """Create the file through which a controller shares the clock.

        Args:
            path: path of the file. If an earlier simulator was killed and has left a clock file at
                this path, the file is replaced.

        Raises:
            SimulatorError: the file cannot be created.
        """
        try:
            path.unlink(missing_ok=True)
            descriptor = os.open(
                path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600
            )
            try:
                os.write(descriptor, self._numbers)
                self._numbers = memoryview(mmap.mmap(descriptor, self._numbers.nbytes)).cast("q")
            finally:
                os.close(descriptor)
        except OSError as error:
            raise SimulatorError(f"clock file {path}: {error.strerror}") from error
        self._path = path

    def now_ns(self) -> int:
        """Return the present time [ns].

        If the present time is past the gate by at most ``MAX_GATE_WAIT_NS``, return the time of the
        gate. The controller sets the gate as a time limit for the clock.
        """
        now, gate = time.monotonic_ns() - self._numbers[PAUSED_INDEX], self._numbers[GATE_INDEX]
        if gate < now <= gate + MAX_GATE_WAIT_NS:
            now = gate
        return int(now * self.scale)

    def sent_tick_count(self) -> int:
        """Return the number of ticks for which the controller has sent all frames."""
        return self._numbers[SENT_INDEX]

    def publish_answered_ticks(self, ticks: int) -> None:
        """Tell the controller the number of ticks for which the nodes have answered all frames."""
        self._numbers[ANSWERED_INDEX] = ticks

    def publish_reached_time(self, t_ns: int) -> None:
        """Tell the controller the time that the plant has reached [ns]."""
        self._numbers[REACHED_INDEX] = int(t_ns / self.scale)

    def close(self) -> None:
        """Remove the file of the clock.

        A controller that still maps the file into memory then sees a stopped simulator, and waits
        for the simulator.
        """
        if self._path:
            self._path.unlink(missing_ok=True)
