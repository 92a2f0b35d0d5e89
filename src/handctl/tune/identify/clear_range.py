"""Range in which a digit moves without touching the other digits of its hand."""

import math

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
POINTS_PER_LINK = 21
"""Number of points on the axis of a link for which the distance to other links is computed."""
STEP_COUNT = 100
"""Number of postures between the two ends of a sweep for which the distance is computed."""


def highest_clear_coordinates(hand: Hand, name: str, low: Array, high: Array) -> Array:
    """Return the highest coordinates (n_c,) of a sweep in which a digit touches no other digit [rad].

    All coordinates of the digit change together from ``low`` to ``high``, and all other digits are
    open. Two links that are close together at the low end of the sweep are neighbours, and are
    ignored.

    Args:
        hand: description of the hand.
        name: name of the digit.
        low: coordinates (n_c,) at the low end of the sweep [rad].
        high: coordinates (n_c,) at the high end of the sweep [rad].
    """
    digit = DigitModel.from_hand(hand, name)
    tree = LinkTree.from_hand(hand)
    digit_index = hand.digit_names.index(name)
    q = np.clip(np.zeros(len(hand.joints)), *hand.joint_limits)

    def distances(coordinates: Array) -> Array:
        q[digit.joints] = digit.coupling @ coordinates
        return _distances_to_other_digits(tree, q, digit_index)

    is_judged = distances(low) > CLEARANCE_M
    highest = low
    for fraction in np.linspace(0.0, 1.0, STEP_COUNT + 1):
        coordinates = low + fraction * (high - low)
        smallest_distance = distances(coordinates)[is_judged].min(initial=math.inf)
        if smallest_distance < CONTACT_DISTANCE_M:
            return highest
        if smallest_distance > CLEARANCE_M:
            highest = coordinates
    return high


def _distances_to_other_digits(tree: LinkTree, q: Array, digit_index: int) -> Array:
    """Return the distance of the surfaces of each link of a digit and each link of all other digits [m].

    The result has one row for each link of the digit, and one column for each link of the other
    digits. Links are capsules.
    """
    link_axes = [_points_on_links(joint_positions) for joint_positions in tree.points(q)]
    radii = [digit.radius for digit in tree.digits]
    other_indices = [i for i in range(len(radii)) if i != digit_index]
    columns = [
        np.linalg.norm(
            link_axes[digit_index][:, None, :, None, :] - link_axes[i][None, :, None, :, :], axis=-1
        ).min(axis=(2, 3))
        - radii[digit_index]
        - radii[i]
        for i in other_indices
    ]
    empty_columns = np.empty((len(link_axes[digit_index]), 0))
    return np.concatenate([empty_columns, *columns], axis=1)


def _points_on_links(joint_positions: Array) -> Array:
    """Return points (n, POINTS_PER_LINK, 3) on the axes of n links, given the ends (n + 1, 3) of the links [m]."""
    fractions = np.linspace(0.0, 1.0, POINTS_PER_LINK)[:, None]
    starts, ends = joint_positions[:-1, None, :], joint_positions[1:, None, :]
    return np.asarray(starts + fractions * (ends - starts))
