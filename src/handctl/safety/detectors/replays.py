"""Detect load-cell readings that were there before: content that is some ticks old under a fresh counter.

A reading carries noise of several counts. If a channel repeats, sample by sample, what it read a constant number of
ticks ago, it is no measurement of now. A delay that sets in without a gap sends as many readings twice as it is ticks
long. A channel that stands, or whose loop cycles through a few counts, repeats itself by nature: then ``stuck`` asks.
"""

import math
from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.choose import nothing
from handctl.compiled import kernel

Vector = NDArray[np.float64]
Counts = NDArray[np.int16]

AGE = 64
"""Oldest content that is looked for [ticks]."""
LEAST, WINDOW = 8, 16
"""Readings in a row that are as they were, from which on chance is asked; readings from which chance is estimated."""
FEW = 5
"""So many different readings in the window are the limit cycle of a loop, in which neighbours are not independent."""
UNLIKELY = math.log(1e16)
"""Negative logarithm of the chance of a run that counts. With noise of 8 counts two readings agree in 4 of 100 cases
and 12 in a row are enough; with noise of 1.5 counts it takes 22."""


class Replays(NamedTuple):
    """Last readings and runs of equal ones.

    Attributes:
        past: (AGE, N) readings, the latest first [N]; NaN where there was none.
        same: (AGE, N) how many readings in a row were as so many ticks before.
    """

    past: Vector
    same: Counts

    @staticmethod
    def initial(n: int) -> "Replays":
        """Return the state before the first reading."""
        return Replays(nothing(AGE * n).reshape(AGE, n), np.zeros((AGE, n), np.int16))


def step(state: Replays, reading: Vector) -> Replays:
    """Compare (N,) readings [N], NaN where missing, with those of the last ``AGE`` ticks."""
    return Replays(*_step(*state, reading))


@kernel("matrix", "shorts", "vector")
def _step(past: Vector, same: Counts, reading: Vector) -> tuple[Vector, Counts]:
    """Return past readings and runs of equal ones, with those of this tick; see ``Replays``."""
    after, runs = np.empty_like(past), np.zeros_like(same)
    after[0], after[1:] = reading, past[:-1]
    for age in range(AGE):
        for n in range(len(reading)):
            if past[age, n] == reading[n]:
                runs[age, n] = min(same[age, n] + 1, AGE)
    return after, runs


def replayed(state: Replays) -> list[tuple[int, int]]:
    """Return (channel, age [ticks]) of each channel whose readings were there before."""
    if not _any_run(state.same):
        return []
    found, longest = [], state.same.max(axis=0)
    for channel in np.flatnonzero(longest >= LEAST).tolist():
        run = int(longest[channel])
        if -run * math.log(_agreeing(state.past[:WINDOW, channel].tolist())) >= UNLIKELY:
            found.append((channel, int(np.argmax(state.same[:, channel])) + 1))
    return found


@kernel("shorts")
def _any_run(same: Counts) -> bool:
    """Return whether any run is so long that chance is asked."""
    for age in range(same.shape[0]):
        for n in range(same.shape[1]):
            if same[age, n] >= LEAST:
                return True
    return False


def _agreeing(readings: list[float]) -> float:
    """Estimate the chance that two readings of now are equal, from the pairs among the last ones."""
    counts = Counter(readings)
    if len(counts) <= FEW:
        return 1.0
    pairs = sum(count * (count - 1) // 2 for count in counts.values())
    return min(1.0, (pairs + 1) / (len(readings) * (len(readings) - 1) // 2 + 1))
