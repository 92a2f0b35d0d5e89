"""Digits without return springs, and digits with more tendons than coordinates.

In a digit without springs, antagonistic tendons open the digit. The matrix R B contains the moment
arms of the tendons in the coordinates of a digit. The balance tensions of a digit with more tendons
than coordinates are tensions in the null space of (R B)^T. Balance tensions make no joint torque,
although all of them are above the tension floor. A digit with n coordinates and n + 1 tendons has a
null space of one dimension. A digit with n coordinates and 2 n tendons has a null space of n
dimensions. Source: Lee & Tsai (1991), Salisbury & Craig (1982).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handctl.core.control_law.tension_allocation import tensions_for_torque
from handctl.core.tick_types import Vector
from handctl.hand.digit import DigitModel
from handctl.hand.moment_arms import joint_excursions

BoolArray = NDArray[np.bool_]
MAX_BALANCE_TORQUE_FRACTION = 1e-3
"""Largest allowed torque of balance tensions, as a fraction of the largest tension times the mean moment arm."""


@dataclass(frozen=True, slots=True)
class TendonRedundancy:
    """Directions, balance tensions and excursion ranges of the N tendons of a hand, with shape (N,).

    Attributes:
        closing_sign: 1 for a tendon that is wound while its digit closes, -1 for a tendon that is paid out,
            0 for a spool pair that moves its digit sideways.
        has_return_springs: True if springs move the digit of the tendon back to its lower joint limits.
        has_surplus: True for a tendon of a digit with more tendons than coordinates.
        balance_tension: smallest tensions that make no joint torque, and are all above the tension floor
            [N]. The balance tensions are 0 unless the digit has more tendons than coordinates.
        excursion_at_lower_limits: excursion at the lower joint limits [m].
        excursion_range: (2, N) smallest and largest excursion of each tendon within the joint
            limits [m].
    """

    closing_sign: Vector
    has_return_springs: BoolArray
    has_surplus: BoolArray
    balance_tension: Vector
    excursion_at_lower_limits: Vector
    excursion_range: Vector


def redundancy_of_hand(
    digits: tuple[DigitModel, ...], floor: Vector, ceiling: Vector, is_pair: BoolArray
) -> TendonRedundancy:
    """Compute the directions, the balance tensions and the excursion ranges of all tendons of a hand.

    Args:
        digits: digit models, in file order.
        floor: (N,) smallest tensions [N].
        ceiling: (N,) largest tensions [N].
        is_pair: (N,) True for a spool pair.
    """
    counts = [len(digit.moment_arms) for digit in digits]
    has_surplus_by_digit = [len(digit.moment_arms) > digit.coupling.shape[1] for digit in digits]
    balance = [
        _balance_tensions(digit, floor[digit.tendons], ceiling[digit.tendons])
        if has_surplus
        else np.zeros(count)
        for digit, has_surplus, count in zip(digits, has_surplus_by_digit, counts, strict=True)
    ]
    return TendonRedundancy(
        closing_sign=np.concatenate(
            [tendon_directions(digit, is_pair[digit.tendons]) for digit in digits]
        ),
        has_return_springs=np.repeat([is_opened_by_springs(digit) for digit in digits], counts),
        has_surplus=np.repeat(has_surplus_by_digit, counts),
        balance_tension=np.concatenate(balance),
        excursion_at_lower_limits=np.concatenate(
            [digit.excursion_at_angles(digit.joint_min) for digit in digits]
        ),
        excursion_range=np.concatenate([_excursion_range(digit) for digit in digits], axis=1),
    )


def tendon_directions(digit: DigitModel, is_pair: BoolArray) -> Vector:
    """Return the closing sign of each tendon of a digit (n_t,).

    The closing sign is 1 for a tendon that is wound while the digit closes, -1 for a tendon that is
    paid out, and 0 for a spool pair that moves the digit sideways.
    """
    arms = digit.reduced_moment_arms
    side = np.where(arms.sum(axis=1) < 0.0, -1.0, 1.0)
    if not is_pair.any():
        return side
    return np.where((arms[:, ~digit.sideways_coordinates] != 0.0).any(axis=1), side, 0.0)


def _excursion_range(digit: DigitModel) -> Vector:
    """Return the smallest and largest excursion of each tendon of a digit within the joint limits (2, n_t) [m]."""
    if digit.has_varying_arm:
        end_excursions = joint_excursions(
            digit.arm_polynomials, digit.joint_limits, digit.joint_limits
        )
    else:
        end_excursions = np.stack(
            (digit.moment_arms * digit.joint_min, digit.moment_arms * digit.joint_max)
        )
    return np.stack(
        (end_excursions.min(axis=0).sum(axis=1), end_excursions.max(axis=0).sum(axis=1))
    )


def is_opened_by_springs(digit: DigitModel) -> bool:
    """Return True if springs push every coordinate of a digit towards the lower joint limits."""
    torque = np.asarray(digit.spring_stiffness) * (
        np.asarray(digit.spring_preload) + digit.joint_min
    )
    return bool((digit.coupling.T @ torque > 0.0).all())


def _balance_tensions(digit: DigitModel, floor: Vector, ceiling: Vector) -> Vector:
    """Return the balance tensions of a digit, which make no joint torque (n_t,) [N].

    If the digit has no balance tensions within the bounds, return the smallest allowed tensions.
    """
    arms = digit.reduced_moment_arms
    tension, torque_deficit = tensions_for_torque(arms, np.zeros(arms.shape[1]), floor, ceiling)
    max_torque = MAX_BALANCE_TORQUE_FRACTION * float(tension.max() * np.abs(arms).mean())
    return tension if np.abs(torque_deficit).max() <= max_torque else floor
