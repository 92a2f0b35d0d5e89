"""How fast the plant follows its clock: what to say when it does not, and which pace this machine would keep."""

import math
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

SAY_S = 1.0
"""At most one line in this time [s]."""
SEVERAL = 3
"""So many slips in that time are a machine that is too slow; fewer are a moment in which it stood still."""
CORE_FRACTION = 0.5
"""Fraction of a core that the simulator may take: the controller, the recorder and the system need the rest."""
MARGIN = 0.8
"""Advised pace as a fraction of the one that was kept."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A moment.

    Attributes:
        wall_s: of the wall clock [s]. cpu_s: that this process has computed [s]. plant_s: of the plant [s].
    """

    wall_s: float
    cpu_s: float
    plant_s: float


class Pace:
    """Counts slips, tells them, and measures the pace.

    Attributes:
        advice: plant time per wall time that this machine keeps; None until it is known to be too slow.
    """

    def __init__(
        self,
        plant_ns: int,
        wall_s: Callable[[], float] = time.monotonic,
        cpu_s: Callable[[], float] = time.process_time,
        say: Callable[[str], None] = lambda line: print(line, file=sys.stderr, flush=True),
    ) -> None:
        """Args: time of the plant [ns]; the wall clock [s], computing time [s], and where lines go."""
        self._wall_s, self._cpu_s, self._say = wall_s, cpu_s, say
        self._mark = self._at(plant_ns)
        self._start = self._mark
        self._told_s = -math.inf
        self._slips = self._lost_ns = 0
        self.advice: float | None = None

    def begin(self, plant_ns: int) -> None:
        """Measure from now on, at a time of the plant [ns]: a host is there."""
        self._mark = self._start = self._at(plant_ns)

    def slipped(self, behind_ns: int, plant_ns: int) -> None:
        """Note that the plant has given up time, and say so if nothing was said in the last second.

        Args:
            behind_ns: time that was given up [ns of plant time].
            plant_ns: time of the plant [ns].
        """
        self._slips += 1
        self._lost_ns += behind_ns
        now = self._at(plant_ns)
        if now.wall_s - self._told_s < SAY_S:
            return
        if self._slips >= SEVERAL:
            self._advise(now)
            self._say(self._too_slow(now.wall_s - self._mark.wall_s))
        else:
            times = "" if self._slips == 1 else f" {self._slips} times"
            self._say(f"firmware_sim: {self._lost_ns / 1e6:.0f} ms behind, clock slipped{times}")
        self._told_s, self._mark = now.wall_s, now
        self._slips = self._lost_ns = 0

    def told(self, plant_ns: int) -> dict[str, float | None]:
        """Return the advised pace, and plant time per computing time of this process since its start."""
        capacity = _ratio(self._start, self._at(plant_ns))
        return {"advice": self.advice, "plant_s_per_cpu_s": capacity if math.isfinite(capacity) else None}

    def _too_slow(self, seconds: float) -> str:
        lost = f"clock slipped {self._slips} times in {seconds:.1f} s, {self._lost_ns / 1e6:.0f} ms given up"
        return f"firmware_sim: {lost}: this machine keeps --time-scale {self.advice:g}, on both sides of the bus"

    def _advise(self, now: Mark) -> None:
        """Measure what was kept since the last line, and what the share of a core would keep."""
        kept = (now.plant_s - self._mark.plant_s) / (now.wall_s - self._mark.wall_s)
        found = MARGIN * min(kept, CORE_FRACTION * _ratio(self._mark, now) * (1 if len(_cores()) == 1 else 2))
        self.advice = rounded_down(found) if self.advice is None else min(self.advice, rounded_down(found))

    def _at(self, plant_ns: int) -> Mark:
        return Mark(self._wall_s(), self._cpu_s(), plant_ns * 1e-9)


def rounded_down(pace: float) -> float:
    """Return a pace with one significant digit, not above it, and not below what ``--time-scale`` takes."""
    if pace <= 0.001:
        return 0.001
    step = 10.0 ** math.floor(math.log10(pace))
    return float(f"{math.floor(pace / step + 1e-9) * step:.6g}")


def _ratio(first: Mark, last: Mark) -> float:
    """Return plant time per computing time; infinite if nothing was computed."""
    cpu_s = last.cpu_s - first.cpu_s
    return (last.plant_s - first.plant_s) / cpu_s if cpu_s > 0.0 else math.inf


def _cores() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else {0, 1}
