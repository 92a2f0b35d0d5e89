"""Correlation of reported torque with commanded torque.

A drive that obeys reports the commanded torque, including the small changes that noise adds to
every command. The reports have other changes if they come from another drive, if the torque acts on
another joint, or if the drive obeys late. This is visible even if all motors pull equally and
nothing moves. With increments a of the command and b of the report, as forces at the spool [N], the
test uses low-passed products:

    S_ab + 4 sqrt(S_aa S_bb / n) < 0.4 S_aa      n = 2 tau / T samples

The fault is present if less than 0.4 of the command's changes are reported, with a margin of four
standard deviations of the estimate. For uncorrelated increments the sample covariance has the
variance S_aa S_bb / n. Source: Bartlett's formula for white noise.

The increments of a contact are a hundred times as large as those of a hold. Unlimited, they would
dominate the products for seconds after the contact. All increments are therefore limited to two
counts of the torque. For an obeying drive the limited increments have the same signs.

A pair of increments counts only after some ticks with replies in time. After a pause a drive
replies to every queued command before it obeys the last one, so the next report belongs to an older
command. On a slow bus a report may come a tick late, and then follows the command before. The test
uses the larger of the correlations with and without this delay.
"""

import math

from handctl.compiled import inner, square
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.safety.faults.node import REPORTED_FRACTION, REPORTED_S

MIN_FILLING = 0.9
"""Response of the low-pass filter to a constant 1 from which the test is made: most of its memory is filled."""
SIGMAS = 4.0
"""Margin of the test, in standard deviations of the estimated correlation."""
SETTLED_TICKS = 3
"""Ticks in a row with a reply in time before a report is attributed to a command.

A command takes effect a tick later, and an increment needs two commands.
"""
MOVED_FRACTION = 1.0 / 4000.0
"""Smallest increment, as a fraction of the largest force: half a count of a 12-bit torque.

Rounding dominates smaller increments. If a drive's torque has a larger count, half of that count is
used.
"""
LARGEST_INCREMENT = 4.0
"""Limit of an increment, as a multiple of the smallest one. Noise makes increments of about this size in a hold."""
SERVO_COUNTS = 0.75
"""Smallest increment for a drive that closes the position loop, in counts of position and speed.

The report contains rounded numbers, and the drive computes with unrounded ones. They differ by 0.3
counts (rms).
"""
MIN_SERVO_SHARE = 0.01
"""Fraction of recent ticks with a position loop from which this rounding counts."""
AA, AB, AB_LATE, BB, FULL = range(5)
"""Rows of ``block.REPORT_MOMENTS``: command squared, command times report, command times report of a tick later,
report squared, and the response to a constant 1."""


@inner
def update_correlation(x: Tables, c: ConstantTables, missed: int) -> None:
    """Update the moments of the increments.

    A drive replies to a command before it obeys it, so the report of a tick belongs to the command
    before the last.

    Args:
        x: state tables.
        c: constants of the hand.
        missed: ticks missed before the present tick.
    """
    fraction = 1.0 - math.exp(-c.run[h.PERIOD] / REPORTED_S)
    for n in range(x.tendon.shape[1]):
        # Commands of this tick and of the three ticks before, newest first.
        command = x.tendon[s.COMMANDED_FORCE, n]
        first = x.tendon[s.REPORT_FORCES, n]
        second = x.tendon[s.REPORT_FORCES + 1, n]
        last = x.tendon[s.REPORT_FORCES + 2, n]
        if c.tendon_int[h.DRIVE_CLOSES_LOOP, n]:
            closed = 1.0 if x.servo[s.SERVO_BEFORE + 2, n] > 0.0 else 0.0
            x.servo[s.SERVO_SHARE, n] += fraction * (closed - x.servo[s.SERVO_SHARE, n])
            last = second
            second = first
            first = x.servo[s.SERVO_REPORT, n]
        report = x.tendon[s.MEASURED_FORCE, n]
        largest = LARGEST_INCREMENT * _smallest_increment(x, c, n)
        a = _limited(first - second, largest)
        b = _limited(report - x.tendon[s.REPORT_FORCES + 3, n], largest)
        late = _limited(second - last, largest)
        settled = 0.0
        if missed == 0 and math.isfinite(report):
            settled = x.tendon[s.REPORT_ON_TIME, n] + 1.0
        if math.isfinite(a + b + late) and settled > SETTLED_TICKS:
            _low_pass_moment(x, n, AA, fraction, a * a)
            _low_pass_moment(x, n, AB, fraction, a * b)
            _low_pass_moment(x, n, AB_LATE, fraction, late * b)
            _low_pass_moment(x, n, BB, fraction, b * b)
            _low_pass_moment(x, n, FULL, fraction, 1.0)
        x.tendon[s.REPORT_ON_TIME, n] = settled
        if c.tendon_int[h.DRIVE_CLOSES_LOOP, n]:
            # The force predicted for this report takes the place of the command, so the history is
            # shifted by a tick.
            x.tendon[s.REPORT_FORCES, n] = first
            x.tendon[s.REPORT_FORCES + 1, n] = second
        else:
            x.tendon[s.REPORT_FORCES, n] = command
            x.tendon[s.REPORT_FORCES + 1, n] = first
            x.tendon[s.REPORT_FORCES + 2, n] = second
        x.tendon[s.REPORT_FORCES + 3, n] = report


@inner
def _smallest_increment(x: Tables, c: ConstantTables, n: int) -> float:
    """Return the smallest increment of a motor's torque, as force at the spool, that counts as a change [N]."""
    rounding = max(MOVED_FRACTION * c.tendon[h.DRIVE_LIMIT, n], 0.5 * c.tendon[h.TORQUE_STEP, n])
    if c.tendon_int[h.DRIVE_CLOSES_LOOP, n] and x.servo[s.SERVO_SHARE, n] > MIN_SERVO_SHARE:
        rounding = max(rounding, SERVO_COUNTS * c.tendon[h.SERVO_ROUNDING, n])
    return float(rounding)


@inner
def _limited(increment: float, largest: float) -> float:
    """Return an increment limited to plus or minus ``largest``. NaN stays NaN."""
    if increment > largest:
        return largest
    return -largest if increment < -largest else increment


@inner
def _low_pass_moment(x: Tables, n: int, moment: int, fraction: float, value: float) -> None:
    x.tendon[s.REPORT_MOMENTS + moment, n] += fraction * (value - x.tendon[s.REPORT_MOMENTS + moment, n])


@inner
def is_command_ignored(x: Tables, c: ConstantTables, n: int) -> bool:
    """Return True if a motor's report does not follow the command."""
    aa = x.tendon[s.REPORT_MOMENTS + AA, n]
    bb = x.tendon[s.REPORT_MOMENTS + BB, n]
    ab = max(x.tendon[s.REPORT_MOMENTS + AB, n], x.tendon[s.REPORT_MOMENTS + AB_LATE, n])
    # Command and report must both change by more than rounding. A constant report is another fault.
    moves = min(aa, bb) > square(_smallest_increment(x, c, n))
    if x.tendon[s.REPORT_MOMENTS + FULL, n] <= MIN_FILLING or not moves:
        return False
    return ab + SIGMAS * math.sqrt(aa * bb * c.run[h.PERIOD] / (2.0 * REPORTED_S)) < REPORTED_FRACTION * aa


@inner
def fraction_of_command_reported(x: Tables, n: int) -> float:
    """Return the reported fraction of the command's changes, 1 for an obeying drive."""
    ab = max(x.tendon[s.REPORT_MOMENTS + AB, n], x.tendon[s.REPORT_MOMENTS + AB_LATE, n])
    # The lower bound only prevents a division by 0.
    return ab / max(x.tendon[s.REPORT_MOMENTS + AA, n], 1e-300)
