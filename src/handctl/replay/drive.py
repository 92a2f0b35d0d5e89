"""What a recorded run asked of the hand, as a program that asks it again, and how the two runs differ."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.controller.playback import PlaybackProgram, Recording
from handctl.controller.types import Mode
from handctl.errors import LogError
from handctl.log.moments import check_order
from handctl.log.reader import RunLog
from handctl.replay.compare import both

Array = NDArray[np.float64]

BEFORE = ("start", "tighten", "approach")
"""Phases before a run does what it is for."""


def stretch(log: RunLog) -> tuple[float, float]:
    """Begin and end of what a run did while active, the taking up of slack left out [s].

    Raises:
        LogError: the hand was never active, or its ticks are not in order.
    """
    check_order(log.t_ns, log.header.period_ns)
    preparing = np.zeros(len(log), bool)
    changes = log.phases
    for i, change in enumerate(changes):
        end = changes[i + 1].k if i + 1 < len(changes) else int(log.k[-1]) + 1
        if change.name in BEFORE:
            preparing |= (log.k >= change.k) & (log.k < end)
    known = ~np.isnan(log.field("tension_goal")).any(axis=1)
    at = np.flatnonzero((log.mode == int(Mode.ACTIVE)) & ~preparing & known)
    if len(at) < 2:
        raise LogError("the hand was never active in it", "the log", "a run that moved")
    return float(log.times[at[0]]), float(log.times[at[-1]])


def recording(log: RunLog, period: float) -> Recording:
    """The goals of a run at another control period [s].

    A digit whose joints have no goal in either neighbouring tick held its tension: its joint goals are NaN.
    """
    begin, end = stretch(log)
    steps = np.rint(np.arange(round((end - begin) / period) + 1) * (period * 1e9))
    times = np.asarray((round(begin * 1e9) + steps.astype(np.int64)) * 1e-9, np.float64)  # as ``log.times``, to the bit
    q, dq, tension = (_sampled(log, name, times) for name in ("q_goal", "dq_goal", "tension_goal"))
    ddq = np.gradient(log.field("dq_goal"), log.header.period_ns * 1e-9, axis=0)
    rate = _at(log, ddq, times)
    return Recording(q, dq, np.where(np.isnan(q), np.nan, np.nan_to_num(rate)), tension)


def _sampled(log: RunLog, name: str, times: Array) -> Array:
    return _at(log, log.field(name), times)


def _at(log: RunLog, values: Array, times: Array) -> Array:
    """Columns interpolated at times [s]; NaN where a neighbour is NaN, the nearest tick at the borders."""
    return np.column_stack([np.interp(times, log.times, column) for column in values.T])


def playback(log: RunLog, period: float, raw: bool) -> PlaybackProgram:
    """The program that drives a run again; ``raw`` follows its tensions instead of its trajectories."""
    return PlaybackProgram(recording(log, period), raw)


def difference(before: RunLog, after: RunLog) -> dict[str, Any]:
    """How a driven replay differs from the run it repeats, per joint [deg] and tendon [N]."""
    begin, end = stretch(before)
    again = next((change.t_ns * 1e-9 for change in after.phases if change.name == "playback"), None)
    if again is None:
        raise LogError("the replay never came to the recording", "the new log", "a phase called playback")
    return both(before, begin, after, again, end - begin)
