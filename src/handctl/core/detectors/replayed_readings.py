"""Detection of load-cell frames that contain old readings although their SYNC counter is new.

The readings of a load cell vary by several counts, because of noise. Load-cell frames contain old
readings if each reading of a load cell equals its reading a fixed number of ticks earlier. If the
load cells begin to send each reading n ticks late, but still send one reading per tick, they send
the last n readings twice. A load cell with a constant reading also repeats its readings. The
readings of a load cell also repeat if the tension control of the tendon oscillates with an
amplitude of a few counts. The detector of replayed readings does not regard repeated constant
readings as a fault. The detector ``stuck_sensors`` tests for constant readings.
"""

import math

from handctl.compiled import kernel_helper
from handctl.core import state_block as s
from handctl.core.state_block import StateTables
from handctl.safety.faults.tendon import MIN_REPEATED_READINGS, REPEAT_WINDOW

MAX_READING_AGE_TICKS = 64
"""Number of earlier readings of a load cell with which each new reading is compared."""
MAX_LIMIT_CYCLE_READINGS = 5
"""Largest number of different readings in a limit cycle.

The readings of a limit cycle are not independent of each other.
"""
MIN_NEGATIVE_LOG_PROBABILITY = math.log(1e16)
"""Threshold for a repetition: negative logarithm of the probability that a run of equal readings occurs by chance.

With noise of 8 counts, two readings are equal in 4 of 100 cases, and a run of 12 equal pairs
reaches the threshold. With noise of 1.5 counts, a run of 22 equal pairs is necessary to reach the
threshold.
"""


@kernel_helper
def count_repeated_readings(x: StateTables, are_cells_tared: bool) -> None:
    """Compare the present load-cell readings with the readings of the last ``MAX_READING_AGE_TICKS`` ticks.

    The present reading then becomes the youngest of the past readings.
    """
    for n in range(x.tendon.shape[1]):
        present = x.tendon[s.MEASURED_TENSION, n] if are_cells_tared else math.nan
        x.tendon[s.PRESENT_CELL_READING, n] = present
        longest_run = 0
        next_past = present
        for age in range(MAX_READING_AGE_TICKS):
            past = x.tendon[s.PAST_CELL_READINGS + age, n]
            x.tendon[s.PAST_CELL_READINGS + age, n] = next_past
            next_past = past
            run_length = 0
            if past == present:
                run_length = min(
                    x.tendon_int[s.REPEATED_READINGS_BY_AGE + age, n] + 1, MAX_READING_AGE_TICKS
                )
                longest_run = max(longest_run, run_length)
            x.tendon_int[s.REPEATED_READINGS_BY_AGE + age, n] = run_length
        x.tendon_int[s.LONGEST_READING_REPETITION, n] = longest_run


@kernel_helper
def age_of_repeated_readings(x: StateTables, n: int) -> int:
    """Return the age of the old readings that a load cell sends again [ticks].

    Return 0 if the load cell does not repeat readings.
    """
    longest_run = x.tendon_int[s.LONGEST_READING_REPETITION, n]
    # The probability of a run of equal readings is compared as a logarithm, because the probability
    # itself is too small a number.
    if (
        longest_run < MIN_REPEATED_READINGS
        or -longest_run * math.log(_probability_of_equal_readings(x, n))
        < MIN_NEGATIVE_LOG_PROBABILITY
    ):
        return 0
    for age in range(MAX_READING_AGE_TICKS):
        if x.tendon_int[s.REPEATED_READINGS_BY_AGE + age, n] == longest_run:
            return age + 1
    return 0


@kernel_helper
def _probability_of_equal_readings(x: StateTables, n: int) -> float:
    """Return the estimated probability that two readings of a load cell are equal by chance.

    The estimate uses all pairs of the last ``REPEAT_WINDOW`` readings.
    """
    equal_pair_count = 0
    distinct_value_count = 0
    for a in range(REPEAT_WINDOW):
        is_new_value = True
        for b in range(a):
            if x.tendon[s.PAST_CELL_READINGS + a, n] == x.tendon[s.PAST_CELL_READINGS + b, n]:
                equal_pair_count += 1
                is_new_value = False
        distinct_value_count += is_new_value
    if distinct_value_count <= MAX_LIMIT_CYCLE_READINGS:
        return 1.0
    return min(1.0, (equal_pair_count + 1) / (REPEAT_WINDOW * (REPEAT_WINDOW - 1) // 2 + 1))
