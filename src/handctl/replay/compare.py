"""Two runs side by side: per joint and tendon the RMS and peak of the difference, and the delay."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.errors import IncomparableError
from handctl.log.read.reader import RunLog

Array = NDArray[np.float64]

LONGEST_DELAY_S = 0.2
LEAST_MOTION = 0.05
"""A signal that moves by less than this share of its largest value has no delay to speak of."""
UNEXPLAINED = 0.1
"""Of the variance of a signal: a delay that leaves more of it is none, but chance or noise."""
IN_TIME_MS = 0.05
"""Less is not told to a person [ms]."""

SIGNALS = {"q": ("joint", 57.29577951308232, "deg"), "tension": ("tendon", 1.0, "N")}
"""Field of the telemetry: what it runs over, and the factor to the unit in which a person reads it."""


def check_same_hand(a: RunLog, name: str, identity: str, where: str) -> None:
    """Refuse what is not the log's hand.

    Args:
        a: a log.
        name, identity: of the other hand.
        where: where the other one comes from.

    Raises:
        IncomparableError: with both identities.
    """
    ours, theirs = a.header.metadata.get("identity", "?"), a.header.metadata.get("hand", "?")
    if ours != identity:
        raise IncomparableError(
            f"the log is of hand {theirs} {ours[:12]}, not of {name} {identity[:12]}", where, "the same hand"
        )


def compare(names: tuple[str, ...], before: Array, after: Array, period: float) -> dict[str, dict[str, float]]:
    """Difference of two aligned signals.

    Args:
        names: of the columns.
        before, after: (ticks, n), NaN where nothing is known.
        period: of the rows [s].

    Returns:
        by name: rms, peak in the signals' unit; delay_s of ``after`` behind ``before`` [s], NaN if nothing moves.
    """
    rows = min(len(before), len(after))
    change = after[:rows] - before[:rows]
    return {
        name: size(change[:, i]) | {"delay_s": delay(before[:rows, i], after[:rows, i], period)}
        for i, name in enumerate(names)
    }


def size(change: Array) -> dict[str, float]:
    """RMS and peak of what is known of a difference; NaN if nothing is."""
    known = change[~np.isnan(change)]
    if not known.size:
        return {"rms": float("nan"), "peak": float("nan")}
    return {"rms": float(np.sqrt(np.mean(known**2))), "peak": float(np.abs(known).max())}


def delay(before: Array, after: Array, period: float) -> float:
    """Time by which ``after`` is behind [s]: the shift that leaves the least variance, refined by a parabola.

    NaN if nothing moves but noise, if no delay within ``LONGEST_DELAY_S`` fits best, or if one is not known throughout.
    """
    if np.isnan(before).any() or np.isnan(after).any():
        return float("nan")
    reach = min(round(LONGEST_DELAY_S / period), len(before) // 4)
    if reach < 1 or not np.ptp(before) > LEAST_MOTION * np.abs(before).max():
        return float("nan")
    kept = slice(reach, len(before) - reach)
    left = np.array([np.var(np.roll(after, -shift)[kept] - before[kept]) for shift in range(-reach, reach + 1)])
    best = int(np.argmin(left))
    if not 0 < best < 2 * reach or not left[best] < UNEXPLAINED * np.var(before[kept]):
        return float("nan")
    earlier, least, later = left[best - 1 : best + 2]
    bend = earlier - 2.0 * least + later
    return float((best - reach + (0.5 * (earlier - later) / bend if bend > 0 else 0.0)) * period)


def resampled(log: RunLog, field: str, start: float, times: Array) -> Array:
    """(times, n) a field of a log, interpolated at times [s] after ``start`` [s]; held beyond the ends."""
    values = log.field(field)
    return np.column_stack([np.interp(times + start, log.times, column) for column in values.T])


def both(a: RunLog, start_a: float, b: RunLog, start_b: float, duration: float) -> dict[str, Any]:
    """Compare all joints [deg] and tendons [N] of two runs over a stretch of time.

    Args:
        a, b: runs of one hand.
        start_a, start_b: where the stretch begins in each [s].
        duration: of the stretch [s].
    """
    period = a.header.period_ns * 1e-9
    times = np.asarray(np.arange(round(duration / period)) * period, np.float64)
    result: dict[str, Any] = {}
    for field, (axis, factor, unit) in SIGNALS.items():
        before, after = (factor * resampled(*run, times) for run in ((a, field, start_a), (b, field, start_b)))
        result[f"{axis}_{unit}"] = compare(a.header.axis(axis), before, after, period)
    return result


def difference_lines(compared: dict[str, Any]) -> Iterator[str]:
    """A line for a person of each joint and tendon of which something is known in both runs.

    Args:
        compared: from ``both``.
    """
    for signal, rows in compared.items():
        unit = signal.partition("_")[2]
        for name, row in rows.items():
            ms = 1e3 * row["delay_s"]
            late = "" if math.isnan(ms) else ", in time" if abs(ms) < IN_TIME_MS else f", {_late(ms)}"
            if not math.isnan(row["rms"]):
                yield f"{name:<16} rms {row['rms']:.3f} {unit}, peak {row['peak']:.3f} {unit}{late}"


def _late(ms: float) -> str:
    return f"{abs(ms):.1f} ms {'behind' if ms > 0 else 'ahead'}"
