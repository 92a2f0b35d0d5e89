"""What a log tells of single moments."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.types import Event
from handctl.errors import LogError

MOST_PERIODS, MOST_MISSING = 1_000_000, 10
"""Periods that a run may last in any case, and one more tick for so many beyond them."""


class LoggedEvent(NamedTuple):
    """An event with its time: tick number, time [ns], event."""

    k: int
    t_ns: int
    event: Event


class Gap(NamedTuple):
    """Ticks that are not in the log: the last before and the first after."""

    before: int
    after: int


class PhaseChange(NamedTuple):
    """A grasp phase that begins: tick number, time [ns], name."""

    k: int
    t_ns: int
    name: str


def phase_of_each(changes: Sequence[PhaseChange], k: NDArray[np.int64]) -> NDArray[np.str_]:
    """(ticks,) name of the phase of every tick.

    Args:
        changes: at least the one of the first tick.
        k: (ticks,) tick numbers, rising.
    """
    starts, names = np.array([change.k for change in changes]), np.array([change.name for change in changes])
    return np.asarray(names[np.searchsorted(starts, k, side="right") - 1])


def check_order(t_ns: NDArray[np.int64], period_ns: int) -> None:
    """Refuse ticks over which no grid of times can be laid: one with a wrong clock could ask for any memory.

    Args:
        t_ns: (ticks,) their times [ns].
        period_ns: of the run [ns].

    Raises:
        LogError: they are not in order, or nearly all are missing.
    """
    early = np.flatnonzero(t_ns[1:] <= t_ns[:-1])
    if len(early):
        at = early[0]
        raise LogError(f"{t_ns[at + 1] / 1e9:.3f} s follows {t_ns[at] / 1e9:.3f} s", "the log", "ticks in order")
    periods = (int(t_ns[-1]) - int(t_ns[0])) // period_ns if len(t_ns) else 0
    if periods > MOST_PERIODS + MOST_MISSING * len(t_ns):
        raise LogError(f"{len(t_ns)} ticks in {periods} periods", "the log", "a run of which less is missing")
