"""Motion along streamed targets.

The motion to the latest target is interpolated, and its speed and acceleration are limited. A
segment of the motion is a polynomial of time for each coordinate. When a target arrives, a segment
begins at the present reference position, and ends at the new target. After the end of a segment,
the reference position stays at the target, because targets are not extrapolated.

The reference position follows the segment exactly if speed and acceleration stay within their
limits. If the segment exceeds a limit, the reference position approaches the target as fast as the
limits allow. At the target, the rate of the reference position is the rate at which the targets
change, within a limit. Near the end of a joint's range, the speed towards the end of the range is
limited, so that the motion can stop before the end. The reference position is never more than
``MAX_LEAD_RAD`` ahead of the digit. If an object holds a digit, the reference position waits ahead
of the digit. If an object pushes a digit away, the reference position follows the digit.
"""

import math

from handctl.compiled import kernel, kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import ConstantTables
from handctl.core.state_block import StateTables, state_tables
from handctl.core.tick_types import Vector

MAX_LEAD_RAD = math.radians(8.0)
"""Largest distance of the reference from the estimated position of the digit [rad], at full stiffness.

If an object holds the digit, the reference position waits at the distance ``MAX_LEAD_RAD``, so that
the digit does not jump when the object releases it.
"""
MIN_STIFFNESS_FRACTION = 0.05
"""Smallest divisor of ``MAX_LEAD_RAD``.

The divisor of ``MAX_LEAD_RAD`` is the stiffness fraction of the digit, but at least
``MIN_STIFFNESS_FRACTION``. An object can push a softer digit further away from the reference
position.
"""
RATE_LIMIT_TOLERANCE = 1e-9
"""Relative tolerance of the rate limits, for rounding errors."""
CLIP_TOLERANCE = 1e-9
"""Difference between requested and used target above which the target counts as clipped [rad, N]."""


@kernel("block", "layout", "vector", "vector", "real", "real", "real", "real", "count")
def begin_segments(
    block: BlockArray,
    at: TableOffsets,
    target_coordinates: Vector,
    holdable_coordinates: Vector,
    since: float,
    duration: float,
    target_interval: float,
    max_rate: float,
    minimum_jerk: int,
) -> bool:
    """Begin the motion of all coordinates from the reference positions to a target.

    Return True if the target was changed because it exceeds the limits.

    Args:
        block: state block, modified in place.
        at: ``BlockLayout.offsets`` of the state block.
        target_coordinates: (C,) requested coordinates [rad].
        holdable_coordinates: (C,) coordinates that the hand can hold with taut tendons, as near as
            possible to the present coordinates [rad].
        since: start of the motion [s].
        duration: duration of the motion [s].
        target_interval: time between the target and the previous target [s]. If the interval of the
            targets is infinite, the motion ends at rest.
        max_rate: largest allowed rate of a coordinate at the target [rad/s].
        minimum_jerk: 1 for a motion of minimum jerk, 0 for a motion at constant rate.
    """
    x = state_tables(block, at)
    clipped = False
    for k in range(x.coordinate.shape[1]):
        low, high = x.coordinate[s.STREAM_RANGE, k], x.coordinate[s.STREAM_RANGE + 1, k]
        target = min(max(holdable_coordinates[k], low), high)
        clipped |= abs(target - target_coordinates[k]) > CLIP_TOLERANCE
        rate = min(
            max((target - x.coordinate[s.STREAM_TARGET, k]) / target_interval, -max_rate), max_rate
        )
        _write_segment(x, k, target, rate, duration, minimum_jerk == 1)
        x.coordinate[s.STREAM_TARGET_RATE, k] = rate
        x.coordinate[s.STREAM_TARGET, k] = target
    x.run[s.STREAM_SEGMENT_START] = since
    x.run[s.STREAM_DURATION] = duration
    return clipped


@kernel_helper
def _write_segment(
    x: StateTables, k: int, target: float, speed: float, duration: float, minimum_jerk: bool
) -> None:
    """Write the polynomial for the motion of a coordinate to a target [rad, s].

    The coefficient of the lowest power is written first. A motion of minimum jerk begins with the
    position, rate and acceleration of the present reference. The motion of minimum jerk ends at the
    target with the given rate. The acceleration at the end of the motion is not prescribed, so the
    jerk is 0 at the end. If the time u remains until the end of the motion, the jerk is b u + c
    u^2. The linear motion has a constant rate.

    Args:
        x: state tables.
        k: index of the coordinate.
        target: position at the end of the motion [rad].
        speed: rate at the end of a motion of minimum jerk [rad/s].
        duration: duration T of the motion [s].
        minimum_jerk: True for a motion of minimum jerk, False for a linear motion.
    """
    position = x.coordinate[s.TRAJECTORY, k]
    rate = x.coordinate[s.TRAJECTORY + 1, k]
    acceleration = x.coordinate[s.TRAJECTORY + 2, k]
    for power in range(6):
        x.coordinate[s.STREAM_SEGMENT + power, k] = 0.0
    x.coordinate[s.STREAM_SEGMENT, k] = position
    if not minimum_jerk:
        x.coordinate[s.STREAM_SEGMENT + 1, k] = (target - position) / duration
        return
    duration_squared = duration * duration
    missing_distance = target - position - duration * rate - 0.5 * duration_squared * acceleration
    missing_rate = speed - rate - duration * acceleration
    b = (
        480.0
        * (missing_rate * duration / 10.0 - missing_distance / 4.0)
        / (duration_squared * duration_squared)
    )
    c = (
        480.0
        * (missing_distance / 3.0 - missing_rate * duration / 8.0)
        / (duration_squared * duration_squared * duration)
    )
    x.coordinate[s.STREAM_SEGMENT + 1, k] = rate
    x.coordinate[s.STREAM_SEGMENT + 2, k] = 0.5 * acceleration
    x.coordinate[s.STREAM_SEGMENT + 3, k] = (b * duration + c * duration_squared) / 6.0
    x.coordinate[s.STREAM_SEGMENT + 4, k] = -(b + 2.0 * c * duration) / 24.0
    x.coordinate[s.STREAM_SEGMENT + 5, k] = c / 60.0


@kernel_helper
def position_on_segment(x: StateTables, k: int, t: float) -> tuple[float, float]:
    """Return position [rad] and rate [rad/s] of a coordinate on the present segment at time t [s]."""
    time_in_segment = t - x.run[s.STREAM_SEGMENT_START]
    if time_in_segment >= x.run[s.STREAM_DURATION]:
        return x.coordinate[s.STREAM_TARGET, k], 0.0
    position = rate = 0.0
    for power in range(5, -1, -1):  # Horner's scheme evaluates the polynomial and its derivative
        rate = rate * time_in_segment + position
        position = position * time_in_segment + x.coordinate[s.STREAM_SEGMENT + power, k]
    return position, rate


@kernel_helper
def advance_reference(x: StateTables, c: ConstantTables, d: int, k: int) -> None:
    """Move the reference position of a streamed coordinate from the last tick to the present tick.

    Args:
        x: state tables, with the reference position of the last tick in ``TRAJECTORY``.
        c: constants of the hand.
        d: index of the digit.
        k: index of the coordinate.
    """
    period = c.run[h.CONTROL_PERIOD] * (1 + x.run_int[s.MISSED_TICKS])
    position = x.coordinate[s.TRAJECTORY, k]
    rate = x.coordinate[s.TRAJECTORY + 1, k]
    scale = coordinate_scale(c, d, k)
    gain = c.run[h.STREAM_ACCELERATION] * period * scale
    slowest, fastest = _allowed_rates(x, c, d, k, period, scale, gain)
    now = x.run_int[s.TICK_TIME_NS] / 1e9
    candidate_position, candidate_rate = position_on_segment(x, k, now)
    remaining = max(x.run[s.STREAM_SEGMENT_START] + x.run[s.STREAM_DURATION] - now, 0.0)
    target_rate = x.coordinate[s.STREAM_TARGET_RATE, k] if remaining > 0.0 else 0.0
    # The moving target moves at the rate of the latest target, and reaches the latest target at the
    # end of the segment.
    moving_target = x.coordinate[s.STREAM_TARGET, k] - target_rate * remaining
    mean = (candidate_position - position) / period
    max_rate_change = gain * (1.0 + RATE_LIMIT_TOLERANCE)
    is_within_limits = (
        abs(mean - rate) <= max_rate_change and abs(candidate_rate - rate) <= max_rate_change
    )
    is_within_limits &= (
        slowest - gain * RATE_LIMIT_TOLERANCE <= min(mean, candidate_rate)
        and max(mean, candidate_rate) <= fastest + gain * RATE_LIMIT_TOLERANCE
    )
    is_within_limits &= (
        abs(candidate_rate - target_rate)
        <= max_stoppable_speed(abs(moving_target - candidate_position), gain, period)
        + max_rate_change
    )
    new_rate = candidate_rate
    if not is_within_limits:
        x.run_int[s.LIMITED_COORDINATE_COUNT] += 1
        distance_to_target = moving_target - position - target_rate * period
        required_rate = min(
            max(target_rate + _stoppable_speed_towards(distance_to_target, gain, period), slowest),
            fastest,
        )
        new_rate = rate + min(max(required_rate - rate, -gain), gain)
        candidate_position = position + new_rate * period
    x.coordinate[s.TRAJECTORY, k] = candidate_position
    x.coordinate[s.TRAJECTORY + 1, k] = new_rate
    x.coordinate[s.TRAJECTORY + 2, k] = (new_rate - rate) / period


@kernel_helper
def coordinate_scale(c: ConstantTables, d: int, k: int) -> float:
    """Return the factor that converts a limit in rad to the unit of coordinate k of digit d.

    The factor is 1 for hinges, and less than 1 for prismatic joints.
    """
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        if c.joint_coordinate_table[h.JOINT_COUPLING, j, k] != 0.0:
            return c.joint[h.JOINT_SCALE, j]
    return 1.0


@kernel_helper
def _allowed_rates(
    x: StateTables, c: ConstantTables, d: int, k: int, period: float, scale: float, gain: float
) -> tuple[float, float]:
    """Return the lowest and the highest allowed rate of a coordinate's reference [rad/s].

    The speed limit, the range of the coordinate, and the distance of the reference from the digit
    determine the lowest and the highest rate.

    Args:
        x: state tables.
        c: constants of the hand.
        d: index of the digit.
        k: index of the coordinate.
        period: time since the last tick [s].
        scale: factor that converts a limit in rad to the unit of the coordinate, see
            ``coordinate_scale``.
        gain: largest change of the rate within the period [rad/s].
    """
    position = x.coordinate[s.TRAJECTORY, k]
    max_rate = c.run[h.STREAM_SPEED] * scale
    slowest = max(
        -max_rate, -max_stoppable_speed(position - x.coordinate[s.STREAM_RANGE, k], gain, period)
    )
    fastest = min(
        max_rate, max_stoppable_speed(x.coordinate[s.STREAM_RANGE + 1, k] - position, gain, period)
    )
    max_lead = (
        scale
        * MAX_LEAD_RAD
        / max(
            x.tendon[s.STIFFNESS_FRACTION, c.digit_int[h.FIRST_TENDON, d]], MIN_STIFFNESS_FRACTION
        )
    )
    digit, digit_rate = _estimated_coordinate(x, c, d, k)
    fastest_backward = _stoppable_speed_towards(digit - max_lead - position, gain, period) + min(
        digit_rate, 0.0
    )
    fastest_forward = _stoppable_speed_towards(digit + max_lead - position, gain, period) + max(
        digit_rate, 0.0
    )
    slowest = max(slowest, min(fastest_backward, fastest))
    return slowest, min(fastest, max(fastest_forward, slowest))


@kernel_helper
def _estimated_coordinate(x: StateTables, c: ConstantTables, d: int, k: int) -> tuple[float, float]:
    """Return position [rad] and rate [rad/s] of a coordinate, computed from the estimated joint angles."""
    position = rate = squared_coupling = 0.0
    for j in range(c.digit_int[h.FIRST_JOINT, d], c.digit_int[h.END_JOINT, d]):
        coupling = c.joint_coordinate_table[h.JOINT_COUPLING, j, k]
        position += coupling * x.joint[s.Q, j]
        rate += coupling * x.joint[s.DQ, j]
        squared_coupling += coupling * coupling
    return position / squared_coupling, rate / squared_coupling


@kernel_helper
def _stoppable_speed_towards(distance: float, gain: float, period: float) -> float:
    """Return the largest speed towards a point that still allows a stop at this point [rad/s].

    The speed has the sign of the distance.
    """
    return math.copysign(max_stoppable_speed(abs(distance), gain, period), distance)


@kernel_helper
def max_stoppable_speed(distance: float, gain: float, period: float) -> float:
    """Return the largest speed that still allows a stop within a distance [rad/s].

    In each control period T, the speed falls by at most g. The present speed is written as w = n g
    + r, where n is an integer and 0 <= r < g. Until the stop, the motion covers the distance ((n +
    1) w - g n (n + 1) / 2) T.

    Args:
        distance: distance to the stop [rad]. A distance of 0 or less allows no speed.
        gain: largest change g of the speed in a period [rad/s].
        period: control period T [s].
    """
    if distance <= 0.0:
        return 0.0
    mean = distance / period
    steps = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * mean / gain) - 1.0))
    return (mean + 0.5 * gain * steps * (steps + 1)) / (steps + 1)
