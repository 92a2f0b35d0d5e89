"""Detection of contact in the sweeps of a digit, by the unexplained part of the fit.

A contact adds tension from some angle on, and more the further the digit closes. A fit hides most
of it in the springs, but no parameter has a kink. Therefore a ramp that begins at some angle is
added to the linearised fit. The score is the ramp's size in standard deviations, after all
parameters have taken a share.
Source: score test (Rao 1948).

A contact that lasts from the open stop on has no kink. A digit of n joints, one of which cannot
move, looks like one with springs n / (n - 1) times as stiff and (n - 1) / n of their preload. Its
travel tells the two apart: all joints move if the digit closes farther than all but one of them
can.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from handctl.tune.identify.data import Array

KINK = 4.5
"""Least score of a contact, for a digit with one tendon."""
KINK_OF_SEVERAL = 6.0
"""Least score of a contact, for a digit with several tendons.

Undisturbed hands of 20 seeds, off by up to 30 %, have scores up to 3.1 with one tendon and 3.9 with
several. With several tendons a ramp is tried at every joint, and errors of joint encoders are left
out. A jamia finger that meets the thumb between 14 and 25 degrees has scores from 4.7 to 17.
"""
CLEAR = 3.0
"""Score below which a fit clears a blocked digit."""
CLEAR_ROWS = 80
"""Least number of rows of such a fit."""
CLEAR_SQUARE = 1.5
"""Largest mean square of such a fit's residuals."""
CLEAR_OUTLIERS = 0.005
"""Largest fraction of outliers of such a fit's rows."""
RAMP_STARTS = 40
"""Number of angles at which a ramp is tried."""
END_FRACTION = 0.04
"""Fraction of the sweep at either end where no ramp is tried, because it would rest on a few rows."""
MIN_OWN_FRACTION = 1e-6
"""Least part of a ramp (squared) that the parameters do not explain."""


class Ramp(NamedTuple):
    """The ramp with the largest score in the residuals of a fit.

    Attributes:
        score: size in standard deviations, positive if it adds to the tension.
        begin: angle at the beginning, mean of the joints [rad].
        end: largest angle of the sweep [rad].
        rise: tension [N] or joint torque [N m] at that angle.
        rows: rows of the sweep.
        outliers: fraction of rows that the fit has left out.
        square: mean square of the other residuals.
        kink: score from which the digit.
    """

    score: float
    begin: float
    end: float
    rise: float
    rows: int
    outliers: float
    square: float
    kink: float

    @property
    def met(self) -> bool:
        """Return True if the digit has touched something."""
        return abs(self.score) >= self.kink

    @property
    def clear(self) -> bool:
        """Return True if the fit explains the sweep well enough to exclude a contact."""
        good = self.square <= CLEAR_SQUARE and self.outliers <= CLEAR_OUTLIERS and self.rows >= CLEAR_ROWS
        return abs(self.score) < CLEAR and good


def steepest(jacobian: Array, residual: Array, first: int, angle: Array, units: Sequence[Array]) -> Ramp | None:
    """Return the ramp with the largest score, None if the fit has no sweep.

    Args:
        jacobian: (rows, parameters) of the fit, with rows of zeros for outliers.
        residual: (rows,) measured less expected, in standard deviations.
        first: row at which the sweep begins.
        angle: (m,) mean joint angle of the sweep's bins [rad].
        units: (m k,) residuals of a tension of 1 N or a torque of 1 N m, k rows for each bin,
            for every kind of ramp.
    """
    if not len(angle) or not units:
        return None
    count = len(units[0])
    rows = slice(first, first + count)
    used = jacobian[rows].any(axis=1)
    if not used.any():
        return None
    # The columns of `basis` span everything that the parameters explain.
    basis = np.linalg.qr(jacobian)[0]
    low = float(angle.min())
    high = float(angle.max())
    best = (0.0, high, 0.0)
    for start in np.linspace(low, high, RAMP_STARTS + 2)[1:-1].tolist():
        if not END_FRACTION < (start - low) / (high - low) < 1.0 - END_FRACTION:
            continue
        shape = np.repeat(np.maximum(0.0, angle - start) / (high - start), count // len(angle)) * used
        for unit in units:
            column = np.zeros(len(residual))
            column[rows] = shape * unit
            # The score uses only the part of the ramp outside of that span.
            orthogonal = column - basis @ (basis.T @ column)
            size = float(orthogonal @ orthogonal)
            if size > MIN_OWN_FRACTION * float(column @ column):
                score = float(orthogonal @ residual) / size**0.5
                best = max(best, (score, start, score / size**0.5), key=lambda ramp: abs(ramp[0]))
    square = float(np.mean(residual[rows][used] ** 2))
    kink = KINK if len(units) == 1 else KINK_OF_SEVERAL
    return Ramp(best[0], best[1], high, best[2], len(angle), 1.0 - float(used.mean()), square, kink)


def joints_moving(joint_count: int, preload: float, half_width: float, travel: float, full: float) -> bool:
    """Return True if all joints of a digit with one tendon move.

    Args:
        joint_count: number of joints.
        preload: preload of its springs as identified, over the hand file's.
        half_width: half width of the interval.
        travel: largest excursion of the digit [m].
        full: excursion with all joints at their closed ends [m].
    """
    # Halfway between the preload of n moving joints, 1, and that of n - 1, (n - 1) / n.
    stiff = 1.0 - 0.5 / joint_count
    return preload + half_width >= stiff or travel > full * (joint_count - 1) / joint_count
