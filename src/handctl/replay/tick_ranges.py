"""Distribution of the ticks of a log among processes that execute them.

Each process has a range of consecutive ticks, and executes the range in segments. A process that
has finished its range takes over the later half of the longest remaining range. So all processes
end at about the same time, even if the processor cores differ in speed.
"""

import fcntl
import mmap
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray


class TickRanges:
    """Ranges of ticks of all processes, in memory that the processes share.

    The object must exist before the processes are forked. A range shrinks at its start when its
    process takes a segment, and at its end when another process takes over a part of the range.
    """

    def __init__(
        self,
        range_starts: Sequence[int],
        end: int,
        segment_starts: Sequence[int],
        lock_file: IO[Any],
    ) -> None:
        """Allocate shared memory, and store the first range of each process.

        Args:
            range_starts: index of the first tick of each process, in ascending order. A range ends
                where the next range begins.
            end: index after the last tick of the last range.
            segment_starts: indices of the ticks at which a segment begins, in ascending order.
            lock_file: open file that a process locks while it changes a range.
        """
        self._segment_starts = segment_starts
        # An anonymous memory mapping is shared with the processes that this process forks.
        shared_memory = np.frombuffer(mmap.mmap(-1, 3 * 8 * len(range_starts)), np.int64)
        self._starts: NDArray[np.int64]
        self._ends: NDArray[np.int64]
        self._executed: NDArray[np.int64]
        self._starts, self._ends, self._executed = shared_memory.reshape(3, -1)
        self._starts[:] = range_starts
        self._ends[:] = [*range_starts[1:], end]
        self._lock_file = lock_file

    def take_segment(self, process: int) -> int | None:
        """Remove the first segment from the range of a process.

        Returns:
            the index after the last tick of the segment, or None if the range is empty.
        """
        with self._locked():
            start, end = int(self._starts[process]), int(self._ends[process])
            if start == end:
                return None
            next_segment = bisect_left(self._segment_starts, start + 1)
            if next_segment < len(self._segment_starts):
                end = min(end, self._segment_starts[next_segment])
            self._starts[process] = end
            return end

    def take_over_range(self, process: int) -> int | None:
        """Give the later half of the longest range to a process whose own range is empty.

        Returns:
            the index of the first tick of the new range. A segment begins at this tick. None if no
            other process has a whole segment left.
        """
        with self._locked():
            other_process = int(np.argmax(self._ends - self._starts))
            start, end = int(self._starts[other_process]), int(self._ends[other_process])
            candidates = self._segment_starts[
                bisect_left(self._segment_starts, start) : bisect_left(self._segment_starts, end)
            ]
            if not candidates:
                return None
            first_tick = min(candidates, key=lambda tick: abs(2 * tick - start - end))
            self._ends[other_process] = first_tick
            self._starts[process], self._ends[process] = first_tick, end
            return first_tick

    def add_executed_ticks(self, process: int, ticks: int) -> None:
        """Count ticks that a process has executed."""
        self._executed[process] += ticks

    @property
    def executed_tick_count(self) -> int:
        """Return how many ticks all processes together have executed."""
        return int(self._executed.sum())

    @contextmanager
    def _locked(self) -> Iterator[None]:
        """Exclude the other processes.

        The operating system releases the lock when a process ends, so that a killed process does
        not block the other processes.
        """
        fcntl.lockf(self._lock_file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            fcntl.lockf(self._lock_file, fcntl.LOCK_UN)
