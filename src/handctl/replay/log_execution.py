"""Re-execution of a log.

The controller is executed again on the inputs in the log, and each byte of the new output is
compared with the log.

A re-execution uses no bus, and reads no file except the log. No decision of the controller depends
on a clock.
"""

import gc
import math
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np

from handctl.core.gains.gains import Gains
from handctl.log.read.reader import RunLog
from handctl.replay.log_runner import (
    LogRunner,
    ProgressCallback,
    TickObserver,
    count_progress,
    relative_error,
)
from handctl.replay.parallel_execution import run_parallel
from handctl.replay.tick_difference import TickDifference


@dataclass(frozen=True, slots=True)
class LogExecution:
    """Result of a re-execution.

    Attributes:
        ticks: number of executed ticks.
        differing_ticks: number of ticks in which at least one byte of the output differs from the
            log.
        different_decisions: number of ticks in which a decision differs from the log: mode, phase,
            reaction, events, or which frames are sent.
        first_difference: first difference from the logged output, or None if there is no
            difference.
        first_state_difference: first field of the controller's state that differs from a snapshot
            in the log, or None if all snapshots are equal.
        largest_difference: the largest difference of a number, measured by `relative_error`. The
            value is None if there is no difference.
        wall_s: time until the result of the re-execution existed, without the time for the design of
            the gains [s].
        cpu_s: processor time of all processes together [s]. A single core without other work would
            need this processor time for the whole re-execution.
        logged_duration_s: duration of the executed part of the run [s].
        start_time_s: time of the first executed tick [s of the run].
        compares_states: True if the states were compared, see `LogRunner`.
    """

    ticks: int
    differing_ticks: int
    different_decisions: int
    first_difference: TickDifference | None
    first_state_difference: TickDifference | None
    largest_difference: TickDifference | None
    wall_s: float
    cpu_s: float
    logged_duration_s: float
    start_time_s: float
    compares_states: bool

    @property
    def real_time_factor(self) -> float:
        """Return the duration of the recorded run divided by the time of the re-execution."""
        return self.logged_duration_s / self.wall_s if self.wall_s else math.inf


def is_within_tolerance(execution: LogExecution, tolerance: float) -> bool:
    """Return True if a new execution of a run agrees with the log.

    All decisions of the new execution must equal the decisions in the log. No number is allowed to
    differ from the log by more than `tolerance`. A tolerance is useful because another kind of
    processor can round numbers differently.
    """
    largest = relative_error(execution.largest_difference) if execution.largest_difference else 0.0
    return not execution.different_decisions and largest <= tolerance


def execute_log(
    log: RunLog,
    gains: Gains | None = None,
    observer: TickObserver | None = None,
    progress: ProgressCallback | None = None,
    worker_count: int = 1,
    from_s: float = -math.inf,
    until_s: float = math.inf,
) -> LogExecution:
    """Execute the controller of a recorded run again, on the inputs in the log.

    Args:
        log: log of the run.
        gains: gains to use instead of the gains in the log.
        observer: function called with the input and the output of every tick.
        progress: function called at intervals with the number of ticks executed so far.
        worker_count: number of processes. With other gains or with an observer, the log is executed in a
            single process. The result does not depend on the number of processes.
        from_s: time from which the run is executed again [s]. The re-execution begins at the last
            snapshot before this time. With other gains, the re-execution begins at the start of the
            run, because the log contains no states of the controller with other gains.
        until_s: time before which the re-execution ends [s].

    Raises:
        LogError: the controller cannot be rebuilt from the log, or the log is damaged.
    """
    runner = LogRunner.from_log(log, gains)
    part = runner.part_of_time_range(from_s, until_s)
    start = time.perf_counter()
    cpu_start = _cpu_seconds()
    with gc_disabled(), ExitStack() as stack:
        if worker_count > 1 and not gains and not observer:
            difference_tally = run_parallel(
                runner, part, worker_count, progress or _ignore_progress, stack
            )
        else:
            _, difference_tally = runner.execute_log_part(
                *part, observer, count_progress(progress) if progress else None
            )
        wall_time_s = time.perf_counter() - start
    cpu_time_s = _cpu_seconds() - cpu_start
    times = log.times[part.start : part.stop]
    start_time_s = float(times[0]) if len(times) else 0.0
    duration_s = float(times[-1]) - start_time_s if len(times) else 0.0
    tally_fields = (
        difference_tally.ticks,
        difference_tally.differing_ticks,
        difference_tally.different_decisions,
        difference_tally.first_difference,
        difference_tally.first_state_difference,
        difference_tally.largest_difference,
    )
    return LogExecution(
        *tally_fields,
        wall_time_s,
        cpu_time_s,
        duration_s,
        start_time_s,
        runner.compares_states,
    )


def _ignore_progress(ticks: int) -> None:
    """Ignore a report of progress."""


def _cpu_seconds() -> float:
    """Return the processor time of the calling process and of finished child processes [s]."""
    return sum(os.times()[:4])


@contextmanager
def gc_disabled() -> Iterator[None]:
    """Disable garbage collection, as the control loop does.

    The context also disables numpy's warnings about invalid numbers, because a log can contain
    invalid numbers. No garbage accumulates, because a tick creates no reference cycles.
    """
    gc.disable()
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        gc.enable()
