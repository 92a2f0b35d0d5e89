"""Inverse kinematics: the joint angles at which the tip of a digit is at a given position."""

import math
from typing import NamedTuple

import numpy as np

from handctl.hand import rigid_body as body
from handctl.hand.digit import Array, DigitModel, JointValues, coordinate_range
from handctl.hand.kinematics import joint_points, tip_jacobian

SCAN_INTERVAL_COUNT = 64
"""Number of intervals in a scan along the path of a coupled digit's tip for the point closest to a target."""
REACH_TOLERANCE = 1e-12
"""Relative tolerance for rounding errors when a squared distance is compared with the squared reach."""
MAX_SEARCH_STEPS = 60
"""Largest number of steps in the search for the closest tip position."""
MIN_SEARCH_STEP_RAD = 1e-10
"""Largest change of a coordinate in the last step of a search [rad]."""
START_DISTANCE_WEIGHT_M_PER_RAD = 1e-5
"""Weight of the distance from the start coordinates [m/rad].

Of all postures with the same tip position, the weight selects the posture nearest to the start
coordinates.
"""
DAMPING_RANGE = (1e-8, 1e8)
"""Smallest and largest damping of a Levenberg-Marquardt step, relative to the largest curvature."""
START_COORDINATE_FRACTIONS = (0.5, 0.15, 0.85)
"""Start coordinates of a search without a given start posture, as fractions of the coordinates' ranges."""


class ClosestTip(NamedTuple):
    """Posture of a digit in which the tip is as close to a given point as the joint limits allow.

    Attributes:
        coordinates: (n_c,) coordinates of the digit within the limits [rad].
        distance: distance from the tip to the point [m].
    """

    coordinates: Array
    distance: float


def inverse_kinematics(
    digit: DigitModel, x: float, y: float, angle: float | None = None
) -> tuple[tuple[float, ...], ...]:
    """Return the joint angles of a digit with two or three independent joints for a given position of its tip.

    All hinges of the digit must be parallel, so that the tip moves in the x-y plane of the digit's
    frame and the solution has a closed form. The function does not apply the joint limits.

    Args:
        digit: model of the digit.
        x: position of the point along x of the digit's frame [m].
        y: position of the point along y of the digit's frame [m].
        angle: direction of the last link [rad], required for three joints, ignored for two.

    Returns:
        the solutions within one turn, first the solution with positive flexion of the second joint.
        The tuple is empty if the point is out of reach. The tuple is also empty if two equal links
        fold onto the base, because the direction of the folded links is not determined.

    Raises:
        ValueError: the digit has neither two nor three joints, its hinges are not parallel, or it
            has three joints and no direction is given.
    """
    if not _is_planar(digit):
        raise ValueError(
            f"{digit.name} has joints that are not hinges along z; needed: parallel hinges"
        )
    if digit.joint_count == 2:
        return _two_link_solutions(digit.lengths[0], digit.lengths[1], x, y)
    if digit.joint_count != 3 or angle is None:
        raise ValueError(
            f"{digit.name} has {digit.joint_count} joints; needed: two, or three and a direction"
        )
    l1, l2, l3 = digit.lengths
    two_link_solutions = _two_link_solutions(
        l1, l2, x - l3 * math.cos(angle), y - l3 * math.sin(angle)
    )
    return tuple((q1, q2, _wrapped_angle(angle - q1 - q2)) for q1, q2 in two_link_solutions)


def inverse_kinematics_coupled(digit: DigitModel, position: JointValues) -> tuple[float, float]:
    """Return the coordinate theta at which the tip of a coupled digit is closest to a point.

    The digit has a single coordinate theta, and its joint angles are q = B theta. The tip therefore
    moves on a curve. A scan finds all intervals of the curve that contain a minimum of the
    distance. The curve is closest to the given point either at a minimum of the distance or at an
    end of the curve.

    Args:
        digit: model of a digit that has a single coordinate.
        position: (3,) point in the palm frame [m].

    Returns:
        theta [rad] within the joint limits, and the remaining distance from the tip to the point
        [m].

    Raises:
        ValueError: the digit has several coordinates.
    """
    if digit.coupling.shape[1] != 1:
        raise ValueError(f"{digit.name} has {digit.coupling.shape[1]} coordinates; needed: one")
    from scipy.optimize import brentq

    ratio = digit.coupling[:, 0]
    target = np.asarray(position, dtype=np.float64)

    def distance(coordinate: float) -> float:
        return float(np.linalg.norm(joint_points(digit, ratio * coordinate)[-1] - target))

    def slope(coordinate: float) -> float:
        gap = joint_points(digit, ratio * coordinate)[-1] - target
        return float(gap @ tip_jacobian(digit, ratio * coordinate) @ ratio)

    grid = np.linspace(*coordinate_limits(digit), SCAN_INTERVAL_COUNT + 1).tolist()
    slope_values = [slope(theta) for theta in grid]
    candidates = [grid[0], grid[-1]]
    for low, high, low_slope, high_slope in zip(
        grid, grid[1:], slope_values, slope_values[1:], strict=False
    ):
        # The distance from the tip to the point has a minimum where its slope changes from negative
        # to positive.
        if low_slope <= 0.0 <= high_slope:
            candidates.append(brentq(slope, low, high, xtol=1e-14))
    closest_candidate = min(candidates, key=distance)
    return closest_candidate, distance(closest_candidate)


def coordinate_limits(digit: DigitModel) -> tuple[float, float]:
    """Return the range [rad] in which the single coordinate of a coupled digit satisfies all joint limits."""
    low, high = coordinate_range(digit.coupling, np.array([digit.joint_min, digit.joint_max]))[
        :, 0
    ].tolist()
    return low, high


def _is_planar(digit: DigitModel) -> bool:
    """Return True if all hinges of a digit are parallel to the z axis of the digit's frame."""
    rotation_at_zero = (
        digit.table[body.FIXED_ROTATION_ROW : body.COSINE_ROTATION_ROW]
        + digit.table[body.COSINE_ROTATION_ROW : body.SINE_ROTATION_ROW]
    )
    rotation_of_straight_digit = (
        np.array([digit.mount_rotation, *[np.eye(3)] * (digit.joint_count - 1)]).reshape(-1, 9).T
    )
    return bool(
        not digit.is_prismatic.any()
        and np.all(digit.axes == (0.0, 0.0, 1.0))
        and np.allclose(rotation_at_zero, rotation_of_straight_digit, rtol=0.0, atol=1e-12)
    )


def _two_link_solutions(
    l1: float, l2: float, x: float, y: float
) -> tuple[tuple[float, float], ...]:
    """Return the joint angles at which the end of a chain of two links is at a point.

    In general, there are two solutions. There is one solution if the links are stretched or folded,
    and none if the point is out of reach.

    Let r be the distance from the first joint to the point. The angle of the second joint is 2
    atan2(sqrt(a), sqrt(b)). Here, a is (l1 + l2 - r)(l1 + l2 + r), and b is (r - |l1 - l2|)(r + |l1
    - l2|). The products a and b are accurate even near the stretched posture, where acos would lose
    half of the significant digits.
    """
    r = math.hypot(x, y)
    fold_margin = (r - abs(l1 - l2)) * (r + abs(l1 - l2))
    stretch_margin = (l1 + l2 - r) * (l1 + l2 + r)
    tolerance = REACH_TOLERANCE * (l1 + l2) ** 2
    if fold_margin < -tolerance or stretch_margin < -tolerance or r == 0.0:
        return ()
    elbow_angle = 2.0 * math.atan2(
        math.sqrt(max(stretch_margin, 0.0)), math.sqrt(max(fold_margin, 0.0))
    )
    solutions = []
    for q2 in (
        (elbow_angle, -elbow_angle)
        if stretch_margin > 0.0 and fold_margin > 0.0
        else (elbow_angle,)
    ):
        q1 = math.atan2(y, x) - math.atan2(l2 * math.sin(q2), l1 + l2 * math.cos(q2))
        solutions.append((_wrapped_angle(q1), q2))
    return tuple(solutions)


def _wrapped_angle(angle: float) -> float:
    """Return the equivalent angle in the range from -pi to pi."""
    return math.remainder(angle, 2.0 * math.pi)


def closest_tip(
    digit: DigitModel, position: JointValues, start_angles: JointValues | None = None
) -> ClosestTip:
    """Return the coordinates within the joint limits at which the tip of a digit is closest to a point.

    The search uses Levenberg-Marquardt steps, and moves only coordinates that are not at a limit
    (projected Gauss-Newton). Because the search finds a local minimum, a motion has no jump if each
    search starts at the previous posture. The digit can have any number of hinges with any
    directions, either coupled or independent.

    Args:
        digit: model of a digit that is mounted on the palm.
        position: (3,) point in the palm frame [m].
        start_angles: (n_c,) coordinates at which the search starts [rad]. With None, searches start
            at several postures, and the function returns the best result.

    Source: Nocedal & Wright (2006), Numerical Optimization, 10.3 and 16.7.
    """
    target = np.asarray(position, dtype=np.float64)
    low, high = digit.coordinate_limits
    if start_angles is None:
        locally_closest_tips = [
            _locally_closest_tip(digit, target, low + range_fraction * (high - low))
            for range_fraction in START_COORDINATE_FRACTIONS
        ]
        return min(locally_closest_tips, key=lambda tip: tip.distance)
    return _locally_closest_tip(
        digit, target, np.clip(np.asarray(start_angles, dtype=np.float64), low, high)
    )


def _locally_closest_tip(
    digit: DigitModel, target_point: Array, start_coordinates: Array
) -> ClosestTip:
    """Search from the start coordinates for a posture with a local minimum of the distance, and return this posture."""
    low, high = digit.coordinate_limits
    theta = start_coordinates.copy()
    gap = joint_points(digit, digit.coupling @ theta)[-1] - target_point
    cost = float(gap @ gap)
    damping = 1e-3
    for _ in range(MAX_SEARCH_STEPS):
        jacobian = tip_jacobian(digit, digit.coupling @ theta) @ digit.coupling
        slope = jacobian.T @ gap + START_DISTANCE_WEIGHT_M_PER_RAD**2 * (theta - start_coordinates)
        is_free = ~(((theta <= low) & (slope > 0.0)) | ((theta >= high) & (slope < 0.0)))
        if not is_free.any():
            break
        curvature = jacobian[:, is_free].T @ jacobian[
            :, is_free
        ] + START_DISTANCE_WEIGHT_M_PER_RAD**2 * np.eye(int(is_free.sum()))
        scale = float(curvature.diagonal().max())
        next_coordinates = theta
        while damping < DAMPING_RANGE[1]:
            trial_coordinates = theta.copy()
            trial_coordinates[is_free] -= np.linalg.solve(
                curvature + damping * scale * np.eye(len(curvature)), slope[is_free]
            )
            trial_coordinates = np.clip(trial_coordinates, low, high)
            distance_vector = (
                joint_points(digit, digit.coupling @ trial_coordinates)[-1] - target_point
            )
            start_distance_cost = (
                START_DISTANCE_WEIGHT_M_PER_RAD * (trial_coordinates - start_coordinates)
            ) @ (START_DISTANCE_WEIGHT_M_PER_RAD * (trial_coordinates - start_coordinates))
            if (
                present_cost := float(distance_vector @ distance_vector + start_distance_cost)
            ) < cost:
                next_coordinates = trial_coordinates
                gap = distance_vector
                cost = present_cost
                damping = max(0.1 * damping, DAMPING_RANGE[0])
                break
            damping *= 10.0
        step = float(np.abs(next_coordinates - theta).max())
        theta = next_coordinates
        if step < MIN_SEARCH_STEP_RAD:
            break
    return ClosestTip(theta, float(np.linalg.norm(gap)))
