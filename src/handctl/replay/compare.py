"""Comparison of two runs: RMS, peak and delay of the difference per joint and tendon."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.errors import IncomparableError
from handctl.log.read.reader import RunLog

Array = NDArray[np.float64]

MAX_DELAY_S = 0.2
"""Largest delay considered [s]."""
MIN_MOTION = 0.05
"""Smallest range of a signal from which a delay is computed, as a fraction of the signal's largest value."""
MAX_UNEXPLAINED = 0.1
"""Largest fraction of a signal's variance that may remain after the shift by a delay.

If a larger fraction remains, the delay is a result of chance or noise.
"""
MIN_REPORTED_DELAY_MS = 0.05
"""Delay below which "in time" is printed [ms]."""

SIGNALS = {"q": ("joint", 57.29577951308232, "deg"), "tension": ("tendon", 1.0, "N")}
"""Axis, factor to the printed unit, and printed unit, by telemetry field."""


def check_same_hand(a: RunLog, name: str, identity: str, where: str) -> None:
    """Raise an error for a log of another hand.

    Args:
        a: a log.
        name: name of the other hand.
        identity: identity of the other hand.
        where: file of the other hand, for the error message.

    Raises:
        IncomparableError: the identities differ.
    """
    logged_identity = a.header.metadata.get("identity", "?")
    logged_name = a.header.metadata.get("hand", "?")
    if logged_identity != identity:
        raise IncomparableError(
            f"the log is of hand {logged_name} {logged_identity[:12]}, not of {name} {identity[:12]}",
            where,
            "the same hand",
        )


def compare_signals(names: tuple[str, ...], before: Array, after: Array, period: float) -> dict[str, dict[str, float]]:
    """Compare two aligned signals.

    Args:
        names: names of the columns.
        before: (ticks, n) first signal, NaN where unknown.
        after: (ticks, n) second signal, NaN where unknown.
        period: period of the rows [s].

    Returns:
        By name: rms and peak in the signals' unit, and delay_s, the delay of `after` behind
        `before` [s]. The delay of a constant signal is NaN.
    """
    rows = min(len(before), len(after))
    change = after[:rows] - before[:rows]
    return {
        name: rms_and_peak(change[:, i]) | {"delay_s": signal_delay(before[:rows, i], after[:rows, i], period)}
        for i, name in enumerate(names)
    }


def rms_and_peak(change: Array) -> dict[str, float]:
    """Return RMS and peak of a difference, NaN values excluded.

    Both are NaN if every value is NaN.
    """
    finite = change[~np.isnan(change)]
    if not finite.size:
        return {"rms": float("nan"), "peak": float("nan")}
    return {"rms": float(np.sqrt(np.mean(finite**2))), "peak": float(np.abs(finite).max())}


def signal_delay(before: Array, after: Array, period: float) -> float:
    """Return the delay of `after` relative to `before` [s].

    The delay is the time shift with the smallest remaining variance, refined by a parabola through
    three shifts.

    Returns:
        NaN if the signal does not move more than noise, if the best shift exceeds `MAX_DELAY_S`, or
        if a signal has a NaN.
    """
    if np.isnan(before).any() or np.isnan(after).any():
        return float("nan")
    reach = min(round(MAX_DELAY_S / period), len(before) // 4)
    if reach < 1 or not np.ptp(before) > MIN_MOTION * np.abs(before).max():
        return float("nan")
    inner = slice(reach, len(before) - reach)
    # `roll` moves rows from one end to the other end. `inner` excludes these rows.
    residual = np.array([np.var(np.roll(after, -shift)[inner] - before[inner]) for shift in range(-reach, reach + 1)])
    best = int(np.argmin(residual))
    if not 0 < best < 2 * reach or not residual[best] < MAX_UNEXPLAINED * np.var(before[inner]):
        return float("nan")
    earlier, lowest, later = residual[best - 1 : best + 2]
    # Second difference of the variance. If it is not positive, the minimum is flat and is not
    # refined.
    bend = earlier - 2.0 * lowest + later
    return float((best - reach + (0.5 * (earlier - later) / bend if bend > 0 else 0.0)) * period)


def resampled_field(log: RunLog, field: str, start: float, times: Array) -> Array:
    """Return a telemetry field interpolated at the given times (times, n).

    Args:
        log: the log.
        field: telemetry field.
        start: origin of `times` in the run [s].
        times: times after `start` [s]. Beyond the ends of the log the end values are held.
    """
    values = log.field(field)
    return np.column_stack([np.interp(times + start, log.times, column) for column in values.T])


def compare_runs(a: RunLog, start_a: float, b: RunLog, start_b: float, duration: float) -> dict[str, Any]:
    """Compare all joints [deg] and tendons [N] of two runs over an interval.

    Args:
        a: first run.
        start_a: start of the interval in the first run [s].
        b: second run, of the same hand.
        start_b: start of the interval in the second run [s].
        duration: length of the interval [s].
    """
    period = a.header.period_ns * 1e-9
    times = np.asarray(np.arange(round(duration / period)) * period, np.float64)
    result: dict[str, Any] = {}
    for field, (axis, factor, unit) in SIGNALS.items():
        before, after = (factor * resampled_field(*run, times) for run in ((a, field, start_a), (b, field, start_b)))
        result[f"{axis}_{unit}"] = compare_signals(a.header.axis(axis), before, after, period)
    return result


def difference_lines(compared: dict[str, Any]) -> Iterator[str]:
    """Yield one line of text for each joint and tendon known in both runs.

    Args:
        compared: result of `compare_runs`.
    """
    for signal, rows in compared.items():
        unit = signal.partition("_")[2]
        for name, row in rows.items():
            ms = 1e3 * row["delay_s"]
            late = "" if math.isnan(ms) else ", in time" if abs(ms) < MIN_REPORTED_DELAY_MS else f", {_delay_text(ms)}"
            if not math.isnan(row["rms"]):
                yield f"{name:<16} rms {row['rms']:.3f} {unit}, peak {row['peak']:.3f} {unit}{late}"


def _delay_text(ms: float) -> str:
    """Return a delay as text."""
    return f"{abs(ms):.1f} ms {'behind' if ms > 0 else 'ahead'}"
