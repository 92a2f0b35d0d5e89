"""Re-execution in several processes, each of which starts after a snapshot of the log.

A part starts with a state whose hash is in the log. If the part before ends with an equal hash, then a serial run
reaches this state too, and its result is the sum of the parts. If the hashes differ, the rest of the log is executed
again in order. The result is therefore always that of a serial run.
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

from handctl.controller.snapshot import restore, snapshot
from handctl.controller.state import State
from handctl.errors import LogError
from handctl.processes import in_copy
from handctl.replay.course import Course, Tally
from handctl.replay.difference import Difference

LEAST = 200
"""Minimum number of ticks per process."""
LOOK_S = 0.2
"""Interval between reports of progress while waiting [s]."""


class Part(NamedTuple):
    """Ticks `start` to `stop`, and the state before the first of them."""

    start: int
    stop: int
    state: State


class Running(NamedTuple):
    """A process, the read end of its pipe, and its part."""

    process: int
    pipe: int
    part: Part


class Counts:
    """Executed ticks of each process, in shared memory."""

    def __init__(self, processes: int, told: Callable[[int], None]) -> None:
        """Allocate the shared memory.

        Args:
            processes: number of processes.
            told: called with the number of executed ticks.
        """
        # An anonymous mapping is shared with forked processes.
        self._done: NDArray[np.int64] = np.frombuffer(mmap.mmap(-1, 8 * processes), np.int64)
        self._told = told

    def of(self, process: int) -> Callable[[int], None]:
        """Return a function that counts further ticks of a process.

        The first process, our own, also reports progress.
        """

        def count(ticks: int) -> None:
            self._done[process] += ticks
            if process == 0:
                self.tell()

        return count

    def tell(self) -> None:
        """Report the number of executed ticks."""
        self._told(int(self._done.sum()))


def run_parallel(course: Course, workers: int, told: Callable[[int], None]) -> Tally:
    """Execute a whole log in several processes. Raises as `Course.run`.

    Args:
        course: the log and its controller.
        workers: maximum number of processes.
        told: called now and then with the number of ticks so far.
    """
    parts = split(course, workers)
    counts = Counts(len(parts), told)
    running = [_start(course, part, counts.of(i)) for i, part in enumerate(parts) if i]
    try:
        state, total = course.run(parts[0].start, parts[0].stop, parts[0].state, None, counts.of(0))
        for one in running:
            # Equal hashes: the part started from the state that a serial run has here.
            found = _result(course, one, counts) if state.digest() == one.part.state.digest() else None
            if found is None:
                _, rest = course.run(one.part.start, len(course.log), state, None, counts.of(0))
                return total.with_later(rest)
            state, tally = found
            total = total.with_later(tally)
        return total
    finally:
        for one in running:
            _end(one)


def split(course: Course, workers: int) -> list[Part]:
    """Return consecutive parts of about equal length. Each starts at the start of the log or after a snapshot."""
    ticks = len(course.log)
    k = course.log.k
    known = np.array(sorted(course.snapshots), np.int64)
    at = np.searchsorted(k, known)
    usable = [int(index) + 1 for index, one in zip(at, known, strict=True) if index < ticks and k[index] == one]
    count = min(workers, max(ticks // LEAST, 1), len(usable) + 1)
    wanted = [min(usable, key=lambda start: abs(start - ticks * i / count)) for i in range(1, count)]
    starts = {0: course.controller.initial()}
    for start in wanted:
        state = _state_behind(course, start - 1)
        if state is not None:
            starts[start] = state
    ends = [*sorted(starts), ticks]
    return [Part(start, stop, starts[start]) for start, stop in pairwise(ends)]


def _state_behind(course: Course, index: int) -> State | None:
    """Return the state in the log after a tick.

    Returns:
        None if this version cannot read the state, or its hash differs from the logged hash.
    """
    try:
        state = restore(course.controller.layout, course.snapshots[int(course.log.k[index])])
    except ValueError:
        return None
    return state if state.digest() == course.log.state_hash[index].tobytes() else None


def _start(course: Course, part: Part, count: Callable[[int], None]) -> Running:
    """Execute a part in a copy of this process."""
    return Running(*in_copy(lambda: _found(course, part, count)), part)


def _found(course: Course, part: Part, count: Callable[[int], None]) -> str:
    """Execute a part and return the result as JSON. A damaged log gives an empty text.

    The calling process then reaches the damage too, and reports the error.
    """
    try:
        state, tally = course.run(*part, None, count)
    except LogError:
        return ""
    return json.dumps({"state": snapshot(state).hex(), "tally": astuple(tally)})


def _result(course: Course, one: Running, counts: Counts) -> tuple[State, Tally] | None:
    """Wait for a process and return the state after its part and its tally.

    Returns:
        None if the process did not finish its part.
    """
    data = b""
    while True:
        if select.select([one.pipe], [], [], LOOK_S)[0]:
            more = os.read(one.pipe, 1 << 20)
            if not more:
                break
            data += more
        counts.tell()
    if not data:
        return None
    found: dict[str, Any] = json.loads(data)
    *numbers, first, state, largest = found["tally"]
    tally = Tally(*numbers, *(Difference(*one) if one else None for one in (first, state, largest)))
    return restore(course.controller.layout, bytes.fromhex(found["state"])), tally


def _end(one: Running) -> None:
    """Kill a process and wait for its end."""
    os.close(one.pipe)
    os.kill(one.process, signal.SIGKILL)
    os.waitpid(one.process, 0)
