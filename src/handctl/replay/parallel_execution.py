"""Re-execution of a log in several processes. Each process starts from a snapshot in the log.

The log is divided into consecutive parts, and each process executes one part. The process of a part
starts from a snapshot of the controller's state in the log. At each border between two parts, the
hash of this snapshot is compared with the hash of the state at the end of the earlier part. If the
hashes at a border are equal, a serial execution would reach the same state, and the results of both
parts are combined. If the hashes at a border differ, one process executes the log serially from
this border on. The result of a parallel execution is always equal to the result of a serial
execution.
"""

import json
import mmap
import os
import select
import signal
from collections.abc import Callable
from dataclasses import astuple
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.controller.controller_state import ControllerState
from handctl.controller.state_snapshot import restore_state, snapshot_bytes
from handctl.errors import LogError
from handctl.processes import run_in_forked_copy
from handctl.replay.log_runner import DifferenceTally, LogPart, LogRunner
from handctl.replay.tick_difference import TickDifference

MIN_TICKS_PER_PROCESS = 200
"""Smallest number of ticks for which a further process is started."""
PROGRESS_PERIOD_S = 0.2
"""Interval between reports of progress while the first process waits for the other processes [s]."""


class WorkerProcess(NamedTuple):
    """Worker process with its part of the log.

    The worker writes the result to a pipe. The attribute `pipe` is the file descriptor of the read
    end.
    """

    process: int
    pipe: int
    part: LogPart


class ProgressCounts:
    """Counts of the executed ticks, one count per process, in memory that all processes share."""

    def __init__(self, processes: int, progress: Callable[[int], None]) -> None:
        """Allocate shared memory for one tick count per process.

        Args:
            processes: number of processes.
            progress: function called with the number of ticks that all processes have executed.
        """
        # An anonymous memory mapping is shared with the processes that this process forks.
        self._done: NDArray[np.int64] = np.frombuffer(mmap.mmap(-1, 8 * processes), np.int64)
        self._progress = progress

    def counter_of_process(self, process_index: int) -> Callable[[int], None]:
        """Return a function that counts the executed ticks of a process.

        For process 0, which is the calling process, the returned function also reports the progress
        of all processes.
        """

        def add_executed_ticks(ticks: int) -> None:
            self._done[process_index] += ticks
            if process_index == 0:
                self.report_total()

        return add_executed_ticks

    def report_total(self) -> None:
        """Report how many ticks all processes together have executed."""
        self._progress(int(self._done.sum()))


def run_parallel(
    runner: LogRunner, whole: LogPart, worker_count: int, progress: Callable[[int], None]
) -> DifferenceTally:
    """Execute a part of a log in several processes.

    The function raises the errors of `LogRunner.execute_log_part`.

    Args:
        runner: log and controller to execute.
        whole: part of the log to execute.
        worker_count: largest number of processes.
        progress: function called at intervals with the number of ticks executed so far.
    """
    log_parts = split_log(runner, whole, worker_count)
    counts = ProgressCounts(len(log_parts), progress)
    workers = [
        _start_worker(runner, log_part, counts.counter_of_process(i))
        for i, log_part in enumerate(log_parts)
        if i
    ]
    try:
        state, total = runner.execute_log_part(
            log_parts[0].start,
            log_parts[0].stop,
            log_parts[0].state,
            None,
            counts.counter_of_process(0),
        )
        for worker in workers:
            # If the hashes are equal, the worker process started from the state that a serial
            # execution has at this tick.
            result = (
                _wait_for_result(runner, worker, counts)
                if state.digest() == worker.part.state.digest()
                else None
            )
            if result is None:
                _, remainder = runner.execute_log_part(
                    worker.part.start, whole.stop, state, None, counts.counter_of_process(0)
                )
                return total.merged_with_later_tally(remainder)
            state, difference_tally = result
            total = total.merged_with_later_tally(difference_tally)
        return total
    finally:
        for worker in workers:
            _kill_worker(worker)


def split_log(runner: LogRunner, whole: LogPart, worker_count: int) -> list[LogPart]:
    """Divide a part of a log into consecutive parts of about equal length, and return them.

    Each of these parts begins at the first tick of `whole` or just after a snapshot.
    """
    tick_count = whole.stop - whole.start
    possible_starts = [
        start for start in runner.starts_after_snapshots() if whole.start < start < whole.stop
    ]
    count = min(worker_count, max(tick_count // MIN_TICKS_PER_PROCESS, 1), len(possible_starts) + 1)
    state_by_start = {whole.start: whole.state}
    for i in range(1, count):
        ideal_start = whole.start + tick_count * i / count
        start = min(possible_starts, key=lambda start: abs(start - ideal_start))
        state = runner.state_before_tick(start)
        if state is not None:
            state_by_start[start] = state
    borders = [*sorted(state_by_start), whole.stop]
    return [LogPart(start, stop, state_by_start[start]) for start, stop in pairwise(borders)]


def _start_worker(
    runner: LogRunner, log_part: LogPart, add_executed_ticks: Callable[[int], None]
) -> WorkerProcess:
    """Fork this process, and execute a part of the log in the child process."""
    return WorkerProcess(
        *run_in_forked_copy(lambda: _result_json(runner, log_part, add_executed_ticks)), log_part
    )


def _result_json(
    runner: LogRunner, log_part: LogPart, add_executed_ticks: Callable[[int], None]
) -> str:
    """Execute a part of a log, and return the result as JSON. If the log is damaged, the returned text is empty.

    After an empty text, the calling process executes the same part of the log itself, finds the
    damage and reports the error.
    """
    try:
        state, difference_tally = runner.execute_log_part(*log_part, None, add_executed_ticks)
    except LogError:
        return ""
    return json.dumps({"state": snapshot_bytes(state).hex(), "tally": astuple(difference_tally)})


def _wait_for_result(
    runner: LogRunner, worker: WorkerProcess, counts: ProgressCounts
) -> tuple[ControllerState, DifferenceTally] | None:
    """Wait for a worker process that executes a part of the log, and return its result.

    Returns:
        the controller's state at the end of the part, and the tally of differences in the part.
        None if the process did not finish its part.
    """
    data = b""
    while True:
        if select.select([worker.pipe], [], [], PROGRESS_PERIOD_S)[0]:
            received_bytes = os.read(worker.pipe, 1 << 20)
            if not received_bytes:
                break
            data += received_bytes
        counts.report_total()
    if not data:
        return None
    result: dict[str, Any] = json.loads(data)
    *numbers, first_difference, state, largest = result["tally"]
    difference_tally = DifferenceTally(
        *numbers,
        *(
            TickDifference(*worker) if worker else None
            for worker in (first_difference, state, largest)
        ),
    )
    return restore_state(
        runner.controller.derived_constants.layout, bytes.fromhex(result["state"])
    ), difference_tally


def _kill_worker(worker: WorkerProcess) -> None:
    """Kill a worker process, and wait until the process has ended."""
    os.close(worker.pipe)
    os.kill(worker.process, signal.SIGKILL)
    os.waitpid(worker.process, 0)
