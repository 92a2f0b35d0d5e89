"""A reading that stands still although it must move: an expectation, not a variance; what rests is healthy."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.choose import nothing
from handctl.compiled import kernel

Vector = NDArray[np.float64]


class Stuck(NamedTuple):
    """Attributes: value: (n,) last reading. ticks: (n,) for how long the same. anchor: (c, n) witnesses back then."""

    value: Vector
    ticks: NDArray[np.int64]
    anchor: Vector

    @staticmethod
    def initial(n: int, witnesses: int) -> "Stuck":
        """Nothing read yet."""
        return Stuck(nothing(n), np.zeros(n, dtype=np.int64), nothing(witnesses * n).reshape(witnesses, n))


def step(state: Stuck, value: Vector, witnesses: Vector) -> Stuck:
    """One tick.

    Args:
        state: from the last tick.
        value: (n,) new readings, NaN where missing: a missing one is neither the same nor another one.
        witnesses: (c, n) what must not move while the reading stands; NaN for what says nothing.
    """
    return Stuck(*_step(*state, value, witnesses))


@kernel("vector", "counts", "matrix", "vector", "matrix")
def _step(
    last: Vector, ticks: NDArray[np.int64], anchor: Vector, value: Vector, witnesses: Vector
) -> tuple[Vector, NDArray[np.int64], Vector]:
    """Take in one tick; see ``Stuck`` and ``step``."""
    last, ticks, anchor = last.copy(), ticks.copy(), anchor.copy()
    for i in range(len(value)):
        fresh = not math.isnan(value[i])
        moved = fresh and value[i] != last[i]
        for witness in range(len(anchor)):
            if moved or math.isnan(anchor[witness, i]):
                anchor[witness, i] = witnesses[witness, i]
        if fresh:
            ticks[i], last[i] = 0 if moved else ticks[i] + 1, value[i]
    return last, ticks, anchor


def leapt(state: Stuck, which: NDArray[np.bool_], way: Vector) -> Stuck:
    """As if the first witness of the first readings had been there all the time, to which it leaps now.

    Args:
        state: so far.
        which: (m,) of m of the n readings, where it leaps. way: (m,) how far.
    """
    anchor = state.anchor.copy()
    anchor[0, np.flatnonzero(which)] += way[which]
    return state._replace(anchor=anchor)


def unwitnessed(state: Stuck, which: NDArray[np.bool_]) -> Stuck:
    """Forget where the first witness of some readings was: it begins anew when it has something to say again.

    Args:
        state: so far.
        which: (n,) readings.
    """
    anchor = state.anchor.copy()
    np.putmask(anchor[0], which, np.nan)
    return state._replace(anchor=anchor)


def away(state: Stuck, witnesses: Vector) -> Vector:
    """How far each witness has moved since the reading stands, (c, n); 0 where it says nothing."""
    return np.asarray(np.fmax(np.abs(witnesses - state.anchor), 0.0))
