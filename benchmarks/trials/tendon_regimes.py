"""Classify the state of each tendon at each tick, from true values.

The classes (regimes) are free, reversal, impact, hold, beyond 200 N, and slack.
"""

import numpy as np
from numpy.typing import NDArray

from trials.lockstep_trial import FloatArray, TrialRecord

REVERSAL_S = 0.05
"""Half width of the time window around a reversal of the winding direction [s]."""
IMPACT_S = 0.1
SETTLED_S = 0.3
"""Time after the start of a contact until the tension has settled [s]."""
TAUT_TENSION_N = 0.5
TOUCH_FORCE_N = 0.05
SLACK_S = 0.05
TURNING_RAD_S = 0.2
"""A spool that is slower than this counts as having no direction [rad/s]."""
KNEE_TENSION_N = 200.0
REGIME_NAMES = ("free", "reversal", "impact", "hold", "beyond 200 N", "slack")
MaskArray = NDArray[np.bool_]


def regime_masks(record: TrialRecord) -> dict[str, MaskArray]:
    """Return a mask (ticks, N) for each regime. At each tick, a tendon is in at most one regime."""
    tension = record.tension()
    t = record.times
    touched = record.of_tendons(record.contact_force() > TOUCH_FORCE_N)
    ready = ~np.isin(record.phase, ("start", "tighten", "live"))[:, None]
    taut = tension > TAUT_TENSION_N
    since = _since_rise(touched, t)
    turning = _near_mask(_reversal_mask(record), t, REVERSAL_S) & ~touched
    hold = ready & taut & touched & (since > SETTLED_S)
    return {
        "free": ready & taut & ~touched & ~turning,
        "reversal": ready & taut & turning,
        "impact": ready & taut & touched & (since <= IMPACT_S),
        "hold": hold & (tension <= KNEE_TENSION_N),
        "beyond 200 N": hold & (tension > KNEE_TENSION_N),
        "slack": ready & ~_near_mask(taut, t, SLACK_S),
    }


def _since_rise(signals: MaskArray, times: FloatArray) -> FloatArray:
    """Return the time since each signal last became true (ticks, N) [s].

    Pauses of a signal that are shorter than ``SETTLED_S`` are ignored.
    """
    since = np.full(signals.shape, np.inf)
    for i in range(signals.shape[1]):
        rise = -np.inf
        fall = -np.inf
        for k, value in enumerate(signals[:, i]):
            if value and not (k and signals[k - 1, i]) and times[k] - fall > SETTLED_S:
                rise = times[k]
            if value:
                fall = times[k]
            since[k, i] = times[k] - rise
    return since


def _reversal_mask(record: TrialRecord) -> MaskArray:
    """Return a mask (ticks, N) of the ticks in which a spool changes its direction."""
    period = record.t_ns[1] - record.t_ns[0]
    angle = [
        record.truth((f"motor/{tendon.motor}" for tendon in record.hand.tendon), delay)
        for delay in (0, period)
    ]
    speed = (angle[0] - angle[1]) / (period * 1e-9)
    direction = np.where(np.abs(speed) > TURNING_RAD_S, np.sign(speed), 0.0)
    turned = np.zeros(direction.shape, dtype=bool)
    for i in range(direction.shape[1]):
        moving = np.flatnonzero(direction[:, i])
        turned[moving[1:], i] = direction[moving[1:], i] != direction[moving[:-1], i]
    return turned


def _near_mask(signals: MaskArray, times: FloatArray, time_distance: float) -> MaskArray:
    """Return a mask (ticks, N) of the ticks near a tick whose signal is true.

    The time between the two ticks is at most ``time_distance`` [s].
    """
    reach = round(time_distance / (times[1] - times[0]))
    kernel = np.ones(2 * reach + 1)
    return np.column_stack(
        [np.convolve(column, kernel, "same") > 0.5 for column in signals.T.astype(float)]
    )
