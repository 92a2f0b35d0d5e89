"""Range in which digits move without touching the other digits of their hand."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from handctl.hand.description import Hand
from handctl.hand.digit import Array, DigitModel
from handctl.hand.link_tree import LinkTree

CONTACT_DISTANCE_M = 0.002
"""Distance between the surfaces of two links below which the links can touch during a sweep [m]."""
CLEARANCE_M = 0.004
"""Distance of two links at the end of a sweep that would otherwise lead to a contact [m].

A fast sweep overshoots its end by about one degree.
"""
POINTS_PER_LINK = 13
"""Number of points on the axis of a link for which the distance to other links is computed."""
STEP_COUNT = 60
"""Number of postures between the two ends of a sweep for which the distance is computed."""


def highest_clear_coordinates(hand: Hand, name: str, low: Array, high: Array) -> Array:
    """Return the highest coordinates (n_c,) of a sweep in which a digit touches no other digit [rad].

    All coordinates of the digit change together from ``low`` to ``high``, and all other digits are
    open.

    Args:
        hand: description of the hand.
        name: name of the digit.
        low: coordinates (n_c,) at the low end of the sweep [rad].
        high: coordinates (n_c,) at the high end of the sweep [rad].
    """
    return low + _clear_fraction(hand, {name: (low, high)}) * (high - low)


def highest_clear_angle(
    hand: Hand, scales_of_digit: Mapping[str, Array], low: float, high: float
) -> float:
    """Return the highest angle to which digits can move together without touching a digit [rad].

    Digits that are not in ``scales_of_digit`` stay open.

    Args:
        hand: description of the hand.
        scales_of_digit: for each moving digit, the ratio (n_c,) between each coordinate and the angle.
        low: angle at the start of the move [rad].
        high: angle at the end of the move [rad].
    """
    fraction = _clear_fraction(
        hand, {name: (low * scales, high * scales) for name, scales in scales_of_digit.items()}
    )
    return low + fraction * (high - low)


def _clear_fraction(hand: Hand, ends_of_digit: Mapping[str, tuple[Array, Array]]) -> float:
    """Return the largest fraction of a common motion in which the moving digits touch no digit.

    Two links that are close together at the start of the motion are neighbours, and are ignored.

    Args:
        hand: description of the hand.
        ends_of_digit: for each moving digit, its coordinates at the start and at the end of the
            motion [rad].
    """
    models = {name: DigitModel.from_hand(hand, name) for name in ends_of_digit}
    tree = LinkTree.from_hand(hand)
    q = np.clip(np.zeros(len(hand.joints)), *hand.joint_limits)

    def distances(fraction: float) -> Array:
        for name, (start, end) in ends_of_digit.items():
            digit = models[name]
            q[digit.joints] = digit.coupling @ (start + fraction * (end - start))
        link_axes = [_points_on_links(joint_positions) for joint_positions in tree.points(q)]
        return np.concatenate(
            [
                _distances_to_other_digits(tree, link_axes, hand.digit_names.index(name)).ravel()
                for name in ends_of_digit
            ]
        )

    is_judged = distances(0.0) > CLEARANCE_M
    largest_fraction = 0.0
    for fraction in np.linspace(0.0, 1.0, STEP_COUNT + 1).tolist():
        smallest_distance = distances(fraction)[is_judged].min(initial=math.inf)
        if smallest_distance < CONTACT_DISTANCE_M:
            return largest_fraction
        if smallest_distance > CLEARANCE_M:
            largest_fraction = fraction
    return 1.0


def _distances_to_other_digits(
    tree: LinkTree, link_axes: Sequence[Array], digit_index: int
) -> Array:
    """Return the distances between the surfaces of the links of a digit and the links of all other digits [m].

    The result has one row for each link of the digit, and one column for each link of the other
    digits. Links are capsules.

    Args:
        tree: link tree of the hand.
        link_axes: for each digit, points (n, POINTS_PER_LINK, 3) on the axes of its links [m].
        digit_index: index of the digit.
    """
    radii = [digit.radius for digit in tree.digits]
    columns = [
        np.linalg.norm(
            link_axes[digit_index][:, None, :, None, :] - link_axes[i][None, :, None, :, :], axis=-1
        ).min(axis=(2, 3))
        - radii[digit_index]
        - radii[i]
        for i in range(len(radii))
        if i != digit_index
    ]
    empty_columns = np.empty((len(link_axes[digit_index]), 0))
    return np.concatenate([empty_columns, *columns], axis=1)


def _points_on_links(joint_positions: Array) -> Array:
    """Return points (n, POINTS_PER_LINK, 3) on the axes of n links, given the ends (n + 1, 3) of the links [m]."""
    fractions = np.linspace(0.0, 1.0, POINTS_PER_LINK)[:, None]
    starts, ends = joint_positions[:-1, None, :], joint_positions[1:, None, :]
    return np.asarray(starts + fractions * (ends - starts))
