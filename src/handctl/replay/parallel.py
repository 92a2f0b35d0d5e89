"""Re-execution of a log in several processes. Each process starts from a snapshot in the log.

Each part starts from a state whose hash is in the log. If the previous part ends with the same
hash, a serial run would reach the same state, and the results of the parts can be added. If the
hashes differ, the rest of the log is executed serially. The result is therefore always equal to the
result of a serial run.
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

from handctl.controller.snapshot import restore_state, snapshot_bytes
from handctl.controller.state import State
from handctl.errors import LogError
from handctl.processes import run_in_copy
from handctl.replay.log_runner import LogRunner, Tally
from handctl.replay.tick_difference import TickDifference

MIN_TICKS = 200
"""Smallest number of ticks per process."""
PROGRESS_S = 0.2
"""Interval between reports of progress while waiting [s]."""


class LogPart(NamedTuple):
    """Part of a log: ticks `start` to `stop`, and the state before the first tick."""

    start: int
    stop: int
    state: State


class WorkerProcess(NamedTuple):
    """Worker process, with its part and the read end of its pipe."""

    process: int
    pipe: int
    part: LogPart


class ProgressCounts:
    """Number of executed ticks of each process, in shared memory."""

    def __init__(self, processes: int, progress: Callable[[int], None]) -> None:
        """Allocate the shared memory.

        Args:
            processes: number of processes.
            progress: function called with the number of executed ticks.
        """
        # An anonymous mapping is shared with forked processes.
        self._done: NDArray[np.int64] = np.frombuffer(mmap.mmap(-1, 8 * processes), np.int64)
        self._progress = progress

    def of(self, process: int) -> Callable[[int], None]:
        """Return a function that counts further ticks of a process.

        In the first process, which is the present process, the function also reports progress.
        """

        def count(ticks: int) -> None:
            self._done[process] += ticks
            if process == 0:
                self.report()

        return count

    def report(self) -> None:
        """Report the number of executed ticks."""
        self._progress(int(self._done.sum()))


def run_parallel(runner: LogRunner, workers: int, progress: Callable[[int], None]) -> Tally:
    """Execute a whole log in several processes. Raises the errors of `LogRunner.run`.

    Args:
        runner: the log and its controller.
        workers: largest number of processes.
        progress: function called at intervals with the number of ticks so far.
    """
    parts = split_log(runner, workers)
    counts = ProgressCounts(len(parts), progress)
    running = [_start_worker(runner, part, counts.of(i)) for i, part in enumerate(parts) if i]
    try:
        state, total = runner.run(parts[0].start, parts[0].stop, parts[0].state, None, counts.of(0))
        for worker in running:
            # Equal hashes: the part started from the state that a serial run has here.
            result = _wait_for_result(runner, worker, counts) if state.digest() == worker.part.state.digest() else None
            if result is None:
                _, remainder = runner.run(worker.part.start, len(runner.log), state, None, counts.of(0))
                return total.merged_with(remainder)
            state, tally = result
            total = total.merged_with(tally)
        return total
    finally:
        for worker in running:
            _kill_worker(worker)


def split_log(runner: LogRunner, workers: int) -> list[LogPart]:
    """Return consecutive parts of a log, of about equal length.

    Each part begins at the start of the log or after a snapshot.
    """
    ticks = len(runner.log)
    k = runner.log.k
    snapshot_ticks = np.array(sorted(runner.snapshots), np.int64)
    at = np.searchsorted(k, snapshot_ticks)
    usable = [
        int(index) + 1 for index, tick in zip(at, snapshot_ticks, strict=True) if index < ticks and k[index] == tick
    ]
    count = min(workers, max(ticks // MIN_TICKS, 1), len(usable) + 1)
    nearest = [min(usable, key=lambda start: abs(start - ticks * i / count)) for i in range(1, count)]
    starts = {0: runner.controller.initial()}
    for start in nearest:
        state = _state_after(runner, start - 1)
        if state is not None:
            starts[start] = state
    ends = [*sorted(starts), ticks]
    return [LogPart(start, stop, starts[start]) for start, stop in pairwise(ends)]


def _state_after(runner: LogRunner, index: int) -> State | None:
    """Return the state logged after a tick.

    Returns:
        None if this version cannot read the state, or its hash differs from the logged hash.
    """
    try:
        state = restore_state(runner.controller.layout, runner.snapshots[int(runner.log.k[index])])
    except ValueError:
        return None
    return state if state.digest() == runner.log.state_hash[index].tobytes() else None


def _start_worker(runner: LogRunner, part: LogPart, count: Callable[[int], None]) -> WorkerProcess:
    """Execute a part in a forked copy of this process."""
    return WorkerProcess(*run_in_copy(lambda: _result_json(runner, part, count)), part)


def _result_json(runner: LogRunner, part: LogPart, count: Callable[[int], None]) -> str:
    """Execute a part and return the result as JSON. A damaged log gives an empty text.

    The calling process then executes the part, finds the damage, and reports the error.
    """
    try:
        state, tally = runner.run(*part, None, count)
    except LogError:
        return ""
    return json.dumps({"state": snapshot_bytes(state).hex(), "tally": astuple(tally)})


def _wait_for_result(runner: LogRunner, worker: WorkerProcess, counts: ProgressCounts) -> tuple[State, Tally] | None:
    """Wait for a process, and return its tally and the state after its part.

    Returns:
        None if the process did not finish its part.
    """
    data = b""
    while True:
        if select.select([worker.pipe], [], [], PROGRESS_S)[0]:
            more = os.read(worker.pipe, 1 << 20)
            if not more:
                break
            data += more
        counts.report()
    if not data:
        return None
    result: dict[str, Any] = json.loads(data)
    *numbers, first, state, largest = result["tally"]
    tally = Tally(
        *numbers,
        *(TickDifference(*worker) if worker else None for worker in (first, state, largest)),
    )
    return restore_state(runner.controller.layout, bytes.fromhex(result["state"])), tally


def _kill_worker(worker: WorkerProcess) -> None:
    """Kill a worker process and wait until it has ended."""
    os.close(worker.pipe)
    os.kill(worker.process, signal.SIGKILL)
    os.waitpid(worker.process, 0)
