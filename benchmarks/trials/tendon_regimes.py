"""Classify the state of each tendon at each tick, from true values.

The classes (regimes) are free, reversal, impact, hold, beyond 200 N, and slack.
"""

import numpy as np
from numpy.typing import NDArray

from trials.lockstep_trial import FloatArray, TrialRecord

REVERSAL_HALF_WINDOW_S = 0.05
"""Half width of the time window around a reversal of the winding direction [s]."""
IMPACT_DURATION_S = 0.1
SETTLING_TIME_S = 0.3
"""Time from the start of a contact until the tension has settled [s]."""
TAUT_TENSION_N = 0.5
TOUCH_FORCE_N = 0.05
SLACK_WINDOW_S = 0.05
MIN_TURNING_SPEED_RAD_S = 0.2
"""Smallest speed at which a spool counts as turning in a direction [rad/s]."""
KNEE_TENSION_N = 200.0
REGIME_NAMES = ("free", "reversal", "impact", "hold", "beyond 200 N", "slack")
MaskArray = NDArray[np.bool_]


def regime_masks(record: TrialRecord) -> dict[str, MaskArray]:
    """Return a mask (ticks, tendons) for each tendon regime. At each tick, a tendon is in at most one regime."""
    tension = record.true_tension()
    t = record.times
    is_touched = record.expand_to_tendons(record.contact_force() > TOUCH_FORCE_N)
    is_ready = ~np.isin(record.phase, ("start", "tighten", "live"))[:, None]
    is_taut = tension > TAUT_TENSION_N
    contact_time = _time_since_rise(is_touched, t)
    is_reversing = _widened_mask(_reversal_mask(record), t, REVERSAL_HALF_WINDOW_S) & ~is_touched
    is_holding = is_ready & is_taut & is_touched & (contact_time > SETTLING_TIME_S)
    return {
        "free": is_ready & is_taut & ~is_touched & ~is_reversing,
        "reversal": is_ready & is_taut & is_reversing,
        "impact": is_ready & is_taut & is_touched & (contact_time <= IMPACT_DURATION_S),
        "hold": is_holding & (tension <= KNEE_TENSION_N),
        "beyond 200 N": is_holding & (tension > KNEE_TENSION_N),
        "slack": is_ready & ~_widened_mask(is_taut, t, SLACK_WINDOW_S),
    }


def _time_since_rise(signals: MaskArray, times: FloatArray) -> FloatArray:
    """Return the time since each signal last became true [s], as an array (ticks, tendons).

    If a signal is false for less than ``SETTLING_TIME_S``, the function ignores this interruption.
    """
    time_since_rise = np.full(signals.shape, np.inf)
    for i in range(signals.shape[1]):
        rise = -np.inf
        last_signal_time = -np.inf
        for k, value in enumerate(signals[:, i]):
            if (
                value
                and not (k and signals[k - 1, i])
                and times[k] - last_signal_time > SETTLING_TIME_S
            ):
                rise = times[k]
            if value:
                last_signal_time = times[k]
            time_since_rise[k, i] = times[k] - rise
    return time_since_rise


def _reversal_mask(record: TrialRecord) -> MaskArray:
    """Return a mask (ticks, tendons) that is True in ticks in which the spool changes its direction of rotation."""
    period = record.t_ns[1] - record.t_ns[0]
    angle = [
        record.true_values((f"motor/{tendon.motor}" for tendon in record.hand.tendon), delay)
        for delay in (0, period)
    ]
    speed = (angle[0] - angle[1]) / (period * 1e-9)
    direction = np.where(np.abs(speed) > MIN_TURNING_SPEED_RAD_S, np.sign(speed), 0.0)
    has_reversed = np.zeros(direction.shape, dtype=bool)
    for i in range(direction.shape[1]):
        moving_ticks = np.flatnonzero(direction[:, i])
        has_reversed[moving_ticks[1:], i] = (
            direction[moving_ticks[1:], i] != direction[moving_ticks[:-1], i]
        )
    return has_reversed


def _widened_mask(signals: MaskArray, times: FloatArray, max_time_difference: float) -> MaskArray:
    """Return a mask (ticks, tendons) that is True in and near the ticks in which a signal is True.

    Two ticks are near each other if the time between them is at most ``max_time_difference`` [s].
    """
    max_tick_difference = round(max_time_difference / (times[1] - times[0]))
    kernel = np.ones(2 * max_tick_difference + 1)
    return np.column_stack(
        [np.convolve(column, kernel, "same") > 0.5 for column in signals.T.astype(float)]
    )
