"""Compare the log of a grasp with the log of a run in which a hand repeats the grasp."""

import numpy as np
from numpy.typing import NDArray

from handctl.hand.hand_loading import load_hand
from handctl.log.read.reader import RunLog
from handctl.replay.motion_replay import active_interval
from handctl.replay.run_comparison import resampled_field
from handctl.report.run_summary import mean_angles

SETTLING_TIME_S = 0.4
"""Time from the start of a hold phase until the grasp is at rest [s]."""


def mean_angle_differences(original_log: RunLog, repeated_log: RunLog) -> NDArray[np.float64]:
    """Return the absolute difference of each digit's mean joint angle between two runs [deg].

    The result has the shape (times, digits).
    """
    start, end = active_interval(original_log)
    times = np.arange(0.0, end - start, 0.005)
    hand = load_hand(original_log.header.metadata["hand"])
    recorded_angles, repeated_angles = (
        mean_angles(hand, resampled_field(log, "q", start, times))
        for log, start in (
            (original_log, start),
            (repeated_log, start_of_repetition_s(repeated_log)),
        )
    )
    return np.degrees(np.abs(repeated_angles - recorded_angles))


def mean_held_tensions(
    original_log: RunLog, repeated_log: RunLog
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean tension [N] of each tendon while the grasp is at rest, for both runs.

    The first returned array (tendons,) belongs to the recorded run, and the second array to the
    repetition of this run.
    """
    phase_starts_s = {change.name: change.t_ns * 1e-9 for change in original_log.phases}
    start, _ = active_interval(original_log)
    rest_interval = (
        phase_starts_s["hold"] + SETTLING_TIME_S - start,
        phase_starts_s["release"] - start,
    )
    return _mean_tension(original_log, start, *rest_interval), _mean_tension(
        repeated_log, start_of_repetition_s(repeated_log), *rest_interval
    )


def start_of_repetition_s(log: RunLog) -> float:
    """Return the time at which the repeated motion begins, in the log of the repetition [s]."""
    return next(change.t_ns * 1e-9 for change in log.phases if change.name == "playback")


def _mean_tension(
    log: RunLog, start_s: float, offset_s: float, end_s: float
) -> NDArray[np.float64]:
    at = (log.times >= start_s + offset_s) & (log.times <= start_s + end_s)
    return np.asarray(log.field("tension")[at].mean(axis=0), np.float64)
