"""A log through the controller again: every output byte is compared with the recorded one.

There is no bus here, no clock that decides anything, and no file but the log.
"""

import gc
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from handctl.controller.tick import Controller
from handctl.core.gains.gains import Gains
from handctl.core.types import TickIn, TickOut
from handctl.errors import LogError
from handctl.log.read.reader import RunLog
from handctl.replay.difference import Columns, Difference, differences, same, same_decisions
from handctl.replay.rebuild import rebuild

TOLD = 200
"""Ticks between two looks of whoever waits."""


@dataclass(frozen=True, slots=True)
class Execution:
    """What re-execution found.

    Attributes:
        ticks: executed.
        differing: ticks in which any output byte is another.
        undecided: ticks that decide something else: mode, phase, action or events.
        first: the first difference; None if there is none.
        largest: the largest difference of a number, by ``distance``; None if there is none.
        wall_s: time that it took, without designing the gains [s].
        cpu_s: of it, the time of this process [s]: what it would take on a machine with nothing else to do.
        logged_s: time that the run took [s].
    """

    ticks: int
    differing: int
    undecided: int
    first: Difference | None
    largest: Difference | None
    wall_s: float
    cpu_s: float
    logged_s: float

    @property
    def times_real_time(self) -> float:
        """Speed of the re-execution over that of the run."""
        return self.logged_s / self.wall_s if self.wall_s else math.inf


def distance(difference: Difference) -> float:
    """Size of a difference of numbers: absolute below 1, relative above; infinite if one of the two is NaN.

    Text has none: 0.
    """
    was, now = difference.logged, difference.computed
    if isinstance(was, str) or isinstance(now, str):
        return 0.0
    apart = abs(was - now)
    return math.inf if math.isnan(apart) else apart / max(1.0, abs(was))


def acceptable(execution: Execution, within: float) -> bool:
    """Whether all decisions are equal and no number differs by more than ``within``: other machines round otherwise."""
    largest = distance(execution.largest) if execution.largest else 0.0
    return not execution.undecided and largest <= within


def execute(
    log: RunLog,
    gains: Gains | None = None,
    watch: Callable[[TickIn, TickOut], None] | None = None,
    told: Callable[[int], None] | None = None,
) -> Execution:
    """Run the controller of a log on the log's inputs.

    Args:
        log: a run.
        gains: other gains than it ran with.
        watch: called with every tick.
        told: called now and then with the number of ticks so far.

    Raises:
        LogError: it cannot be rebuilt, or the log is damaged.
    """
    controller, columns = rebuild(log, gains), Columns.of(log.header)
    with undisturbed():
        return _execute(log, controller, columns, watch, told)


@contextmanager
def undisturbed() -> Iterator[None]:
    """No garbage collection, as in the loop, since a tick makes no cycles; numbers of a bad log overflow in silence."""
    gc.disable()
    try:
        with np.errstate(all="ignore"):
            yield
    finally:
        gc.enable()


def refusal(error: ValueError, k: int) -> LogError:
    """What a controller says of a tick that it would never have had."""
    return LogError(f"the controller refuses: {error}", f"tick {k}", "a value that fits")


def _execute(
    log: RunLog,
    controller: Controller,
    columns: Columns,
    watch: Callable[[TickIn, TickOut], None] | None,
    told: Callable[[int], None] | None,
) -> Execution:
    state = controller.initial()
    differing = undecided = ticks = 0
    first = largest = None
    began, cpu_began = time.perf_counter(), time.process_time()
    for logged, numbers in zip(log.ticks(), log.packed(), strict=True):
        try:
            state, out = controller.tick(state, logged.tick_in)
        except ValueError as error:
            raise refusal(error, logged.tick_in.k) from None
        ticks += 1
        if told and ticks % TOLD == 0:
            told(ticks)
        if watch:
            watch(logged.tick_in, out)
        if same(logged, numbers, out):
            continue
        differing += 1
        undecided += not same_decisions(logged, out)
        found = list(differences(columns, logged, numbers, out))
        first = first or found[0]
        largest = max(
            [*([largest] if largest else []), *(one for one in found if one.ulps is not None)],
            key=distance,
            default=None,
        )
    wall, cpu = time.perf_counter() - began, time.process_time() - cpu_began
    return Execution(ticks, differing, undecided, first, largest, wall, cpu, float(log.times[-1]) if len(log) else 0.0)
