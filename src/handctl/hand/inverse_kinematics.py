"""Joint angles that put the tip of a digit at a point of its plane (digit frame, see ``kinematics``)."""

import math

import numpy as np

from handctl.hand.digit import DigitModel
from handctl.hand.kinematics import points, tip_jacobian

SCAN = 64
"""Intervals in which the closest point of a coupled digit's path is bracketed."""
REACH_TOLERANCE = 1e-12
"""Relative square by which a point may be out of reach and still count as on the edge: rounding."""


def inverse(digit: DigitModel, x: float, y: float, angle: float | None = None) -> tuple[tuple[float, ...], ...]:
    """Joint angles that put the tip of a digit of two or three independent joints at a point, in closed form.

    Args:
        digit: the digit.
        x: [m].
        y: [m].
        angle: direction of the last link [rad]; needed for three joints, ignored for two.

    Returns:
        the solutions within one turn, the one that bends the second joint inwards first; none if out of reach
        or, with two equal links, folded onto the base, where the direction is free.
        Joint limits are the caller's concern.

    Raises:
        ValueError: not two or three joints, or three without a direction.
    """
    if digit.joint_count == 2:
        return _two_links(digit.lengths[0], digit.lengths[1], x, y)
    if digit.joint_count != 3 or angle is None:
        raise ValueError(f"{digit.name} has {digit.joint_count} joints; needed: two, or three and a direction")
    l1, l2, l3 = digit.lengths
    wrist = _two_links(l1, l2, x - l3 * math.cos(angle), y - l3 * math.sin(angle))
    return tuple((q1, q2, _wrapped(angle - q1 - q2)) for q1, q2 in wrist)


def inverse_coupled(digit: DigitModel, x: float, y: float) -> tuple[float, float]:
    """Coordinate of a digit with a single one, q = B theta, that brings the tip closest to a point.

    The tip runs on a curve; its points of extreme distance, found by scan and bracketing, and the ends of travel are
    compared, so that the nearest of them all is the answer, not just a local one.

    Args:
        digit: a digit of one reduced coordinate.
        x: [m].
        y: [m].

    Returns:
        theta [rad], within the joint limits, and the distance that remains [m].

    Raises:
        ValueError: the digit has more coordinates.
    """
    if digit.coupling.shape[1] != 1:
        raise ValueError(f"{digit.name} has {digit.coupling.shape[1]} coordinates; needed: one")
    from scipy.optimize import brentq

    ratio, target = digit.coupling[:, 0], np.array([x, y])

    def distance(theta: float) -> float:
        return float(np.linalg.norm(points(digit, ratio * theta)[-1] - target))

    def slope(theta: float) -> float:
        gap = points(digit, ratio * theta)[-1] - target
        return float(gap @ tip_jacobian(digit, ratio * theta) @ ratio)

    grid = np.linspace(*coordinate_limits(digit), SCAN + 1).tolist()
    slopes = [slope(theta) for theta in grid]
    found = [grid[0], grid[-1]]
    for low, high, before, after in zip(grid, grid[1:], slopes, slopes[1:], strict=False):
        if before <= 0.0 <= after:
            found.append(brentq(slope, low, high, xtol=1e-14))
    best = min(found, key=distance)
    return best, distance(best)


def coordinate_limits(digit: DigitModel) -> tuple[float, float]:
    """Range of the single coordinate of a coupled digit in which every joint is within its limits [rad]."""
    low, high = -math.inf, math.inf
    for ratio, least, most in zip(digit.coupling[:, 0], digit.joint_min, digit.joint_max, strict=True):
        if ratio != 0.0:
            first, last = sorted((least / ratio, most / ratio))
            low, high = max(low, first), min(high, last)
    return low, high


def _two_links(l1: float, l2: float, x: float, y: float) -> tuple[tuple[float, float], ...]:
    """Both solutions of two links, one if stretched or folded, none out of reach.

    The elbow angle comes from atan2 of the products (r - |l1 - l2|)(r + |l1 - l2|) and (l1 + l2 - r)(l1 + l2 + r),
    which keeps its accuracy where the arm is nearly straight and acos loses half the digits.
    """
    r = math.hypot(x, y)
    inner, outer = (r - abs(l1 - l2)) * (r + abs(l1 - l2)), (l1 + l2 - r) * (l1 + l2 + r)
    slack = REACH_TOLERANCE * (l1 + l2) ** 2
    if inner < -slack or outer < -slack or r == 0.0:
        return ()
    bend = 2.0 * math.atan2(math.sqrt(max(outer, 0.0)), math.sqrt(max(inner, 0.0)))
    solutions = []
    for q2 in (bend, -bend) if outer > 0.0 and inner > 0.0 else (bend,):
        q1 = math.atan2(y, x) - math.atan2(l2 * math.sin(q2), l1 + l2 * math.cos(q2))
        solutions.append((_wrapped(q1), q2))
    return tuple(solutions)


def _wrapped(angle: float) -> float:
    """The same direction within -pi .. pi."""
    return math.remainder(angle, 2.0 * math.pi)
