"""Clock that a controller and a simulator on one machine share.

The clock pauses when the machine is too slow.

A simulated hand and its controller are two processes on one machine. The operating system can
interrupt either process for many milliseconds. With real hardware, the operating system can
interrupt only the controller, and a late tick is a fault. In a simulation, a late tick after an
interruption tells nothing about the hand or the controller. To prevent faults because of
interruptions, the shared clock pauses in two cases:

- The controller wakes up too late. The clock continues from a time shortly after the deadline of
  the tick.
- The simulator has not yet answered the frames of the previous tick. The clock stands still until
  the answers of the simulator have arrived.

The time in both processes is CLOCK_MONOTONIC minus the sum of all pauses. The gate is the time at
which the shared clock pauses. The gate is shortly after the deadline of the next tick. The
controller moves the gate in every tick, and the simulator never advances beyond the gate. Each
pause is limited to a fraction of a second, so that a process that was killed or stopped leads to a
fault, as on a real bus.

The simulator creates a file with six 64-bit integers, and both processes map this file into memory:

    version | gate [ns] | sum of the pauses [ns] | ticks sent | ticks answered | reached [ns]

The controller writes the second, third and fourth integer of the file. The simulator writes the
other integers. The gate and the reached time are values of CLOCK_MONOTONIC minus the pauses, and
are not multiplied by the time scale. No lock is needed, because a 64-bit integer is written in one
operation.
"""

import mmap
import os
import time
from dataclasses import dataclass, field
from pathlib import Path

from handctl.runtime.clocks.real_clock import RealClock

CLOCK_FILE_VERSION = 1
GATE_INDEX, PAUSED_INDEX, SENT_INDEX, ANSWERED_INDEX, REACHED_INDEX = 1, 2, 3, 4, 5
"""Indices of the integers in the file of the shared clock."""
CLOCK_FILE_INTEGER_COUNT = 6
OPEN_GATE_NS = 2**63 - 1
"""Value of the gate while no controller uses the clock.

With this value, the simulator can advance without limit.
"""
TOLERATED_LATENESS_FRACTION = 0.1
"""Largest lateness of a tick that causes no pause, as a fraction of the control period."""
MAX_CONTROLLER_PAUSE_NS = 100_000_000
"""Longest lateness of the controller for which the clock adds a pause [ns].

If the controller wakes up even later, the ticks whose deadlines have passed count as missed.
"""
MAX_SIMULATOR_WAIT_NS = 250_000_000
"""Longest wait of the clock for the simulator [ns].

After this time, the run continues without the frames of the simulator. Frames that the simulator
has not sent in time count as missing, as on a real bus.
"""
SIMULATOR_POLL_PERIOD_S = 50e-6
"""Time between two checks of the simulator's progress [s]."""
MAX_SIMULATOR_LAG_NS = 1_500_000
"""Time by which a simulator can be behind the shared clock and still count as on time [ns of the run's time].

The simulator advances in steps of a millisecond.
"""


class ClockFile:
    """The file of a shared clock, mapped into memory.

    Attributes:
        numbers: the integers of the file.
    """

    def __init__(self, path: Path) -> None:
        """Map the file of a simulator's shared clock into memory.

        Raises:
            FileNotFoundError: the simulator does not offer a shared clock.
            ValueError: the file has another size or version.
        """
        descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            self._map = mmap.mmap(descriptor, 8 * CLOCK_FILE_INTEGER_COUNT)
        finally:
            os.close(descriptor)
        self.numbers = memoryview(self._map).cast("q")
        if self.numbers[0] != CLOCK_FILE_VERSION:
            raise ValueError(f"{path}: version {self.numbers[0]}; expected {CLOCK_FILE_VERSION}")

    def close(self) -> None:
        """Set the gate to a time that is never reached, and unmap the file.

        After this call, the simulator continues without the controller.
        """
        self.numbers[GATE_INDEX] = OPEN_GATE_NS
        self.numbers.release()
        self._map.close()


@dataclass
class SharedClock(RealClock):
    """Clock of a controller that shares the time with a simulator.

    The shared clock is a kind of ``RealClock``.

    Attributes:
        file: clock file of the simulator, mapped into memory.
    """

    file: ClockFile = field(kw_only=True)
    _last_pause_ns: tuple[int, int] = (0, 0)
    _answer_count_at_timeout: int = -1

    def start(self) -> None:
        """Start the run's time, see ``RealClock``."""
        super().start()
        self._move_gate(0)

    def wait(self, k: int) -> int:
        """Wait for the deadline of tick k, and for the answers of the simulator.

        Return the time since the deadline [ns].
        """
        self._numbers[SENT_INDEX] += 1
        deadline = self._deadline_ns(k)
        lateness_ns = self._wait_until(deadline)
        if lateness_ns <= MAX_CONTROLLER_PAUSE_NS:
            paused_ns = self._numbers[PAUSED_INDEX]
            self._pause_at_gate()
            self._wait_for_simulator(deadline)
            self._add_pause_to_statistics(self._numbers[PAUSED_INDEX] - paused_ns)
            lateness_ns = min(self._read_clock_ns(), self._numbers[GATE_INDEX]) - deadline
        self._move_gate(k + 1 + int(lateness_ns * self.time_scale) // self.period_ns)
        return int(lateness_ns * self.time_scale)

    def clock_statistics(self) -> dict[str, str]:
        """Return how often and how long the shared clock has paused, see ``TickClock``."""
        return {
            "clock_pauses": str(self.pause_count),
            "clock_paused_ms": f"{self.paused_ns / 1e6:.1f}",
        }

    def convert_to_run_time(self, monotonic_ns: int) -> int:
        """Convert a CLOCK_MONOTONIC time stamp to the time of the run [ns].

        The result is right only for time stamps after the second latest pause.
        """
        end_ns, pause_ns = self._last_pause_ns
        paused_before_ns = self._numbers[PAUSED_INDEX] - min(
            max(end_ns - monotonic_ns, 0), pause_ns
        )
        return int((monotonic_ns - paused_before_ns - self.start_ns) * self.time_scale)

    def _read_clock_ns(self) -> int:
        return time.monotonic_ns() - self._numbers[PAUSED_INDEX]

    @property
    def _numbers(self) -> "memoryview[int]":
        return self.file.numbers

    def _move_gate(self, k: int) -> None:
        """Move the gate of the clock, so that the simulator can advance until shortly after the deadline of tick k."""
        self._numbers[GATE_INDEX] = self._deadline_ns(k) + int(
            TOLERATED_LATENESS_FRACTION * self.period_ns / self.time_scale
        )

    def _pause_at_gate(self) -> None:
        """Set a clock that has passed its gate back to the gate, by adding to the sum of the pauses.

        For the simulator, time does not jump back, because the simulator has never used a time
        after the gate.
        """
        self._numbers[PAUSED_INDEX] += max(0, self._read_clock_ns() - self._numbers[GATE_INDEX])

    def _wait_for_simulator(self, deadline_ns: int) -> None:
        """Stop the clock at its gate until the simulator has answered the frames of the previous tick.

        After ``MAX_SIMULATOR_WAIT_NS`` without an answer, the clock continues. The clock waits for
        the simulator again only after the simulator has answered further frames.
        """
        numbers = self._numbers
        if numbers[ANSWERED_INDEX] == self._answer_count_at_timeout:
            return
        wait_end_ns = time.monotonic_ns() + MAX_SIMULATOR_WAIT_NS
        while not self._is_answered(deadline_ns):
            time.sleep(SIMULATOR_POLL_PERIOD_S)
            self._pause_at_gate()
            if time.monotonic_ns() > wait_end_ns:
                self._answer_count_at_timeout = numbers[ANSWERED_INDEX]
                return

    def _is_answered(self, deadline_ns: int) -> bool:
        """Return True if the simulator has answered all frames and is not more than ``MAX_SIMULATOR_LAG_NS`` late."""
        numbers = self._numbers
        max_lag_ns = int(MAX_SIMULATOR_LAG_NS / self.time_scale)
        return bool(
            numbers[ANSWERED_INDEX] >= numbers[SENT_INDEX]
            and numbers[REACHED_INDEX] >= deadline_ns - max_lag_ns
        )

    def _add_pause_to_statistics(self, pause_ns: int) -> None:
        """Add the pause before this tick [ns of wall time] to the totals of the run."""
        if pause_ns:
            self._last_pause_ns = (time.monotonic_ns(), pause_ns)
            self.pause_count += 1
            self.paused_ns += pause_ns
