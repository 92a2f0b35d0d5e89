"""Re-execution of a log in several processes. Each process starts from a snapshot in the log.

The ticks of the log are distributed among the processes, see `tick_ranges`. A process executes one
or more parts of the log, and each part starts from a snapshot of the controller's state in the log.
At each border between two parts, the hash of this snapshot is compared with the hash of the state
at the end of the earlier part. If the hashes at a border are equal, a serial execution would reach
the same state, and the results of both parts are combined. If the hashes at a border differ, one
process executes the log serially from this border on. The result of a parallel execution is always
equal to the result of a serial execution.
"""

import json
import os
import select
import signal
import tempfile
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import astuple, dataclass
from itertools import islice, pairwise
from typing import Any, NamedTuple

from handctl.controller.controller_state import ControllerState
from handctl.controller.state_snapshot import restore_state, snapshot_bytes
from handctl.errors import LogError
from handctl.processes import run_in_forked_copy
from handctl.replay.log_runner import DifferenceTally, LogPart, LogRunner, count_progress
from handctl.replay.tick_difference import TickDifference
from handctl.replay.tick_ranges import TickRanges

MIN_TICKS_PER_PROCESS = 200
"""Smallest number of ticks for which a further process is started."""
WORKER_COST_TICKS = 250
"""Number of ticks that a process could execute in the time that the start of a worker takes.

The start includes the first write to each page of memory that the worker shares with its parent.
"""
PROGRESS_PERIOD_S = 0.2
"""Interval between reports of progress while the first process waits for the other processes [s]."""


class ExecutedPart(NamedTuple):
    """Part of a log that a process has executed.

    Attributes:
        start: index of the first tick of the part.
        stop: index after the last tick of the part.
        start_hash: hash of the state from which the process started.
        end_state: state of the controller after the last tick of the part.
        tally: differences in the part.
    """

    start: int
    stop: int
    start_hash: bytes
    end_state: ControllerState
    tally: DifferenceTally


class WorkerProcess(NamedTuple):
    """Worker process, and the file descriptor of the pipe from which its result is read."""

    process: int
    pipe: int


def run_parallel(
    runner: LogRunner,
    whole: LogPart,
    worker_count: int,
    progress: Callable[[int], None],
    stack: ExitStack,
) -> DifferenceTally:
    """Execute a part of a log in several processes.

    The function raises the errors of `LogRunner.execute_log_part`.

    Args:
        runner: log and controller to execute.
        whole: part of the log to execute.
        worker_count: largest number of processes.
        progress: function called at intervals with the number of ticks executed so far.
        stack: stack that ends the worker processes. The end of a process takes 4 ms, in which the
            kernel releases the memory. The result exists before the end of the processes.
    """
    segment_starts = [
        start for start in runner.starts_after_snapshots() if whole.start < start < whole.stop
    ]
    first_parts = split_log(runner, whole, worker_count, segment_starts)
    workers: list[WorkerProcess] = []
    with tempfile.TemporaryFile() as lock_file:
        ranges = TickRanges(
            [part.start for part in first_parts], whole.stop, segment_starts, lock_file
        )

        def report_progress() -> None:
            progress(ranges.executed_tick_count)

        for i, first_part in enumerate(first_parts[1:], start=1):
            workers.append(_start_worker(RangeExecution(runner, ranges, i), first_part))
            stack.callback(_kill_worker, workers[-1])
        own_execution = RangeExecution(runner, ranges, 0, report_progress)
        executed_parts = own_execution.execute_ranges(first_parts[0])
        for worker in workers:
            executed_parts += _wait_for_result(runner, worker, report_progress)
    return _combined_tally(runner, whole, executed_parts, progress)


def split_log(
    runner: LogRunner, whole: LogPart, worker_count: int, segment_starts: list[int]
) -> list[LogPart]:
    """Divide a part of a log into consecutive parts, and return them.

    Each of these parts begins at the first tick of `whole` or just after a snapshot, at one of the
    ticks in `segment_starts`. The first part is executed by the calling process, and is longer by
    `WORKER_COST_TICKS`. The other parts have about equal lengths.
    """
    tick_count = whole.stop - whole.start
    count = min(worker_count, max(tick_count // MIN_TICKS_PER_PROCESS, 1), len(segment_starts) + 1)
    ticks_per_worker = max(0, tick_count - WORKER_COST_TICKS) / count
    state_by_start = {whole.start: whole.state}
    for i in range(1, count):
        ideal_start = whole.stop - (count - i) * ticks_per_worker
        start = min(segment_starts, key=lambda start: abs(start - ideal_start))
        state = runner.state_before_tick(start)
        if state is not None:
            state_by_start[start] = state
    borders = [*sorted(state_by_start), whole.stop]
    return [LogPart(start, stop, state_by_start[start]) for start, stop in pairwise(borders)]


@dataclass(frozen=True, slots=True)
class RangeExecution:
    """Execution of ranges of ticks by one process.

    Attributes:
        runner: log and controller to execute.
        ranges: ranges of all processes.
        process_index: index of the process in `ranges`.
        report_progress: function called after every segment, None for workers.
    """

    runner: LogRunner
    ranges: TickRanges
    process_index: int
    report_progress: Callable[[], None] | None = None

    def execute_ranges(self, first_part: LogPart) -> list[ExecutedPart]:
        """Execute the range of the process, and after it ranges that the process takes over.

        If the log is damaged or the controller refuses an input, the execution ends. The range with
        this tick is then missing in the result.

        Args:
            first_part: the first range of the process, with the controller's state at its start.
        """
        executed_parts: list[ExecutedPart] = []
        start: int | None = first_part.start
        state: ControllerState | None = first_part.state
        while start is not None and state is not None:
            try:
                executed_parts.append(self._execute_range(start, state))
            except LogError:
                break
            start = self.ranges.take_over_range(self.process_index)
            state = None if start is None else self.runner.state_before_tick(start)
        return executed_parts

    def _execute_range(self, start: int, state: ControllerState) -> ExecutedPart:
        """Execute one segment after the other until the range of the process is empty.

        The method raises the errors of `LogRunner.execute_log_part`.

        Args:
            start: index of the first tick of the range.
            state: state of the controller before this tick.
        """
        # The chunks of the log are read when their ticks are needed. So the reading ends with the
        # range, even if another process takes over the end of the range.
        logged_ticks = self.runner.logged_ticks(start, len(self.runner.log))
        start_hash = state.digest()
        difference_tally = DifferenceTally()
        stop = start
        while (segment_end := self.ranges.take_segment(self.process_index)) is not None:
            tick_count = segment_end - stop
            state, tally_of_segment = self.runner.execute_ticks(
                islice(logged_ticks, tick_count), state, None, None
            )
            difference_tally = difference_tally.merged_with_later_tally(tally_of_segment)
            stop = segment_end
            self.ranges.add_executed_ticks(self.process_index, tick_count)
            if self.report_progress:
                self.report_progress()
        return ExecutedPart(start, stop, start_hash, state, difference_tally)


def _start_worker(range_execution: RangeExecution, first_part: LogPart) -> WorkerProcess:
    """Fork this process, and execute ranges of ticks in the child process."""
    return WorkerProcess(
        *run_in_forked_copy(lambda: _parts_as_json(range_execution.execute_ranges(first_part)))
    )


def _combined_tally(
    runner: LogRunner,
    whole: LogPart,
    executed_parts: Iterable[ExecutedPart],
    progress: Callable[[int], None],
) -> DifferenceTally:
    """Return the differences in the whole part of the log.

    From the first border on at which the hashes differ or a part is missing, the function executes
    the log serially. The arguments and errors are those of `run_parallel`.
    """
    part_by_start = {part.start: part for part in executed_parts if part.start < part.stop}
    tick, state = whole.start, whole.state
    total = DifferenceTally()
    while tick < whole.stop:
        part = part_by_start.get(tick)
        # If the hashes are equal, the process started from the state that a serial execution has
        # at this tick.
        if part is None or part.start_hash != state.digest():
            _, remainder = runner.execute_log_part(
                tick, whole.stop, state, None, count_progress(progress, tick - whole.start)
            )
            return total.merged_with_later_tally(remainder)
        total = total.merged_with_later_tally(part.tally)
        tick, state = part.stop, part.end_state
    return total


def _parts_as_json(executed_parts: list[ExecutedPart]) -> str:
    """Return the results of a process as JSON."""
    return json.dumps(
        [
            {
                "range": (part.start, part.stop),
                "start_hash": part.start_hash.hex(),
                "end_state": snapshot_bytes(part.end_state).hex(),
                "tally": astuple(part.tally),
            }
            for part in executed_parts
        ]
    )


def _part_from_json(runner: LogRunner, data: dict[str, Any]) -> ExecutedPart:
    """Return an executed part from the data that `_parts_as_json` has written."""
    *numbers, first_difference, state, largest = data["tally"]
    difference_tally = DifferenceTally(
        *numbers,
        *(
            TickDifference(*difference) if difference else None
            for difference in (first_difference, state, largest)
        ),
    )
    end_state = restore_state(
        runner.controller.derived_constants.layout, bytes.fromhex(data["end_state"])
    )
    start, stop = data["range"]
    return ExecutedPart(start, stop, bytes.fromhex(data["start_hash"]), end_state, difference_tally)


def _wait_for_result(
    runner: LogRunner, worker: WorkerProcess, report_progress: Callable[[], None]
) -> list[ExecutedPart]:
    """Wait for the end of a worker process, and return the parts that it has executed.

    The result is empty if the worker process failed.
    """
    data = b""
    while True:
        if select.select([worker.pipe], [], [], PROGRESS_PERIOD_S)[0]:
            received_bytes = os.read(worker.pipe, 1 << 20)
            if not received_bytes:
                break
            data += received_bytes
        report_progress()
    return [_part_from_json(runner, part) for part in json.loads(data)] if data else []


def _kill_worker(worker: WorkerProcess) -> None:
    """Kill a worker process, and wait until the process has ended."""
    os.close(worker.pipe)
    os.kill(worker.process, signal.SIGKILL)
    os.waitpid(worker.process, 0)
