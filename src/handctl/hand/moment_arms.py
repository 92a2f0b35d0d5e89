"""Moment arms of tendons at joints. A moment arm is constant, or a polynomial of the joint angle.

All moment arms are stored as polynomials r(q) of the same fixed degree. The excursion of a tendon
at a joint is the exact integral of r from 0 to q. Outside of the joint's range, the moment arm
equals the moment arm at the nearer joint limit. A polynomial is thus evaluated only inside the
range of the joint. The excursion is therefore monotonic for all joint angles. A table of measured
moment arms becomes the least-squares polynomial of degree ``MOMENT_ARM_FIT_DEGREE``.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handctl.hand.file.quantity_types import POLYNOMIAL_COEFFICIENTS

Array = NDArray[np.float64]
MomentArm = float | Mapping[str, Sequence[float]]
"""Moment arm in a hand file: a number, ``{"polynomial_m": ...}``, or ``{"angle_deg": ..., "arm_m": ...}``."""

MOMENT_ARM_FIT_DEGREE = 3
"""Degree of the polynomial that replaces a table of moment arms, if the table has enough entries."""


def moment_arm_polynomial(arm: MomentArm) -> Array:
    """Return the coefficients (POLYNOMIAL_COEFFICIENTS,) of a moment arm as a polynomial of the angle in rad.

    The first coefficient is the constant term of the polynomial.

    Args:
        arm: valid moment arm from a hand file.
    """
    result = np.zeros(POLYNOMIAL_COEFFICIENTS)
    if not isinstance(arm, Mapping):
        result[0] = arm
        return result
    if "polynomial_m" in arm:
        coefficients = np.asarray(arm["polynomial_m"])
    else:
        angle, values = moment_arm_table(arm)
        coefficients = np.polynomial.polynomial.polyfit(
            angle, values, min(MOMENT_ARM_FIT_DEGREE, len(angle) - 1)
        )
    result[: len(coefficients)] = coefficients
    return result


def moment_arm_table(arm: MomentArm) -> tuple[Array, Array]:
    """Return the angles (k,) [rad] and the moment arms (k,) [m] of a table of moment arms.

    For a moment arm that is not a table, both arrays are empty (k = 0).
    """
    if not isinstance(arm, Mapping) or "angle_deg" not in arm:
        return np.zeros(0), np.zeros(0)
    return np.radians(arm["angle_deg"]), np.asarray(arm["arm_m"], dtype=np.float64)


def moment_arm_table_residual(arm: MomentArm) -> float:
    """Return the largest difference [m] between a table of moment arms and the polynomial fitted to it.

    For a moment arm that is not a table, the difference is 0.
    """
    angle, values = moment_arm_table(arm)
    fitted_moment_arms = np.polynomial.polynomial.polyval(angle, moment_arm_polynomial(arm))
    return float(np.abs(fitted_moment_arms - values).max(initial=0.0))


def is_moment_arm_varying(arm: MomentArm) -> bool:
    """Return True if a moment arm in a hand file is a polynomial or a table.

    Return False if the moment arm is a number.
    """
    return isinstance(arm, Mapping)


def moment_arms_at(arm_polynomials: Array, joint_limits: Array, q: ArrayLike) -> Array:
    """Return the moment arms R (..., n_t, n) [m] at given joint angles.

    Args:
        arm_polynomials: (n_t, n, POLYNOMIAL_COEFFICIENTS) moment arms as polynomials.
        joint_limits: (2, n) smallest and largest joint angles [rad].
        q: (..., n) joint angles [rad].
    """
    clipped_angles = np.clip(np.asarray(q, dtype=np.float64), joint_limits[0], joint_limits[1])[
        ..., None, :
    ]
    return _evaluate_polynomials(arm_polynomials, clipped_angles)


def joint_excursions(arm_polynomials: Array, joint_limits: Array, q: ArrayLike) -> Array:
    """Return the excursion (..., n_t, n) [m] of each tendon at each joint.

    The excursion is the integral of the moment arm over the joint angle.

    Args:
        arm_polynomials: (n_t, n, POLYNOMIAL_COEFFICIENTS) moment arms as polynomials.
        joint_limits: (2, n) smallest and largest joint angles [rad].
        q: (..., n) joint angles [rad].
    """
    angles = np.asarray(q, dtype=np.float64)[..., None, :]
    clipped_angles = np.clip(angles, joint_limits[0], joint_limits[1])
    integral = clipped_angles * _evaluate_polynomials(
        arm_polynomials / np.arange(1.0, POLYNOMIAL_COEFFICIENTS + 1.0), clipped_angles
    )
    return integral + (angles - clipped_angles) * _evaluate_polynomials(
        arm_polynomials, clipped_angles
    )


def mean_moment_arm(arm: MomentArm, min_angle: float, max_angle: float) -> float:
    """Return the mean [m] of a moment arm over the range of the joint.

    For a constant moment arm, the mean is the moment arm itself.

    Args:
        arm: valid moment arm from a hand file.
        min_angle: smallest joint angle [rad].
        max_angle: largest joint angle [rad].
    """
    if not isinstance(arm, Mapping):
        return arm
    end_excursions = joint_excursions(
        moment_arm_polynomial(arm)[None, None],
        np.array([[min_angle], [max_angle]]),
        [[min_angle], [max_angle]],
    )
    return float(end_excursions[1, 0, 0] - end_excursions[0, 0, 0]) / (max_angle - min_angle)


def _evaluate_polynomials(arm_polynomials: Array, q: Array) -> Array:
    """Evaluate polynomials (n_t, n, POLYNOMIAL_COEFFICIENTS) at angles (..., 1, n) by Horner's method."""
    value = np.zeros(np.broadcast_shapes(arm_polynomials.shape[:2], q.shape))
    for order in range(POLYNOMIAL_COEFFICIENTS - 1, -1, -1):
        value = value * q + arm_polynomials[..., order]
    return value
