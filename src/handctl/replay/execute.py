"""Re-execution of a log: the controller runs on the logged inputs, and every output byte is compared.

No bus is used, no clock influences a decision, and no file but the log is read.
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
from handctl.replay.log_runner import LogRunner, ProgressCallback, TickObserver, relative_error
from handctl.replay.parallel import run_parallel
from handctl.replay.tick_difference import TickDifference


@dataclass(frozen=True, slots=True)
class Execution:
    """Result of a re-execution.

    Attributes:
        ticks: number of executed ticks.
        differing: number of ticks with any different output byte.
        different_decisions: number of ticks with a different decision: mode, phase, action or
            events.
        first: the first difference, or None.
        state: first different field in the first different snapshot, or None.
        largest: the largest numeric difference by `relative_error`, or None.
        wall_s: elapsed time, excluding the design of the gains [s].
        cpu_s: processor time of all processes [s], equal to the time on one idle core.
        logged_s: duration of the run [s].
    """

    ticks: int
    differing: int
    different_decisions: int
    first: TickDifference | None
    state: TickDifference | None
    largest: TickDifference | None
    wall_s: float
    cpu_s: float
    logged_s: float

    @property
    def times_real_time(self) -> float:
        """Return the speed of the re-execution relative to real time."""
        return self.logged_s / self.wall_s if self.wall_s else math.inf


def is_within_tolerance(execution: Execution, within: float) -> bool:
    """Return True if all decisions are equal and no number differs by more than `within`.

    A tolerance is useful because other machines may round differently.
    """
    largest = relative_error(execution.largest) if execution.largest else 0.0
    return not execution.different_decisions and largest <= within


def execute_log(
    log: RunLog,
    gains: Gains | None = None,
    observer: TickObserver | None = None,
    progress: ProgressCallback | None = None,
    workers: int = 1,
) -> Execution:
    """Execute the controller of a log on the log's inputs.

    Args:
        log: a run.
        gains: gains to use instead of the gains of the run.
        observer: function called with every tick.
        progress: function called at intervals with the number of ticks so far.
        workers: number of processes. Several are used only without other gains and without
            `observer`. The result does not depend on this number.

    Raises:
        LogError: the controller cannot be rebuilt, or the log is damaged.
    """
    runner = LogRunner.of(log, gains)
    start = time.perf_counter()
    cpu_start = _cpu_seconds()
    done = 0

    def more(ticks: int) -> None:
        nonlocal done
        done += ticks
        if progress:
            progress(done)

    with gc_disabled():
        if workers > 1 and not gains and not observer:
            tally = run_parallel(runner, workers, progress or _ignore_progress)
        else:
            _, tally = runner.run(0, len(log), runner.controller.initial(), observer, more)
    wall = time.perf_counter() - start
    cpu = _cpu_seconds() - cpu_start
    length = float(log.times[-1]) if len(log) else 0.0
    parts = (tally.ticks, tally.differing, tally.different_decisions, tally.first, tally.state, tally.largest)
    return Execution(*parts, wall, cpu, length)


def _ignore_progress(ticks: int) -> None:
    """Ignore a report of progress."""


def _cpu_seconds() -> float:
    """Return the processor time of this process and of its finished children [s]."""
    return sum(os.times()[:4])


@contextmanager
def gc_disabled() -> Iterator[None]:
    """Disable garbage collection, as in the loop, and overflow warnings from numbers in a bad log.

    Ticks create no reference cycles, so no garbage accumulates.
    """
    gc.disable()
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        gc.enable()
