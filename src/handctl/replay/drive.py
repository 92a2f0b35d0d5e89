"""What a recorded run asked of the hand, as a program that asks it again, and how the two runs differ."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.core.types import Mode
from handctl.errors import LogError
from handctl.log.read.moments import check_order
from handctl.log.read.reader import RunLog
from handctl.programs.playback import PlaybackProgram, Recording
from handctl.replay.compare import both

Array = NDArray[np.float64]

BEFORE = ("start", "tighten", "approach")
"""Phases before a run does what it is for."""
HOLE_S = 0.05
"""A longer hole in a recording is not bridged: nobody knows what was asked of the hand in it."""


def stretch(log: RunLog) -> tuple[float, float]:
    """Begin and end of what a run did while active, the taking up of slack left out [s].

    Raises:
        LogError: the hand was never active, or never as a whole; or its ticks are not in order.
    """
    check_order(log.t_ns, log.header.period_ns)
    preparing = np.zeros(len(log), bool)
    changes = log.phases
    for i, change in enumerate(changes):
        end = changes[i + 1].k if i + 1 < len(changes) else int(log.k[-1]) + 1
        if change.name in BEFORE:
            preparing |= (log.k >= change.k) & (log.k < end)
    active = (log.mode == int(Mode.ACTIVE)) & ~preparing
    at = np.flatnonzero(active & ~np.isnan(log.field("tension_goal")).any(axis=1))
    if len(at) < 2:
        why = "not all tendons had goals at once" if active.any() else "the hand was never active"
        raise LogError(f"{why} in it", "the log", "a run in which the whole hand moved")
    return float(log.times[at[0]]), float(log.times[at[-1]])


def bridged(log: RunLog) -> int:
    """How many ticks are missing in what would be driven; the goals beside them are joined by a line.

    Raises:
        LogError: too many in a row, or nothing can be driven.
    """
    (begin, end), times = stretch(log), log.times
    at = np.flatnonzero((times >= begin) & (times < end))
    for i in at[times[at + 1] - times[at] > HOLE_S]:
        hole = f"no ticks between {times[i]:.3f} and {times[i + 1]:.3f} s"
        raise LogError(hole, "the log", f"holes of at most {HOLE_S:g} s in what is driven")
    return int((log.k[at + 1] - log.k[at] - 1).sum())


def recording(log: RunLog, period: float) -> Recording:
    """The goals of a run at another control period [s].

    A digit whose joints have no goal in either neighbouring tick held its tension: its joint goals are NaN.

    Raises:
        LogError: see ``bridged``.
    """
    bridged(log)
    begin, end = stretch(log)
    steps = np.rint(np.arange(round((end - begin) / period) + 1) * (period * 1e9))
    times = np.asarray((round(begin * 1e9) + steps.astype(np.int64)) * 1e-9, np.float64)  # as ``log.times``, to the bit
    q, dq, tension = (_sampled(log, name, times) for name in ("q_goal", "dq_goal", "tension_goal"))
    ddq = np.gradient(log.field("dq_goal"), log.times, axis=0)
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
    """How a driven replay differs from the run it repeats, per joint [deg] and tendon [N], as far as it was driven.

    Empty if the replay never came to the recording.
    """
    again = _began(after)
    return {} if again is None else both(before, stretch(before)[0], after, again, driven(before, after))


def driven(before: RunLog, after: RunLog) -> float:
    """How much of a run was driven again [s]."""
    (begin, end), again = stretch(before), _began(after)
    if again is None:
        return 0.0
    active = after.times[after.mode == int(Mode.ACTIVE)]
    return min(end - begin, max(0.0, float(active[-1]) - again)) if len(active) else 0.0


def _began(after: RunLog) -> float | None:
    """When a replay came to the recording [s]."""
    return next((change.t_ns * 1e-9 for change in after.phases if change.name == "playback"), None)
