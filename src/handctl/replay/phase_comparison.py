"""Comparison of two runs of the same hand, phase by phase."""

from typing import Any, NamedTuple

from handctl.core.tick_types import HandMode
from handctl.errors import IncomparableError
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import check_tick_times
from handctl.replay.run_comparison import check_same_hand, compare_runs

PASSIVE_PHASES = frozenset(mode.name.lower() for mode in HandMode if mode != HandMode.RELAX)
"""Names of the phases in which the hand's tendons have no tension.

For phases without tension, the comparison of two runs compares only the durations.
"""


class PhaseSpan(NamedTuple):
    """Phase of a run, with start and end.

    Attributes:
        name: name of the phase.
        start_s, end_s: times of the start and the end, since the start of the run [s].
    """

    name: str
    start_s: float
    end_s: float


def phase_spans(log: RunLog) -> list[PhaseSpan]:
    """Return all phases of a run in order.

    If several phases have the same name, every phase after the first is numbered: `hold`, `hold
    (2)`.
    """
    changes = log.phases
    spans = []
    counts = dict[str, int]()
    end_times = [change.t_ns * 1e-9 for change in changes[1:]] + log.times[-1:].tolist()
    for change, end in zip(changes, end_times, strict=True):
        counts[change.name] = occurrence_number = counts.get(change.name, 0) + 1
        spans.append(
            PhaseSpan(
                change.name if occurrence_number == 1 else f"{change.name} ({occurrence_number})",
                change.t_ns * 1e-9,
                end,
            )
        )
    return spans


def compare_logs(a: RunLog, b: RunLog, location: str) -> dict[str, Any]:
    """Compare two runs of the same hand, phase by phase.

    Args:
        a: log of the first run.
        b: log of the second run, of the same hand.
        location: file name of the second log, for the error message.

    Returns:
        The gains that differ, the phases that only one of the runs has, and a comparison of each
        phase that both runs have. The comparison of a phase contains both durations [s] and the
        differences from `compare_runs`. The comparison of a phase covers the shorter of its two
        durations. Both runs are aligned at the start of the phase.

    Raises:
        IncomparableError: the two logs are of different hands.
        LogError: the ticks of a log are out of order.
    """
    second_metadata = b.header.metadata
    check_same_hand(
        a, second_metadata.get("hand", "?"), second_metadata.get("identity", "?"), location
    )
    for names in ("joints", "tendons", "motors", "digits"):
        if getattr(a.header, names) != getattr(b.header, names):
            raise IncomparableError(
                f"other {names} than in the other log", location, "a log of the same hand"
            )
    for log in (a, b):
        check_tick_times(log.t_ns, log.header.period_ns)
    first_phases, second_phases = (
        {phase_span.name: phase_span for phase_span in phase_spans(log)} for log in (a, b)
    )
    phases = {}
    for name, phase_span in first_phases.items():
        if name not in second_phases:
            continue
        other_phase = second_phases[name]
        durations_s = (
            phase_span.end_s - phase_span.start_s,
            other_phase.end_s - other_phase.start_s,
        )
        is_moving_phase = phase_span.name not in PASSIVE_PHASES and min(durations_s) > 0
        shared_comparison = (
            compare_runs(a, phase_span.start_s, b, other_phase.start_s, min(durations_s))
            if is_moving_phase
            else {}
        )
        phases[name] = {"duration_s": list(durations_s), **shared_comparison}
    gains = a.header.gains.keys() | b.header.gains.keys()
    return {
        "gains": {
            name: [a.header.gains.get(name), b.header.gains.get(name)]
            for name in sorted(gains)
            if a.header.gains.get(name) != b.header.gains.get(name)
        },
        "only_in_first": [name for name in first_phases if name not in second_phases],
        "only_in_second": [name for name in second_phases if name not in first_phases],
        "phases": phases,
    }
