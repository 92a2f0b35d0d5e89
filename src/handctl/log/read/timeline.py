"""Events, gaps and grasp phases of a log."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import TickEvent
from handctl.errors import LogError

MAX_RUN_PERIODS = 1_000_000
"""Number of tick periods that a run is allowed to last, even if its log has few ticks."""
EXTRA_RUN_PERIODS_PER_TICK = 10
"""Number of tick periods by which each tick in the log extends the limit MAX_RUN_PERIODS."""


class LoggedEvent(NamedTuple):
    """Event of the controller, with the number and the time [ns] of the tick."""

    k: int
    t_ns: int
    event: TickEvent


class TickGap(NamedTuple):
    """Gap of missing ticks in a log, given by the tick before the gap and the tick after the gap."""

    last_tick_before: int
    first_tick_after: int


class PhaseChange(NamedTuple):
    """Start of a grasp phase, with tick number, time [ns] and name of the phase."""

    k: int
    t_ns: int
    name: str


def phase_of_each_tick(
    phase_changes: Sequence[PhaseChange], k: NDArray[np.int64]
) -> NDArray[np.str_]:
    """Return the name of the grasp phase in each tick (ticks,).

    Args:
        phase_changes: phase changes in order. The first change of the phase is at the first tick.
        k: (ticks,) tick numbers in rising order.
    """
    start_indices = np.array([change.k for change in phase_changes])
    names = np.array([change.name for change in phase_changes])
    return np.asarray(names[np.searchsorted(start_indices, k, side="right") - 1])


def check_tick_times(t_ns: NDArray[np.int64], period_ns: int) -> None:
    """Raise an error if the ticks are out of order, or if nearly all ticks of the run are missing.

    Without the check, a log with wrong tick times could require a table that does not fit into
    memory.

    Args:
        t_ns: (ticks,) times of the ticks [ns].
        period_ns: control period of the run [ns].

    Raises:
        LogError: the ticks are out of order, or nearly all ticks of the run are missing.
    """
    early_indices = np.flatnonzero(t_ns[1:] <= t_ns[:-1])
    if len(early_indices):
        at = early_indices[0]
        raise LogError(
            f"{t_ns[at + 1] / 1e9:.3f} s follows {t_ns[at] / 1e9:.3f} s",
            "the log",
            "ticks in order",
        )
    periods = (int(t_ns[-1]) - int(t_ns[0])) // period_ns if len(t_ns) else 0
    if periods > MAX_RUN_PERIODS + EXTRA_RUN_PERIODS_PER_TICK * len(t_ns):
        raise LogError(
            f"{len(t_ns)} ticks in {periods} periods", "the log", "a run with fewer missing ticks"
        )
