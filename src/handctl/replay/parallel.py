"""Re-execution in several processes, each of which begins behind a snapshot of the log.

A part begins with a state whose hash is in the log. If the part before it ends with the same hash, then a serial run
comes to that state too, and finds what the parts found. Where a part ends with another hash, all behind it is executed
again, one tick after the other. So the result is always that of a serial run.
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
"""Ticks that are worth a process."""
LOOK_S = 0.2
"""Between two looks at how far the others are."""


class Part(NamedTuple):
    """Ticks ``start`` to ``stop``, and the state before the first of them."""

    start: int
    stop: int
    state: State


class Running(NamedTuple):
    """A process, its end of the pipe, and its part."""

    process: int
    pipe: int
    part: Part


class Counts:
    """Ticks that each process has executed, in memory that all share."""

    def __init__(self, processes: int, told: Callable[[int], None]) -> None:
        self._done: NDArray[np.int64] = np.frombuffer(mmap.mmap(-1, 8 * processes), np.int64)
        self._told = told

    def of(self, process: int) -> Callable[[int], None]:
        """Return what counts further ticks of a process; the first one, which is ours, tells of all."""

        def count(ticks: int) -> None:
            self._done[process] += ticks
            if process == 0:
                self.tell()

        return count

    def tell(self) -> None:
        """Tell how many ticks were executed."""
        self._told(int(self._done.sum()))


def run_parallel(course: Course, workers: int, told: Callable[[int], None]) -> Tally:
    """Execute a whole log in up to so many processes; raises as ``Course.run``.

    Args:
        course: the log and its controller.
        workers: processes.
        told: called now and then with the number of ticks so far.
    """
    parts = split(course, workers)
    counts = Counts(len(parts), told)
    running = [_start(course, part, counts.of(i)) for i, part in enumerate(parts) if i]
    try:
        state, total = course.run(parts[0].start, parts[0].stop, parts[0].state, None, counts.of(0))
        for one in running:
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
    """Return parts of about equal length that together are the log; each begins at the start or behind a snapshot."""
    ticks, k = len(course.log), course.log.k
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
    """Return the state in the log after a tick; None if this version cannot read it, or it is not the one hashed."""
    try:
        state = restore(course.controller.layout, course.snapshots[int(course.log.k[index])])
    except ValueError:
        return None
    return state if state.digest() == course.log.state_hash[index].tobytes() else None


def _start(course: Course, part: Part, count: Callable[[int], None]) -> Running:
    """Execute a part in a copy of this process."""
    return Running(*in_copy(lambda: _found(course, part, count)), part)


def _found(course: Course, part: Part, count: Callable[[int], None]) -> str:
    """Execute a part and return what was found; nothing if the log is damaged there.

    The process that asked then comes to it as well, and tells.
    """
    try:
        state, tally = course.run(*part, None, count)
    except LogError:
        return ""
    return json.dumps({"state": snapshot(state).hex(), "tally": astuple(tally)})


def _result(course: Course, one: Running, counts: Counts) -> tuple[State, Tally] | None:
    """Wait for a process; return the state after its part and what it found, None if it came to no end."""
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
    """End a process, whatever it does, and wait for it."""
    os.close(one.pipe)
    os.kill(one.process, signal.SIGKILL)
    os.waitpid(one.process, 0)
