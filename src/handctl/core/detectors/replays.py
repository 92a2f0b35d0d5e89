"""Detection of old load-cell readings under a fresh counter.

A reading has noise of several counts. If each reading of a channel equals the reading of a fixed
number of ticks ago, the channel sends old readings. A delay of n ticks that starts without a gap
sends n readings twice. A constant channel, or a loop in a limit cycle of a few counts, repeats its
readings without a fault. ``stuck`` judges these cases.
"""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core.block import Tables
from handctl.safety.faults.tendon import MIN_REPEATS, REPEAT_WINDOW

MAX_AGE_TICKS = 64
"""Largest age of a repeated reading that is searched [ticks]."""
LIMIT_CYCLE_VALUES = 5
"""Largest number of different readings in a limit cycle. Readings in a limit cycle are not independent."""
MIN_LOG_IMPROBABILITY = math.log(1e16)
"""Negative logarithm of the largest probability of a run of equal readings that counts as a repetition.

With noise of 8 counts two readings are equal in 4 of 100 cases, and a run of 12 readings is enough.
With noise of 1.5 counts a run of 22 readings is necessary.
"""


@inner
def update_repetitions(x: Tables, tared: bool) -> None:
    """Compare the readings of this tick with the readings of the last ``MAX_AGE_TICKS`` ticks."""
    count = x.tendon.shape[1]
    for n in range(count):
        x.tendon[s.COMPARED_READING, n] = x.tendon[s.MEASURED_TENSION, n] if tared else math.nan
        x.tendon_int[s.LONGEST_REPETITION, n] = 0
    for age in range(MAX_AGE_TICKS):
        for n in range(count):
            same = x.tendon[s.PAST_READINGS + age, n] == x.tendon[s.COMPARED_READING, n]
            run = min(x.tendon_int[s.REPETITIONS + age, n] + 1, MAX_AGE_TICKS) if same else 0
            x.tendon_int[s.REPETITIONS + age, n] = run
            x.tendon_int[s.LONGEST_REPETITION, n] = max(x.tendon_int[s.LONGEST_REPETITION, n], run)
    for age in range(MAX_AGE_TICKS - 1, 0, -1):
        for n in range(count):
            x.tendon[s.PAST_READINGS + age, n] = x.tendon[s.PAST_READINGS + age - 1, n]
    for n in range(count):
        x.tendon[s.PAST_READINGS, n] = x.tendon[s.COMPARED_READING, n]


@inner
def age_of_repeated_readings(x: Tables, n: int) -> int:
    """Return the age of a channel's repeated readings [ticks], 0 if the channel repeats none."""
    longest = x.tendon_int[s.LONGEST_REPETITION, n]
    # Probability of a run of this length, as a logarithm, because the power is a very small number.
    if longest < MIN_REPEATS or -longest * math.log(_chance_of_equal_readings(x, n)) < MIN_LOG_IMPROBABILITY:
        return 0
    for age in range(MAX_AGE_TICKS):
        if x.tendon_int[s.REPETITIONS + age, n] == longest:
            return age + 1
    return 0


@inner
def _chance_of_equal_readings(x: Tables, n: int) -> float:
    """Return the estimated probability of two equal readings, from the pairs of the last ``REPEAT_WINDOW`` readings."""
    pairs = 0
    different = 0
    for a in range(REPEAT_WINDOW):
        first = True
        for b in range(a):
            if x.tendon[s.PAST_READINGS + a, n] == x.tendon[s.PAST_READINGS + b, n]:
                pairs += 1
                first = False
        different += first
    if different <= LIMIT_CYCLE_VALUES:
        return 1.0
    return min(1.0, (pairs + 1) / (REPEAT_WINDOW * (REPEAT_WINDOW - 1) // 2 + 1))
