"""Detect load-cell readings that were there before: content that is some ticks old under a fresh counter.

A reading carries noise of several counts. If a channel repeats, sample by sample, what it read a constant number of
ticks ago, it is no measurement of now. A delay that sets in without a gap sends as many readings twice as it is ticks
long. A channel that stands, or whose loop cycles through a few counts, repeats itself by nature: then ``stuck`` asks.
"""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core.block import Tables
from handctl.safety.faults.tendon import SAME_LEAST, SAME_WINDOW

AGE = 64
"""Oldest content that is looked for [ticks]."""
FEW = 5
"""So many different readings in the window are the limit cycle of a loop, in which neighbours are not independent."""
UNLIKELY = math.log(1e16)
"""Negative logarithm of the chance of a run that counts. With noise of 8 counts two readings agree in 4 of 100 cases
and 12 in a row are enough; with noise of 1.5 counts it takes 22."""


@inner
def update(x: Tables, tared: bool) -> None:
    """Compare the readings with those of the last ``AGE`` ticks."""
    count = x.tendon.shape[1]
    for n in range(count):
        x.tendon[s.READING, n] = x.tendon[s.MEASURED_TENSION, n] if tared else math.nan
        x.tendon_int[s.LONGEST, n] = 0
    for age in range(AGE):
        for n in range(count):
            same = x.tendon[s.PAST + age, n] == x.tendon[s.READING, n]
            run = min(x.tendon_int[s.SAME + age, n] + 1, AGE) if same else 0
            x.tendon_int[s.SAME + age, n] = run
            x.tendon_int[s.LONGEST, n] = max(x.tendon_int[s.LONGEST, n], run)
    for age in range(AGE - 1, 0, -1):
        for n in range(count):
            x.tendon[s.PAST + age, n] = x.tendon[s.PAST + age - 1, n]
    for n in range(count):
        x.tendon[s.PAST, n] = x.tendon[s.READING, n]


@inner
def replayed(x: Tables, n: int) -> int:
    """Return the age [ticks] of what a channel repeats; 0 if it does not."""
    longest = x.tendon_int[s.LONGEST, n]
    if longest < SAME_LEAST or -longest * math.log(_chance(x, n)) < UNLIKELY:
        return 0
    for age in range(AGE):
        if x.tendon_int[s.SAME + age, n] == longest:
            return age + 1
    return 0


@inner
def _chance(x: Tables, n: int) -> float:
    """Estimate the chance that two readings of now are equal, from the pairs among the last ones."""
    pairs, different = 0, 0
    for a in range(SAME_WINDOW):
        first = True
        for b in range(a):
            if x.tendon[s.PAST + a, n] == x.tendon[s.PAST + b, n]:
                pairs += 1
                first = False
        different += first
    if different <= FEW:
        return 1.0
    return min(1.0, (pairs + 1) / (SAME_WINDOW * (SAME_WINDOW - 1) // 2 + 1))
