"""Detection of old load-cell readings under a fresh counter.

A reading has noise of several counts. A channel repeating the readings of a constant number of
ticks ago, sample by sample, is no present measurement. A delay that starts without a gap sends as
many readings twice as the delay has ticks. A constant channel, or a loop cycling through a few
counts, repeats by nature. ``stuck`` judges these cases.
"""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core.block import Tables
from handctl.safety.faults.tendon import MIN_REPEATS, REPEAT_WINDOW

MAX_AGE_TICKS = 64
"""Largest age in the search [ticks]."""
LIMIT_CYCLE_VALUES = 5
"""Number of different readings in a loop's limit cycle. Neighbouring readings are then not independent."""
MIN_LOG_IMPROBABILITY = math.log(1e16)
"""Negative logarithm of the chance of a counting run.

With noise of 8 counts two readings agree in 4 of 100 cases, and 12 in a row are enough. With noise
of 1.5 counts 22 in a row are necessary.
"""


@inner
def update_repetitions(x: Tables, tared: bool) -> None:
    """Compare the readings with those of the last ``MAX_AGE_TICKS`` ticks."""
    count = x.tendon.shape[1]
    for n in range(count):
        x.tendon[s.READING, n] = x.tendon[s.MEASURED_TENSION, n] if tared else math.nan
        x.tendon_int[s.LONGEST, n] = 0
    for age in range(MAX_AGE_TICKS):
        for n in range(count):
            same = x.tendon[s.PAST + age, n] == x.tendon[s.READING, n]
            run = min(x.tendon_int[s.SAME + age, n] + 1, MAX_AGE_TICKS) if same else 0
            x.tendon_int[s.SAME + age, n] = run
            x.tendon_int[s.LONGEST, n] = max(x.tendon_int[s.LONGEST, n], run)
    for age in range(MAX_AGE_TICKS - 1, 0, -1):
        for n in range(count):
            x.tendon[s.PAST + age, n] = x.tendon[s.PAST + age - 1, n]
    for n in range(count):
        x.tendon[s.PAST, n] = x.tendon[s.READING, n]


@inner
def age_of_repeated_readings(x: Tables, n: int) -> int:
    """Return the age of a channel's repeated readings [ticks], 0 without repetition."""
    longest = x.tendon_int[s.LONGEST, n]
    # Chance of a run of this length, in logarithms, as the power of many small numbers.
    if longest < MIN_REPEATS or -longest * math.log(_chance_of_equal_readings(x, n)) < MIN_LOG_IMPROBABILITY:
        return 0
    for age in range(MAX_AGE_TICKS):
        if x.tendon_int[s.SAME + age, n] == longest:
            return age + 1
    return 0


@inner
def _chance_of_equal_readings(x: Tables, n: int) -> float:
    """Estimate the chance of two equal readings, from pairs among the last readings."""
    pairs = 0
    different = 0
    for a in range(REPEAT_WINDOW):
        first = True
        for b in range(a):
            if x.tendon[s.PAST + a, n] == x.tendon[s.PAST + b, n]:
                pairs += 1
                first = False
        different += first
    if different <= LIMIT_CYCLE_VALUES:
        return 1.0
    return min(1.0, (pairs + 1) / (REPEAT_WINDOW * (REPEAT_WINDOW - 1) // 2 + 1))
