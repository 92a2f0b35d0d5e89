"""Events, gaps and phases of a log."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.types import Event
from handctl.errors import LogError

MAX_PERIODS = 1_000_000
"""Number of tick periods allowed for every run, also with few ticks in its log."""
MAX_PERIODS_PER_TICK = 10
"""Number of additional tick periods allowed for each tick in the log."""


class LoggedEvent(NamedTuple):
    """Event with its tick number and time [ns]."""

    k: int
    t_ns: int
    event: Event


class Gap(NamedTuple):
    """Ticks missing from the log: number of the last tick before the gap and of the first tick after it."""

    before: int
    after: int


class PhaseChange(NamedTuple):
    """Start of a grasp phase: tick number, time [ns], name of the phase."""

    k: int
    t_ns: int
    name: str


def phase_of_each(changes: Sequence[PhaseChange], k: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return the name of the grasp phase in every tick (ticks,).

    Args:
        changes: phase changes, from the first tick on.
        k: (ticks,) tick numbers, rising.
    """
    starts = np.array([change.k for change in changes])
    names = np.array([change.name for change in changes])
    return np.asarray(names[np.searchsorted(starts, k, side="right") - 1])


def check_order(t_ns: NDArray[np.int64], period_ns: int) -> None:
    """Raise an error for ticks that do not fit a regular time grid.

    With a wrong clock in the log, the time grid could need too much memory.

    Args:
        t_ns: (ticks,) times of the ticks [ns].
        period_ns: period of the run [ns].

    Raises:
        LogError: the ticks are out of order, or nearly all are missing.
    """
    early = np.flatnonzero(t_ns[1:] <= t_ns[:-1])
    if len(early):
        at = early[0]
        raise LogError(
            f"{t_ns[at + 1] / 1e9:.3f} s follows {t_ns[at] / 1e9:.3f} s",
            "the log",
            "ticks in order",
        )
    periods = (int(t_ns[-1]) - int(t_ns[0])) // period_ns if len(t_ns) else 0
    if periods > MAX_PERIODS + MAX_PERIODS_PER_TICK * len(t_ns):
        raise LogError(f"{len(t_ns)} ticks in {periods} periods", "the log", "a run with fewer missing ticks")
