"""Detect contact in the sweeps of a digit by what its fit leaves unexplained.

A contact adds tension from some angle on, the more the further the digit goes. A fit hides most of it in the springs,
but a kink is in no parameter. So a ramp that begins at some angle is added to the linearised fit. Its score is what the
residuals say of it, in standard deviations, after all parameters have taken their part.
Source: score test (Rao 1948).

A contact that is there from the open stop on has no kink. A digit of n joints, one of which cannot move, looks like one
with springs n / (n - 1) times as stiff and (n - 1) / n of their preload. It is told from such a digit by its travel:
all joints move if it closes farther than all but one of them can.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from handctl.tune.identify.data import Array

KINK, KINK_OF_SEVERAL = 4.5, 6.0
"""Score from which on a digit with one tendon has met something, and one with several.

Undisturbed hands of 20 seeds, off by up to 30 %, have up to 3.1 and 3.9: of several tendons every joint is tried, and
errors of joint encoders are left out. A jamia finger that meets the thumb between 14 and 25 degrees has 4.7 to 17."""
CLEAR, CLEAR_ROWS = 3.0, 80
"""A fit of so many rows with a score below the first clears a digit that the controller has found blocked."""
CLEAR_SQUARE, CLEAR_OUTLIERS = 1.5, 0.005
"""Most mean square and share of outliers of such a fit's rows."""
PLACES = 40
"""Angles at which a ramp is tried, between the ends of the sweep."""
ENDS = 0.04
"""Share of the sweep at either end where no ramp is tried: it would rest on a few rows."""
LITTLE = 1e-6
"""A ramp is not told from the parameters if less than this share of it (squared) is its own."""


class Ramp(NamedTuple):
    """The ramp that the residuals of a fit ask for most.

    Attributes:
        score: in standard deviations; positive if it adds to what the tendon bears.
        begin: angle at which it begins, mean of the joints [rad].
        end: largest angle of the sweep [rad].
        rise: tension [N] or joint torque [N m] at that angle.
        rows: of the sweep. outliers: share of them that the fit has left out. square: mean square of the others.
        kink: score from which on the digit has met something.
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
        """Return whether the digit has met something."""
        return abs(self.score) >= self.kink

    @property
    def clear(self) -> bool:
        """Return whether the fit explains the sweep well enough to say that the digit has met nothing."""
        good = self.square <= CLEAR_SQUARE and self.outliers <= CLEAR_OUTLIERS and self.rows >= CLEAR_ROWS
        return abs(self.score) < CLEAR and good


def steepest(jacobian: Array, residual: Array, first: int, angle: Array, units: Sequence[Array]) -> Ramp | None:
    """Return the ramp with the largest score; None if the fit has no sweep.

    Args:
        jacobian: (rows, parameters) of the fit, with rows of zeros for outliers.
        residual: (rows,) measured less expected, in standard deviations.
        first: row at which the sweep begins.
        angle: (m,) of the sweep's bins, mean of the joints [rad].
        units: (m k,) residuals of a tension [N] or torque [N m] of one, k rows for each bin, for every kind of ramp.
    """
    if not len(angle) or not units:
        return None
    count = len(units[0])
    place = slice(first, first + count)
    kept = jacobian[place].any(axis=1)
    if not kept.any():
        return None
    basis = np.linalg.qr(jacobian)[0]
    low, high = float(angle.min()), float(angle.max())
    best = (0.0, high, 0.0)
    for begin in np.linspace(low, high, PLACES + 2)[1:-1].tolist():
        if not ENDS < (begin - low) / (high - low) < 1.0 - ENDS:
            continue
        shape = np.repeat(np.maximum(0.0, angle - begin) / (high - begin), count // len(angle)) * kept
        for unit in units:
            column = np.zeros(len(residual))
            column[place] = shape * unit
            own = column - basis @ (basis.T @ column)
            size = float(own @ own)
            if size > LITTLE * float(column @ column):
                score = float(own @ residual) / size**0.5
                best = max(best, (score, begin, score / size**0.5), key=lambda one: abs(one[0]))
    square = float(np.mean(residual[place][kept] ** 2))
    kink = KINK if len(units) == 1 else KINK_OF_SEVERAL
    return Ramp(best[0], best[1], high, best[2], len(angle), 1.0 - float(kept.mean()), square, kink)


def joints_moving(joint_count: int, preload: float, half_width: float, travel: float, full: float) -> bool:
    """Return whether all joints of a digit with one tendon move.

    Args:
        joint_count: of the digit.
        preload: of its springs as found, over the hand file's.
        half_width: of its interval.
        travel: excursion that the digit came to [m].
        full: excursion with all joints at their closed ends [m].
    """
    stiff = 1.0 - 0.5 / joint_count
    return preload + half_width >= stiff or travel > full * (joint_count - 1) / joint_count
