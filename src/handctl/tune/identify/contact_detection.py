"""Detection of a contact during the sweeps of a digit, from the residuals of the fit.

If a closing digit touches an obstacle, an additional tension occurs. The additional tension begins
at the joint angle of the contact, and grows while the digit closes further. The fit attributes most
of the additional tension to the springs, but no parameter can reproduce the kink in the curve.
Therefore a ramp of tension is added to the linearised fit, and is determined together with all
parameters. The joint angle at which the ramp begins is varied. The score of the contact is the
height of the ramp in standard deviations. Source: score test (Rao 1948).

A contact that lasts during the whole sweep causes no kink. If a contact blocks one of n joints
during the whole sweep, the digit behaves like a free digit with different springs. The stiffness of
these springs is n / (n - 1) of the true stiffness, and the preload is (n - 1) / n of the true
preload. The travel of the tendon shows whether a joint is blocked. If the digit closes farther than
n - 1 joints permit, no joint is blocked.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from handctl.tune.identify.tendon_data import Array

MIN_CONTACT_SCORE = 4.5
"""Smallest score of a ramp that counts as a contact, for a digit with one tendon."""
MIN_CONTACT_SCORE_OF_SEVERAL_TENDONS = 6.0
"""Smallest score of a ramp that counts as a contact, for a digit with several tendons.

In simulations without contact (20 seeds, parameters wrong by up to 30 %), scores reach 3.1 for
digits with one tendon and 3.9 for digits with several tendons. With several tendons, the search
tries a ramp at every joint, and neglects errors of joint encoders. A finger of the hand jamia that
touches the thumb between 14 and 25 degrees has scores from 4.7 to 17.
"""
MAX_SCORE_WITHOUT_CONTACT = 3.0
"""Largest score of the ramp at which a fit can exclude a blocked digit."""
MIN_ROWS_WITHOUT_CONTACT = 80
"""Smallest number of rows in the sweep with which a fit can exclude a blocked digit."""
MAX_MEAN_SQUARE_WITHOUT_CONTACT = 1.5
"""Largest mean square of the residuals at which a fit can exclude a blocked digit."""
MAX_OUTLIERS_WITHOUT_CONTACT = 0.005
"""Largest fraction of outliers at which a fit can exclude a blocked digit."""
RAMP_START_COUNT = 40
"""Number of joint angles that are tried as the beginning of a ramp."""
SWEEP_END_FRACTION = 0.04
"""Fraction of the sweep at each end in which no ramp is allowed to begin.

The fit would have too few rows of data for a ramp that begins near an end of the sweep.
"""
MIN_UNEXPLAINED_RAMP_FRACTION = 1e-6
"""Smallest fraction of a ramp's squared norm that the parameters of the fit must leave unexplained."""


class ResidualRamp(NamedTuple):
    """Most significant ramp of tension or torque in the residuals of a fit.

    Attributes:
        score: height of the ramp in standard deviations. The score is positive if the ramp adds
            tension.
        begin: mean joint angle at which the ramp begins [rad].
        end: largest mean joint angle of the sweep [rad].
        rise: tension [N] or joint torque [N m] of the ramp at the angle ``end``.
        rows: number of averaged data points (bins) in the sweep.
        outlier_fraction: fraction of the data points in the sweep that the fit has excluded as outliers.
        mean_square: mean square of the residuals of the sweep, without outliers.
        contact_score: smallest score at which the ramp counts as a contact of the digit.
    """

    score: float
    begin: float
    end: float
    rise: float
    rows: int
    outlier_fraction: float
    mean_square: float
    contact_score: float

    @property
    def is_contact(self) -> bool:
        """Return True if the ramp shows that the digit touched an obstacle."""
        return abs(self.score) >= self.contact_score

    @property
    def excludes_contact(self) -> bool:
        """Return True if the fit explains the sweep well enough to exclude a contact."""
        is_plausible = (
            self.mean_square <= MAX_MEAN_SQUARE_WITHOUT_CONTACT
            and self.outlier_fraction <= MAX_OUTLIERS_WITHOUT_CONTACT
            and self.rows >= MIN_ROWS_WITHOUT_CONTACT
        )
        return abs(self.score) < MAX_SCORE_WITHOUT_CONTACT and is_plausible


def most_significant_ramp(
    jacobian: Array, residual: Array, first_sample: int, angle: Array, unit_vectors: Sequence[Array]
) -> ResidualRamp | None:
    """Return the most significant ramp in the residuals of a fit. Return None if the fit has no sweep.

    Args:
        jacobian: (rows, parameters) Jacobian of the fit. The rows of outliers are zero.
        residual: (rows,) measured minus expected values, in standard deviations.
        first_sample: row at which the sweep begins.
        angle: (m,) mean joint angle in each bin of the sweep [rad].
        unit_vectors: for every kind of ramp, the residuals (m k,) that a tension of 1 N or a torque of 1 N
            m causes, with k rows per bin.
    """
    if not len(angle) or not unit_vectors:
        return None
    count = len(unit_vectors[0])
    rows = slice(first_sample, first_sample + count)
    used_columns = jacobian[rows].any(axis=1)
    if not used_columns.any():
        return None
    # The columns of `basis` span all residual curves that a change of the parameters can explain.
    basis = np.linalg.qr(jacobian)[0]
    low = float(angle.min())
    high = float(angle.max())
    best = (0.0, high, 0.0)
    for start in np.linspace(low, high, RAMP_START_COUNT + 2)[1:-1].tolist():
        if not SWEEP_END_FRACTION < (start - low) / (high - low) < 1.0 - SWEEP_END_FRACTION:
            continue
        shape = (
            np.repeat(np.maximum(0.0, angle - start) / (high - start), count // len(angle))
            * used_columns
        )
        for unit in unit_vectors:
            column = np.zeros(len(residual))
            column[rows] = shape * unit
            # Only the component of the ramp that the parameters cannot explain counts for the
            # score.
            orthogonal_part = column - basis @ (basis.T @ column)
            squared_norm = float(orthogonal_part @ orthogonal_part)
            if squared_norm > MIN_UNEXPLAINED_RAMP_FRACTION * float(column @ column):
                score = float(orthogonal_part @ residual) / squared_norm**0.5
                best = max(
                    best, (score, start, score / squared_norm**0.5), key=lambda ramp: abs(ramp[0])
                )
    mean_square = float(np.mean(residual[rows][used_columns] ** 2))
    contact_score = (
        MIN_CONTACT_SCORE if len(unit_vectors) == 1 else MIN_CONTACT_SCORE_OF_SEVERAL_TENDONS
    )
    return ResidualRamp(
        best[0],
        best[1],
        high,
        best[2],
        len(angle),
        1.0 - float(used_columns.mean()),
        mean_square,
        contact_score,
    )


def are_joints_moving(
    joint_count: int, preload: float, half_width: float, travel: float, full_travel: float
) -> bool:
    """Return True if the preload and the travel of a digit with one tendon show that all joints of the digit move.

    Args:
        joint_count: number of joints of the digit.
        preload: identified preload of the springs, divided by the preload in the hand file.
        half_width: half of the width of the confidence interval of the ratio ``preload``.
        travel: largest excursion of the tendon [m].
        full_travel: excursion of the tendon with all joints at their upper limits [m].
    """
    # The ratio of the preloads is 1 if all n joints move, and (n - 1) / n if one joint is blocked.
    # The limit of the ratio lies halfway between 1 and (n - 1) / n.
    min_fraction = 1.0 - 0.5 / joint_count
    return (
        preload + half_width >= min_fraction
        or travel > full_travel * (joint_count - 1) / joint_count
    )
