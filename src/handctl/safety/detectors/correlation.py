"""Correlate the torque that a drive reports with the torque that it was commanded.

A drive that obeys reports what it was commanded: the small changes that noise puts on every command come back. A drive
whose feedback is another's, whose torque acts elsewhere, or that obeys late reports changes of its own, even where all
motors pull equally and nothing moves. With increments a of the command and b of the report, as forces at the cable [N],
low-passed products say so:

    S_ab + 4 sqrt(S_aa S_bb / n) < 0.4 S_aa      n = 2 tau / T samples

Less than two fifths of the command come back, by four standard deviations of the estimate. For uncorrelated increments
the sample covariance has the variance S_aa S_bb / n. Source: Bartlett's formula for white noise.

A pair counts only once a drive has answered in time for a few ticks. After a standstill it answers every
command that waited before it obeys the last of them, so that its next report belongs to an older command. And a
report may be a tick late for as long as the bus is slow: then it follows the command before that, which counts as well.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel, square

Vector = NDArray[np.float64]

TIME_S = 0.25
"""Time constant of the low-pass [s]."""
FILLED = 0.9
"""Share of the low-pass that measurements have to fill before it is judged."""
SIGMAS, PART = 4.0, 0.4
SETTLED_TICKS = 3
"""Ticks on time before a report is taken for the answer to its command: one obeys late, and two make an increment."""
MOVED_SHARE = 1.0 / 4000.0
"""Least increment, as a share of the largest force: half a step of a torque of twelve bits. Rounding blurs less."""


class Correlation(NamedTuple):
    """What the correlation carries from tick to tick.

    Attributes:
        forces: (4, N) last command, the two before that, and last report [N], NaN where unknown.
        moments: (5, N) low-passed S_aa, S_ab, S_ab of a report that is a tick late, S_bb [N^2], and the share of the
            low-pass that is filled.
        on_time: (N,) ticks in a row in which the motor answered in time.
    """

    forces: Vector
    moments: Vector
    on_time: Vector

    @staticmethod
    def initial(n: int) -> "Correlation":
        """Return what is known of n motors at first: nothing."""
        return Correlation(np.full((4, n), np.nan), np.zeros((5, n)), np.zeros(n))


def step(state: Correlation, commanded: Vector, reported: Vector, period: float, missed: int = 0) -> Correlation:
    """Take in one tick.

    Args:
        state: from the last tick.
        commanded: (N,) force that the last tick commanded [N]. A drive answers a command before it obeys it, so that
            the report of this tick belongs to the command before that.
        reported: (N,) force that the drive reports in this tick [N], NaN where no report came.
        period: control period [s].
        missed: ticks that were skipped before this one.
    """
    return Correlation(*_step(*state, commanded, reported, 1.0 - math.exp(-period / TIME_S), missed))


@kernel("matrix", "matrix", "vector", "vector", "vector", "real", "count")
def _step(
    forces: Vector, moments: Vector, on_time: Vector, commanded: Vector, reported: Vector, share: float, missed: int
) -> tuple[Vector, Vector, Vector]:
    """Take in one tick, of which each moment takes a share; see ``step``."""
    moments, settled = moments.copy(), np.zeros(len(commanded))
    for n in range(len(commanded)):
        a, b = forces[0, n] - forces[1, n], reported[n] - forces[3, n]
        before = forces[1, n] - forces[2, n]
        if missed == 0 and math.isfinite(reported[n]):
            settled[n] = on_time[n] + 1.0
        if math.isfinite(a + b + before) and settled[n] > SETTLED_TICKS:
            moments[0, n] += share * (a * a - moments[0, n])
            moments[1, n] += share * (a * b - moments[1, n])
            moments[2, n] += share * (before * b - moments[2, n])
            moments[3, n] += share * (b * b - moments[3, n])
            moments[4, n] += share * (1.0 - moments[4, n])
    return np.stack((commanded, forces[0], forces[1], reported)), moments, settled


def unfollowed(state: Correlation, largest: Vector, period: float) -> NDArray[np.bool_]:
    """Return (N,) whether a motor's report does not follow its command.

    Args:
        state: of this tick.
        largest: (N,) largest force [N].
        period: control period [s].
    """
    return _unfollowed(state.moments, largest, period)


@kernel("matrix", "vector", "real")
def _unfollowed(moments: Vector, largest: Vector, period: float) -> NDArray[np.bool_]:
    """Judge the moments (5, N); see ``unfollowed``."""
    found = np.zeros(len(largest), dtype=np.bool_)
    for n in range(len(largest)):
        aa, ab, bb = moments[0, n], max(moments[1, n], moments[2, n]), moments[3, n]
        # Both have to move by more than rounding: a command at rest says nothing, a report at rest is another fault.
        if moments[4, n] > FILLED and min(aa, bb) > square(MOVED_SHARE * largest[n]):
            found[n] = ab + SIGMAS * math.sqrt(aa * bb * period / (2.0 * TIME_S)) < PART * aa
    return found


def part(state: Correlation) -> Vector:
    """Return (N,) what part of the changes of the command is reported, 1 if it is obeyed."""
    aa, ab, late, _, _ = state.moments
    return np.asarray(np.maximum(ab, late) / np.maximum(aa, np.finfo(float).tiny))
