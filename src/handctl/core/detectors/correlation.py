"""Correlate the torque that a drive reports with the torque that it was commanded.

A drive that obeys reports what it was commanded: the small changes that noise puts on every command come back. A drive
whose feedback is another's, whose torque acts elsewhere, or that obeys late reports changes of its own, even where all
motors pull equally and nothing moves. With increments a of the command and b of the report, as forces at the spool [N],
low-passed products say so:

    S_ab + 4 sqrt(S_aa S_bb / n) < 0.4 S_aa      n = 2 tau / T samples

Less than two fifths of the command come back, by four standard deviations of the estimate. For uncorrelated increments
the sample covariance has the variance S_aa S_bb / n. Source: Bartlett's formula for white noise.

A pair counts only once a drive has answered in time for a few ticks. After a standstill it answers every
command that waited before it obeys the last of them, so that its next report belongs to an older command. And a
report may be a tick late for as long as the bus is slow: then it follows the command before that, which counts as well.
"""

import math

from handctl.compiled import inner, square
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.safety.faults.node import REPORTED_PART, REPORTED_S

FILLED = 0.9
"""Fraction of the low-pass that measurements have to fill before it is judged."""
SIGMAS = 4.0
SETTLED_TICKS = 3
"""Ticks on time before a report is taken for the answer to its command: one obeys late, and two make an increment."""
MOVED_FRACTION = 1.0 / 4000.0
"""Least increment, as a fraction of the largest force: half a step of a torque of twelve bits. Rounding blurs less."""
AA, AB, AB_LATE, BB, FULL = range(5)
"""Rows of ``block.REPORT_MOMENTS``: products, that of a report that is a tick late, and how far they are filled."""


@inner
def update(x: Tables, c: ConstantTables, missed: int) -> None:
    """Take in one tick.

    A drive answers a command before it obeys it, so that the report of this tick belongs to the command before the
    last.

    Args:
        x: tables. c: constants. missed: ticks that were skipped before this one.
    """
    fraction = 1.0 - math.exp(-c.run[h.PERIOD] / REPORTED_S)
    for n in range(x.tendon.shape[1]):
        command, first, second, last = (
            x.tendon[s.ASKED, n],
            x.tendon[s.REPORT_FORCES, n],
            x.tendon[s.REPORT_FORCES + 1, n],
            x.tendon[s.REPORT_FORCES + 2, n],
        )
        report = x.tendon[s.MEASURED_FORCE, n]
        a, b, late = first - second, report - x.tendon[s.REPORT_FORCES + 3, n], second - last
        settled = 0.0
        if missed == 0 and math.isfinite(report):
            settled = x.tendon[s.REPORT_ON_TIME, n] + 1.0
        if math.isfinite(a + b + late) and settled > SETTLED_TICKS:
            _low_pass(x, n, AA, fraction, a * a)
            _low_pass(x, n, AB, fraction, a * b)
            _low_pass(x, n, AB_LATE, fraction, late * b)
            _low_pass(x, n, BB, fraction, b * b)
            _low_pass(x, n, FULL, fraction, 1.0)
        x.tendon[s.REPORT_ON_TIME, n] = settled
        x.tendon[s.REPORT_FORCES, n], x.tendon[s.REPORT_FORCES + 1, n] = command, first
        x.tendon[s.REPORT_FORCES + 2, n], x.tendon[s.REPORT_FORCES + 3, n] = second, report


@inner
def _low_pass(x: Tables, n: int, moment: int, fraction: float, value: float) -> None:
    x.tendon[s.REPORT_MOMENTS + moment, n] += fraction * (value - x.tendon[s.REPORT_MOMENTS + moment, n])


@inner
def unfollowed(x: Tables, c: ConstantTables, n: int) -> bool:
    """Return whether a motor's report does not follow its command."""
    aa, bb = x.tendon[s.REPORT_MOMENTS + AA, n], x.tendon[s.REPORT_MOMENTS + BB, n]
    ab = max(x.tendon[s.REPORT_MOMENTS + AB, n], x.tendon[s.REPORT_MOMENTS + AB_LATE, n])
    # Both have to move by more than rounding: a command at rest says nothing, a report at rest is another fault.
    moves = min(aa, bb) > square(MOVED_FRACTION * c.tendon[h.DRIVE_LIMIT, n])
    if x.tendon[s.REPORT_MOMENTS + FULL, n] <= FILLED or not moves:
        return False
    return ab + SIGMAS * math.sqrt(aa * bb * c.run[h.PERIOD] / (2.0 * REPORTED_S)) < REPORTED_PART * aa


@inner
def part(x: Tables, n: int) -> float:
    """Return what part of the changes of the command is reported, 1 if it is obeyed."""
    ab = max(x.tendon[s.REPORT_MOMENTS + AB, n], x.tendon[s.REPORT_MOMENTS + AB_LATE, n])
    return ab / max(x.tendon[s.REPORT_MOMENTS + AA, n], 1e-300)
