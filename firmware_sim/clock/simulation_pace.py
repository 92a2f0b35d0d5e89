"""The pace of the simulation (plant time per wall time): reports of delays, and the pace that the machine can keep."""

import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

REPORT_PERIOD_S = 1.0
"""Minimum time between two reports of slips [s]."""
SLOW_MACHINE_SLIP_COUNT = 3
"""Number of clock slips in a report period that shows that a machine is too slow.

With fewer clock slips, the operating system has only stopped the process for a moment.
"""
SIMULATOR_CORE_FRACTION = 0.5
"""Fraction of a processor core for the simulator.

The controller, the recorder and the operating system need the rest of the core.
"""
ADVISED_PACE_FRACTION = 0.8
"""Ratio of the advised pace to the pace that the machine can keep."""


@dataclass(frozen=True, slots=True)
class ClockReadings:
    """Readings of three clocks, taken at the same time.

    Attributes:
        wall_s: time of the wall clock [s].
        cpu_s: computing time of the process of the simulator [s].
        plant_s: simulated time of the plant [s].
    """

    wall_s: float
    cpu_s: float
    plant_s: float


class PaceMeter:
    """Meter of the pace of a simulation, which is the simulated time of the plant per wall time.

    The meter also counts and reports the slips of the clock. If the plant is too far behind the
    clock, the clock slips, which means that the plant skips the lost time.

    Attributes:
        advice: highest pace advised for this machine, as the ratio of plant time to wall time. The
            advice is None until the machine has proved too slow for the requested pace.
    """

    def __init__(
        self,
        plant_ns: int,
        wall_s: Callable[[], float] = time.monotonic,
        cpu_s: Callable[[], float] = time.process_time,
        print_line: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True),
        time_scale: float = 1.0,
    ) -> None:
        """Start to measure the pace.

        Args:
            plant_ns: present time of the plant [ns].
            wall_s: function that returns the time of the wall clock [s].
            cpu_s: function that returns the computing time of the simulator's process [s].
            print_line: function that prints a line.
            time_scale: requested pace, as the ratio of plant time to wall time.
        """
        self._time_scale = time_scale
        self._wall_s = wall_s
        self._cpu_s = cpu_s
        self._print_line = print_line
        self._last_report = self._read_clocks(plant_ns)
        self._start = self._last_report
        self._reported_s = -math.inf
        self._slips = self._lost_ns = 0
        self.advice: float | None = None

    def restart(self, plant_ns: int) -> None:
        """Restart the measurement of the pace, because a host has sent its first frame.

        Args:
            plant_ns: present time of the plant [ns].
        """
        self._last_report = self._start = self._read_clocks(plant_ns)

    def count_slip(self, behind_ns: int, plant_ns: int) -> None:
        """Count a slip of the clock, which means that the plant skips the time by which it is behind the clock.

        The plant does not advance by the skipped time. If the last report is at least
        ``REPORT_PERIOD_S`` old, the method reports all clock slips since that report.

        Args:
            behind_ns: plant time that was lost by the slip [ns].
            plant_ns: present time of the plant [ns].
        """
        self._slips += 1
        self._lost_ns += behind_ns
        present_readings = self._read_clocks(plant_ns)
        if present_readings.wall_s - self._reported_s < REPORT_PERIOD_S:
            return
        if self._slips >= SLOW_MACHINE_SLIP_COUNT:
            self._update_advised_pace(present_readings)
            self._print_line(
                self._slow_machine_text(present_readings.wall_s - self._last_report.wall_s)
            )
        else:
            times = "" if self._slips == 1 else f" {self._slips} times"
            self._print_line(
                f"firmware_sim: {self._lost_ns / 1e6:.0f} ms behind, clock slipped{times}"
            )
        self._reported_s = present_readings.wall_s
        self._last_report = present_readings
        self._slips = self._lost_ns = 0

    def report(self, plant_ns: int) -> dict[str, float | None]:
        """Return the requested pace, the advised pace, and the ratio of plant time to computing time."""
        max_pace = _pace_ratio(self._start, self._read_clocks(plant_ns))
        return {
            "time_scale": self._time_scale,
            "advice": self.advice,
            "plant_s_per_cpu_s": max_pace if math.isfinite(max_pace) else None,
        }

    def _slow_machine_text(self, seconds: float) -> str:
        """Return the message that tells the user that the machine is too slow."""
        slip_text = f"clock slipped {self._slips} times in {seconds:.1f} s, {self._lost_ns / 1e6:.0f} ms given up"
        return f"firmware_sim: {slip_text}: this machine is fast enough for --time-scale {self.advice:g}"

    def _update_advised_pace(self, present_readings: ClockReadings) -> None:
        """Update the advised pace from the ratio of plant time to wall time since the last report."""
        measured_pace = (present_readings.plant_s - self._last_report.plant_s) / (
            present_readings.wall_s - self._last_report.wall_s
        )
        advised_pace = ADVISED_PACE_FRACTION * min(
            measured_pace,
            SIMULATOR_CORE_FRACTION
            * _pace_ratio(self._last_report, present_readings)
            * (1 if len(_usable_cores()) == 1 else 2),
        )
        self.advice = (
            round_pace_down(advised_pace)
            if self.advice is None
            else min(self.advice, round_pace_down(advised_pace))
        )

    def _read_clocks(self, plant_ns: int) -> ClockReadings:
        return ClockReadings(self._wall_s(), self._cpu_s(), plant_ns * 1e-9)


def round_pace_down(pace: float) -> float:
    """Round a pace down to one significant digit, but not below the minimum of ``--time-scale``."""
    if pace <= 0.001:
        return 0.001
    # Without the tolerance of 1e-9, rounding errors would turn 0.3 into 0.2.
    step = 10.0 ** math.floor(math.log10(pace))
    return float(f"{math.floor(pace / step + 1e-9) * step:.6g}")


def _pace_ratio(start: ClockReadings, end: ClockReadings) -> float:
    """Return the ratio of plant time to processor time between two readings.

    If no processor time has passed, the ratio is infinite.
    """
    cpu_s = end.cpu_s - start.cpu_s
    return (end.plant_s - start.plant_s) / cpu_s if cpu_s > 0.0 else math.inf


def _usable_cores() -> set[int]:
    """Return the processor cores on which this process is allowed to run."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else {0, 1}
