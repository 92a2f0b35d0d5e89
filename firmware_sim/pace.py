"""The pace of the plant: reports of a plant behind its clock, and the pace that this machine can keep."""

import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

REPORT_PERIOD_S = 1.0
"""Minimum time between two reports [s]."""
SLOW_MACHINE_SLIPS = 3
"""Smallest number of slips in one report period that indicates a slow machine.

Fewer slips are a short stop.
"""
CORE_FRACTION = 0.5
"""Fraction of a core for the simulator. Controller, recorder and system need the rest."""
ADVISED_FRACTION = 0.8
"""Advised pace as a fraction of the measured pace."""


@dataclass(frozen=True, slots=True)
class ClockReadings:
    """Clock readings at one time.

    Attributes:
        wall_s: wall clock [s].
        cpu_s: computing time of this process [s].
        plant_s: time of the plant [s].
    """

    wall_s: float
    cpu_s: float
    plant_s: float


class Pace:
    """Counter of slips that measures and reports the pace.

    Attributes:
        advice: plant time per wall time that this machine can keep, None until the machine proves
            too slow.
    """

    def __init__(
        self,
        plant_ns: int,
        wall_s: Callable[[], float] = time.monotonic,
        cpu_s: Callable[[], float] = time.process_time,
        report_line: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True),
        time_scale: float = 1.0,
    ) -> None:
        """Start to measure.

        Args:
            plant_ns: time of the plant [ns].
            wall_s: wall clock [s].
            cpu_s: computing time of this process [s].
            report_line: prints a line.
            time_scale: asked pace, as plant time per wall time.
        """
        self._time_scale = time_scale
        self._wall_s = wall_s
        self._cpu_s = cpu_s
        self._report_line = report_line
        self._mark = self._at(plant_ns)
        self._start = self._mark
        self._reported_s = -math.inf
        self._slips = self._lost_ns = 0
        self.advice: float | None = None

    def restart(self, plant_ns: int) -> None:
        """Restart the measurement when a host appears.

        Args:
            plant_ns: time of the plant [ns].
        """
        self._mark = self._start = self._at(plant_ns)

    def slipped(self, behind_ns: int, plant_ns: int) -> None:
        """Count a slip, and report it unless a report was made within the last second.

        Args:
            behind_ns: time lost by a slip [ns of plant time].
            plant_ns: time of the plant [ns].
        """
        self._slips += 1
        self._lost_ns += behind_ns
        now = self._at(plant_ns)
        if now.wall_s - self._reported_s < REPORT_PERIOD_S:
            return
        if self._slips >= SLOW_MACHINE_SLIPS:
            self._advise(now)
            self._report_line(self._too_slow(now.wall_s - self._mark.wall_s))
        else:
            times = "" if self._slips == 1 else f" {self._slips} times"
            self._report_line(f"firmware_sim: {self._lost_ns / 1e6:.0f} ms behind, clock slipped{times}")
        self._reported_s = now.wall_s
        self._mark = now
        self._slips = self._lost_ns = 0

    def report(self, plant_ns: int) -> dict[str, float | None]:
        """Return the asked and the advised pace, and the plant time per computing time since the start."""
        capacity = _ratio(self._start, self._at(plant_ns))
        return {
            "time_scale": self._time_scale,
            "advice": self.advice,
            "plant_s_per_cpu_s": capacity if math.isfinite(capacity) else None,
        }

    def _too_slow(self, seconds: float) -> str:
        """Return the line for a machine that is too slow."""
        lost = f"clock slipped {self._slips} times in {seconds:.1f} s, {self._lost_ns / 1e6:.0f} ms given up"
        return f"firmware_sim: {lost}: this machine is fast enough for --time-scale {self.advice:g}"

    def _advise(self, now: ClockReadings) -> None:
        """Update the advice from the pace since the last report."""
        measured = (now.plant_s - self._mark.plant_s) / (now.wall_s - self._mark.wall_s)
        advice = ADVISED_FRACTION * min(
            measured, CORE_FRACTION * _ratio(self._mark, now) * (1 if len(_cores()) == 1 else 2)
        )
        self.advice = rounded_down(advice) if self.advice is None else min(self.advice, rounded_down(advice))

    def _at(self, plant_ns: int) -> ClockReadings:
        return ClockReadings(self._wall_s(), self._cpu_s(), plant_ns * 1e-9)


def rounded_down(pace: float) -> float:
    """Round a pace down to one significant digit, and up to the minimum of ``--time-scale``."""
    if pace <= 0.001:
        return 0.001
    # The tolerance of 1e-9 keeps 0.3 from becoming 0.2 by rounding of the quotient.
    step = 10.0 ** math.floor(math.log10(pace))
    return float(f"{math.floor(pace / step + 1e-9) * step:.6g}")


def _ratio(first: ClockReadings, last: ClockReadings) -> float:
    """Return the plant time per computing time, infinite without computing time."""
    cpu_s = last.cpu_s - first.cpu_s
    return (last.plant_s - first.plant_s) / cpu_s if cpu_s > 0.0 else math.inf


def _cores() -> set[int]:
    """Return the cores that this process may use."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else {0, 1}
