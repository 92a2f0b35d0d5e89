"""How well a grasp that was driven again repeats, by the two logs."""

import numpy as np
from numpy.typing import NDArray

from handctl.hand.load import load_hand
from handctl.log.read.reader import RunLog
from handctl.replay.compare import resampled
from handctl.replay.drive_again import active_interval
from handctl.report.summary import mean_angles

SETTLED_S = 0.4
"""From the start of a hold until the grasp is at rest."""


def mean_angles_apart(before: RunLog, after: RunLog) -> NDArray[np.float64]:
    """(times, digits) difference of the mean joint angle of each digit [deg]."""
    begin, end = active_interval(before)
    times = np.arange(0.0, end - begin, 0.005)
    hand = load_hand(before.header.metadata["hand"])
    old, new = (
        mean_angles(hand, resampled(log, "q", start, times)) for log, start in ((before, begin), (after, again(after)))
    )
    return np.degrees(np.abs(new - old))


def tensions_held(before: RunLog, after: RunLog) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Both means (tendons,) while the grasp is at rest [N]."""
    starts = {change.name: change.t_ns * 1e-9 for change in before.phases}
    begin, _ = active_interval(before)
    held = starts["hold"] + SETTLED_S - begin, starts["release"] - begin
    return _mean(before, begin, *held), _mean(after, again(after), *held)


def again(log: RunLog) -> float:
    """When the repetition begins [s]."""
    return next(change.t_ns * 1e-9 for change in log.phases if change.name == "playback")


def _mean(log: RunLog, start_s: float, begin_s: float, end_s: float) -> NDArray[np.float64]:
    at = (log.times >= start_s + begin_s) & (log.times <= start_s + end_s)
    return np.asarray(log.field("tension")[at].mean(axis=0), np.float64)
