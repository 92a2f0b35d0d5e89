"""Motion along streamed targets: interpolation to the latest target, then limits on speed and acceleration.

A segment is a polynomial of time per coordinate. It leads from the reference at the arrival of a
target to the target (``controller.streams`` writes it). After the end of a segment the target
holds. Nothing is extrapolated.

The reference follows the segment exactly as long as this needs no more than the limits allow. Beyond
the limits it approaches the segment as fast as it can stop. The range of a joint bounds its speed in
the same way, so that a motion never runs over the end of the range.
"""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables

TOLERANCE = 1e-9
"""Fraction by which a number may exceed a limit, for rounding."""


@inner
def position_on_segment(x: Tables, k: int, t: float) -> tuple[float, float]:
    """Return position [rad] and rate [rad/s] of a coordinate on the present segment at time t [s]."""
    after = t - x.run[s.STREAM_SINCE]
    if after >= x.run[s.STREAM_DURATION]:
        return x.coordinate[s.STREAM_TARGET, k], 0.0
    position = rate = 0.0
    for power in range(5, -1, -1):  # Horner's scheme, for the polynomial and its derivative
        rate = rate * after + position
        position = position * after + x.coordinate[s.STREAM_SEGMENT + power, k]
    return position, rate


@inner
def advance_reference(x: Tables, c: ConstantTables, k: int) -> None:
    """Move the reference of a coordinate to the present tick.

    Args:
        x: state tables, with the reference of the last tick in ``TRAJECTORY``.
        c: constants of the hand.
        k: index of the coordinate.
    """
    period = c.run[h.PERIOD] * (1 + x.run_int[s.MISSED])
    aim, aim_rate = position_on_segment(x, k, x.run_int[s.T_NS] / 1e9)
    position = x.coordinate[s.TRAJECTORY, k]
    rate = x.coordinate[s.TRAJECTORY + 1, k]
    top = c.run[h.STREAM_SPEED]
    gain = c.run[h.STREAM_ACCELERATION] * period
    low = x.coordinate[s.STREAM_RANGE, k]
    high = x.coordinate[s.STREAM_RANGE + 1, k]
    slowest = max(-top, -max_stoppable_speed(position - low, gain, period))
    fastest = min(top, max_stoppable_speed(high - position, gain, period))
    mean = (aim - position) / period
    allowed = gain * (1.0 + TOLERANCE)
    free = abs(mean - rate) <= allowed and abs(aim_rate - rate) <= allowed
    free &= slowest - gain * TOLERANCE <= min(mean, aim_rate) and max(mean, aim_rate) <= fastest + gain * TOLERANCE
    new_rate = aim_rate
    if not free:
        x.run_int[s.STREAM_LIMITED] += 1
        apart = aim - position - aim_rate * period
        closing = math.copysign(max_stoppable_speed(abs(apart), gain, period), apart)
        sought = min(max(aim_rate + closing, slowest), fastest)
        new_rate = rate + min(max(sought - rate, -gain), gain)
        aim = position + new_rate * period
    x.coordinate[s.TRAJECTORY, k] = aim
    x.coordinate[s.TRAJECTORY + 1, k] = new_rate
    x.coordinate[s.TRAJECTORY + 2, k] = (new_rate - rate) / period


@inner
def max_stoppable_speed(distance: float, gain: float, period: float) -> float:
    """Return the largest speed from which a motion stops within a distance, in steps of a period [rad/s].

    A speed w = n g + r, 0 <= r < g, falls to 0 over the distance ((n + 1) w - g n (n + 1) / 2) T.

    Args:
        distance: distance to the stop [rad]. 0 or less allows no speed.
        gain: largest change g of the speed in a period [rad/s].
        period: control period T [s].
    """
    if distance <= 0.0:
        return 0.0
    mean = distance / period
    steps = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * mean / gain) - 1.0))
    return (mean + 0.5 * gain * steps * (steps + 1)) / (steps + 1)
