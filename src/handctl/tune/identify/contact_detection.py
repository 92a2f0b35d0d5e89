"""Detection of a contact during the sweeps of a digit, from the residuals of the fit.

A contact adds tension from a certain angle on, and the added tension grows as the digit closes. The
fit attributes most of this tension to the springs, but no parameter can reproduce the kink.
Therefore a ramp that begins at some angle is added to the linearised fit. The score is the size of
the ramp in standard deviations, fitted together with all parameters.
Source: score test (Rao 1948).

A contact over the whole sweep causes no kink. A digit with n joints, one of them immobile, then
behaves like a freely moving digit with springs n / (n - 1) times as stiff and (n - 1) / n of the
preload. The travel distinguishes the two cases: if the digit closes farther than n - 1 joints can,
all joints move.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from handctl.tune.identify.data import Array

CONTACT_SCORE = 4.5
"""Smallest score that counts as a contact, for a digit with one tendon."""
MULTI_TENDON_CONTACT_SCORE = 6.0
"""Smallest score that counts as a contact, for a digit with several tendons.

Hands without contact (20 seeds, parameters wrong by up to 30 %) have scores up to 3.1 with one
tendon and 3.9 with several. With several tendons a ramp is tried at every joint, and errors of
joint encoders are neglected. A jamia finger that touches the thumb between 14 and 25 degrees has
scores from 4.7 to 17.
"""
CLEAR_SCORE = 3.0
"""Score below which a fit may prove that a digit was not blocked."""
MIN_CLEAR_ROWS = 80
"""Smallest number of rows in a fit that proves that a digit was not blocked."""
MAX_CLEAR_MEAN_SQUARE = 1.5
"""Largest mean square of the residuals in a fit that proves that a digit was not blocked."""
MAX_CLEAR_OUTLIERS = 0.005
"""Largest fraction of outliers in a fit that proves that a digit was not blocked."""
RAMP_STARTS = 40
"""Number of start angles tried for a ramp."""
END_FRACTION = 0.04
"""Fraction of the sweep at each end in which no ramp may begin, because too few rows would determine it."""
MIN_OWN_FRACTION = 1e-6
"""Smallest fraction of the squared norm of a ramp that the parameters do not explain."""


class Ramp(NamedTuple):
    """Ramp with the largest score in the residuals of a fit.

    Attributes:
        score: size in standard deviations, positive if the ramp adds tension.
        begin: mean joint angle at which the ramp begins [rad].
        end: largest angle of the sweep [rad].
        rise: tension [N] or joint torque [N m] of the ramp at angle ``end``.
        rows: number of rows in the sweep.
        outliers: fraction of rows excluded by the fit.
        mean_square: mean square of the residuals without outliers.
        contact_score: smallest score that counts as a contact of this digit.
    """

    score: float
    begin: float
    end: float
    rise: float
    rows: int
    outliers: float
    mean_square: float
    contact_score: float

    @property
    def is_contact(self) -> bool:
        """Return True if the digit has touched an obstacle."""
        return abs(self.score) >= self.contact_score

    @property
    def excludes_contact(self) -> bool:
        """Return True if the fit explains the sweep well enough to exclude a contact."""
        good = (
            self.mean_square <= MAX_CLEAR_MEAN_SQUARE
            and self.outliers <= MAX_CLEAR_OUTLIERS
            and self.rows >= MIN_CLEAR_ROWS
        )
        return abs(self.score) < CLEAR_SCORE and good


def steepest_ramp(jacobian: Array, residual: Array, first: int, angle: Array, units: Sequence[Array]) -> Ramp | None:
    """Return the ramp with the largest score, or None if the fit has no sweep.

    Args:
        jacobian: (rows, parameters) of the fit, with rows of zeros for outliers.
        residual: (rows,) measured minus expected values, in standard deviations.
        first: row at which the sweep begins.
        angle: (m,) mean joint angle of the sweep's bins [rad].
        units: residuals (m k,) caused by a tension of 1 N or a torque of 1 N m, k rows per bin, for
            every kind of ramp.
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
    mean_square = float(np.mean(residual[rows][used] ** 2))
    contact_score = CONTACT_SCORE if len(units) == 1 else MULTI_TENDON_CONTACT_SCORE
    return Ramp(best[0], best[1], high, best[2], len(angle), 1.0 - float(used.mean()), mean_square, contact_score)


def are_joints_moving(joint_count: int, preload: float, half_width: float, travel: float, full: float) -> bool:
    """Return True if all joints of a digit with one tendon move.

    Args:
        joint_count: number of joints.
        preload: identified preload of the springs, divided by that of the hand file.
        half_width: half width of the interval of the preload.
        travel: largest excursion of the digit [m].
        full: excursion with all joints at their closed ends [m].
    """
    # The limit is halfway between the preload with n moving joints, 1, and with n - 1, (n - 1) / n.
    stiff = 1.0 - 0.5 / joint_count
    return preload + half_width >= stiff or travel > full * (joint_count - 1) / joint_count
