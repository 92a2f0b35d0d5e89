"""What a log tells of single moments."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.controller.types import Event


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
