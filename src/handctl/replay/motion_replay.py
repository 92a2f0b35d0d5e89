"""Repetition of a recorded motion.

This module converts the targets in a log to a motion program that repeats the motion. The module
also compares the recorded run with the repetition.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.core.tick_types import HandMode
from handctl.errors import LogError
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import check_tick_times
from handctl.programs.playback import PlaybackProgram, RecordedGoals
from handctl.replay.run_comparison import compare_runs

Array = NDArray[np.float64]

PREPARATION_PHASES = ("start", "tighten", "approach")
"""Names of the phases that precede the recorded motion."""
MAX_TICK_GAP_S = 0.05
"""Longest gap without ticks in a recording over which the targets are interpolated [s]."""


def active_interval(log: RunLog) -> tuple[float, float]:
    """Return the times at which the active part of a run begins and ends [s].

    The active part begins after the phases that prepare the motion, such as the tightening of the
    tendons.

    Raises:
        LogError: the hand was never active, no tick has targets for all tendons, or the ticks are
            out of order.
    """
    check_tick_times(log.t_ns, log.header.period_ns)
    is_preparing = np.zeros(len(log), bool)
    phases = log.phases
    for i, phase in enumerate(phases):
        end = phases[i + 1].k if i + 1 < len(phases) else int(log.k[-1]) + 1
        if phase.name in PREPARATION_PHASES:
            is_preparing |= (log.k >= phase.k) & (log.k < end)
    is_active = (log.mode == int(HandMode.ACTIVE)) & ~is_preparing
    usable_ticks = np.flatnonzero(is_active & ~np.isnan(log.field("tension_goal")).any(axis=1))
    if len(usable_ticks) < 2:
        reason = (
            "not all tendons had targets at the same time"
            if is_active.any()
            else "the hand was never active"
        )
        raise LogError(f"{reason} in it", "the log", "a run in which the whole hand moved")
    return float(log.times[usable_ticks[0]]), float(log.times[usable_ticks[-1]])


def count_missing_ticks(log: RunLog) -> int:
    """Count the ticks that are missing in the active interval of a run.

    The targets of a missing tick are interpolated linearly between the neighbouring ticks.

    Raises:
        LogError: too many consecutive ticks are missing, or the hand was never active in the run.
    """
    start, end = active_interval(log)
    times = log.times
    at = np.flatnonzero((times >= start) & (times < end))
    for i in at[times[at + 1] - times[at] > MAX_TICK_GAP_S]:
        gap = f"no ticks between {times[i]:.3f} and {times[i + 1]:.3f} s"
        raise LogError(
            gap,
            "the log",
            f"gaps of at most {MAX_TICK_GAP_S:g} s in the part of the log that is repeated",
        )
    return int((log.k[at + 1] - log.k[at] - 1).sum())


def recorded_targets(log: RunLog, period: float) -> RecordedGoals:
    """Return the targets of a recorded run, converted to another control period.

    While the controller holds a constant tension in a digit, the digit has no joint targets. At a
    sample time, the joint targets of a digit are NaN if the digit held a tension in one of the two
    neighbouring ticks.

    Args:
        log: log of the run.
        period: the new control period [s].

    Raises:
        LogError: as for `count_missing_ticks`.
    """
    count_missing_ticks(log)
    start, end = active_interval(log)
    steps = np.rint(np.arange(round((end - start) / period) + 1) * (period * 1e9))
    # If both control periods are equal, the sample times equal `log.times` in every bit, and no
    # interpolation is necessary.
    times = np.asarray((round(start * 1e9) + steps.astype(np.int64)) * 1e-9, np.float64)
    q, dq, tension = (
        _interpolate_field(log, name, times) for name in ("q_goal", "dq_goal", "tension_goal")
    )
    ddq = np.gradient(log.field("dq_goal"), log.times, axis=0)
    acceleration = _interpolate_columns(log, ddq, times)
    return RecordedGoals(q, dq, np.where(np.isnan(q), np.nan, np.nan_to_num(acceleration)), tension)


def _interpolate_field(log: RunLog, name: str, sample_times: Array) -> Array:
    """Return a telemetry field of a log, interpolated at the given times."""
    return _interpolate_columns(log, log.field(name), sample_times)


def _interpolate_columns(log: RunLog, values: Array, sample_times: Array) -> Array:
    """Interpolate values (ticks, n) of a log at the given times [s].

    If the value before or after a given time is NaN, the result for this time is NaN. For times
    before the first tick or after the last tick, the result is the value of the nearest tick.
    """
    return np.column_stack([np.interp(sample_times, log.times, column) for column in values.T])


def playback_program(log: RunLog, period: float, replays_tensions: bool) -> PlaybackProgram:
    """Return the program that repeats the motion of a recorded run.

    Args:
        log: log of the recorded run.
        period: the control period of the hand that repeats the motion [s].
        replays_tensions: True to follow the recorded tensions instead of the recorded joint trajectories.
    """
    return PlaybackProgram(recorded_targets(log, period), replays_tensions)


def compare_replay(original_log: RunLog, replayed_log: RunLog) -> dict[str, Any]:
    """Compare a replay with the recorded run, for each joint [deg] and each tendon [N].

    The comparison covers only the part of the recorded run that the replay has repeated.

    Returns:
        the differences from `compare_runs`. The mapping is empty if the replay never began to
        follow the recorded run.
    """
    replay_start = _playback_start(replayed_log)
    return (
        {}
        if replay_start is None
        else compare_runs(
            original_log,
            active_interval(original_log)[0],
            replayed_log,
            replay_start,
            followed_duration_s(original_log, replayed_log),
        )
    )


def followed_duration_s(original_log: RunLog, replayed_log: RunLog) -> float:
    """Return how long a replay followed the recorded run [s]."""
    start, end = active_interval(original_log)
    replay_start = _playback_start(replayed_log)
    if replay_start is None:
        return 0.0
    active_times = replayed_log.times[replayed_log.mode == int(HandMode.ACTIVE)]
    return (
        min(end - start, max(0.0, float(active_times[-1]) - replay_start))
        if len(active_times)
        else 0.0
    )


def _playback_start(replayed_log: RunLog) -> float | None:
    """Return the time at which a replay began to follow the recorded run [s].

    If the replayed log contains no phase ``playback``, return None.
    """
    return next(
        (change.t_ns * 1e-9 for change in replayed_log.phases if change.name == "playback"), None
    )
