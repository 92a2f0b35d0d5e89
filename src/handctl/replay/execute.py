"""A log through the controller again: every output byte is compared with the recorded one.

There is no bus here, no clock that decides anything, and no file but the log.
"""

import gc
import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.log.read.reader import RunLog
from handctl.replay.course import Course, Told, Watch, distance
from handctl.replay.difference import Difference
from handctl.replay.parallel import run_parallel


@dataclass(frozen=True, slots=True)
class Execution:
    """What re-execution found.

    Attributes:
        ticks: executed.
        differing: ticks in which any output byte is another.
        undecided: ticks that decide something else: mode, phase, action or events.
        first: the first difference; None if there is none.
        state: the first field of the state that differs at the first snapshot at which one does; None if none does.
        largest: the largest difference of a number, by ``distance``; None if there is none.
        wall_s: time that it took, without designing the gains [s].
        cpu_s: of it, the time of its processes [s]: what it would take on one core with nothing else to do.
        logged_s: time that the run took [s].
    """

    ticks: int
    differing: int
    undecided: int
    first: Difference | None
    state: Difference | None
    largest: Difference | None
    wall_s: float
    cpu_s: float
    logged_s: float

    @property
    def times_real_time(self) -> float:
        """Speed of the re-execution over that of the run."""
        return self.logged_s / self.wall_s if self.wall_s else math.inf


def acceptable(execution: Execution, within: float) -> bool:
    """Whether all decisions are equal and no number differs by more than ``within``: other machines round otherwise."""
    largest = distance(execution.largest) if execution.largest else 0.0
    return not execution.undecided and largest <= within


def execute(
    log: RunLog,
    gains: Gains | None = None,
    watch: Watch | None = None,
    told: Told | None = None,
    workers: int = 1,
) -> Execution:
    """Run the controller of a log on the log's inputs.

    Args:
        log: a run.
        gains: other gains than it ran with.
        watch: called with every tick.
        told: called now and then with the number of ticks so far.
        workers: processes; more than one only without other gains and without ``watch``. What is found is the same.

    Raises:
        LogError: it cannot be rebuilt, or the log is damaged.
    """
    course = Course.of(log, gains)
    began, cpu_began, done = time.perf_counter(), _cpu_seconds(), 0

    def more(ticks: int) -> None:
        nonlocal done
        done += ticks
        if told:
            told(done)

    with undisturbed():
        if workers > 1 and not gains and not watch:
            tally = run_parallel(course, workers, told or _untold)
        else:
            _, tally = course.run(0, len(log), course.controller.initial(), watch, more)
    wall, cpu = time.perf_counter() - began, _cpu_seconds() - cpu_began
    length = float(log.times[-1]) if len(log) else 0.0
    parts = (tally.ticks, tally.differing, tally.undecided, tally.first, tally.state, tally.largest)
    return Execution(*parts, wall, cpu, length)


def _untold(ticks: int) -> None:
    """Tell nobody."""


def _cpu_seconds() -> float:
    """Return the time that this process and those it waited for computed [s]."""
    return sum(os.times()[:4])


@contextmanager
def undisturbed() -> Iterator[None]:
    """No garbage collection, as in the loop, since a tick makes no cycles; numbers of a bad log overflow in silence."""
    gc.disable()
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        gc.enable()
