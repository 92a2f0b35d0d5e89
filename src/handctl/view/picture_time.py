"""Choice of the time at which a single picture shows a run."""

from handctl.log.read.reader import RunLog

PICTURE_PHASE = "hold"
"""Name of the phase that a picture shows."""


def picture_time(log: RunLog) -> float:
    """Return the middle of the longest hold phase of a run [s].

    For a run without a hold phase, return the middle of the run.
    """
    if not len(log):
        return 0.0
    phase_end_times = [change.t_ns for change in log.phases[1:]] + [int(log.t_ns[-1])]
    hold_intervals = [
        (end - change.t_ns, change.t_ns)
        for change, end in zip(log.phases, phase_end_times, strict=True)
        if change.name == PICTURE_PHASE and end > change.t_ns
    ]
    duration_ns, start_ns = max(
        hold_intervals, default=(int(log.t_ns[-1] - log.t_ns[0]), int(log.t_ns[0]))
    )
    return (start_ns + duration_ns / 2) * 1e-9
