"""Comparison of two runs.

For each joint and tendon, the comparison gives three numbers: the RMS of the difference, the peak
of the difference, and the delay of the second run.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from handctl.errors import IncomparableError
from handctl.log.read.hand_in_log import prismatic_joints
from handctl.log.read.reader import RunLog

Array = NDArray[np.float64]

MAX_DELAY_S = 0.2
"""Largest delay between two signals that the comparison can find [s]."""
MIN_SIGNAL_SPAN = 0.05
"""Smallest range of a signal from which a delay is computed, as a fraction of the signal's largest value."""
MAX_UNEXPLAINED_FRACTION = 0.1
"""Largest accepted fraction of the first signal's variance that remains as a difference after the shift by the delay.

If a larger fraction of the variance remains, the delay that was found is a result of chance or
noise.
"""
MIN_REPORTED_DELAY_MS = 0.05
"""Delay below which the text "in time" is printed instead of a number of milliseconds [ms]."""

MM_PER_M = 1000.0
"""Factor from the logged position of a prismatic joint [m] to the printed position [mm]."""
COMPARED_SIGNALS = {"q": ("joint", 57.29577951308232, "deg"), "tension": ("tendon", 1.0, "N")}
"""Axis, factor from the field's unit to the printed unit, and printed unit, for each compared telemetry field."""


def check_same_hand(log: RunLog, name: str, hand_identity: str, location: str) -> None:
    """Raise an error if a log was recorded with another hand than the given hand.

    Args:
        log: log to check.
        name: name of the given hand.
        hand_identity: identity of the given hand.
        location: file of the given hand, for the error message.

    Raises:
        IncomparableError: the identity of the hand in the log differs from the given identity.
    """
    logged_identity = log.header.metadata.get("identity", "?")
    logged_name = log.header.metadata.get("hand", "?")
    if logged_identity != hand_identity:
        raise IncomparableError(
            f"the log is of hand {logged_name} {logged_identity[:12]}, not of {name} {hand_identity[:12]}",
            location,
            "the same hand",
        )


def compare_signals(
    names: tuple[str, ...], signal_before: Array, signal_after: Array, period: float
) -> dict[str, dict[str, float]]:
    """Compare two signals, row by row.

    Rows with the same index belong to the same time.

    Args:
        names: names of the columns of both signals.
        signal_before: (ticks, n) first signal, with NaN for unknown values.
        signal_after: (ticks, n) second signal, with NaN for unknown values.
        period: time between two rows [s].

    Returns:
        By name of the column: rms and peak of the difference in the unit of the signals, and
        delay_s, by which `signal_after` lags behind `signal_before` [s]. The delay of a constant signal is NaN.
    """
    row_count = min(len(signal_before), len(signal_after))
    differences = signal_after[:row_count] - signal_before[:row_count]
    return {
        name: rms_and_peak_difference(differences[:, i])
        | {
            "delay_s": signal_delay(
                signal_before[:row_count, i], signal_after[:row_count, i], period
            )
        }
        for i, name in enumerate(names)
    }


def rms_and_peak_difference(signal_difference: Array) -> dict[str, float]:
    """Return the RMS and the peak of a difference. NaN values in the difference are ignored.

    If all values are NaN, the RMS and the peak are NaN.
    """
    finite_differences = signal_difference[~np.isnan(signal_difference)]
    if not finite_differences.size:
        return {"rms": float("nan"), "peak": float("nan")}
    return {
        "rms": float(np.sqrt(np.mean(finite_differences**2))),
        "peak": float(np.abs(finite_differences).max()),
    }


def signal_delay(signal_before: Array, signal_after: Array, period: float) -> float:
    """Return the delay of the signal `signal_after` behind the signal `signal_before` [s].

    The delay is the time shift between both signals for which the variance of their difference is
    smallest. The best time shift is refined by a parabola through three neighbouring shifts.

    Returns:
        The result is NaN if the signal moves no more than noise, if no time shift up to
        `MAX_DELAY_S` explains the difference, or if a signal contains NaN.
    """
    if np.isnan(signal_before).any() or np.isnan(signal_after).any():
        return float("nan")
    max_shift = min(round(MAX_DELAY_S / period), len(signal_before) // 4)
    if max_shift < 1 or not np.ptp(signal_before) > MIN_SIGNAL_SPAN * np.abs(signal_before).max():
        return float("nan")
    compared_rows = slice(max_shift, len(signal_before) - max_shift)
    # `roll` moves rows from one end of a signal to the other end. The slice `compared_rows` excludes these
    # rows.
    residual = np.array(
        [
            np.var(np.roll(signal_after, -shift)[compared_rows] - signal_before[compared_rows])
            for shift in range(-max_shift, max_shift + 1)
        ]
    )
    best_index = int(np.argmin(residual))
    if not 0 < best_index < 2 * max_shift or not residual[
        best_index
    ] < MAX_UNEXPLAINED_FRACTION * np.var(signal_before[compared_rows]):
        return float("nan")
    variance_before, min_residual, variance_after = residual[best_index - 1 : best_index + 2]
    # If one signal is an exact copy of the other, the shift needs no refinement.
    if min_residual == 0.0:
        return (best_index - max_shift) * period
    # The variable `curvature` is the second difference of the variance with respect to the shift.
    # If `curvature` is not positive, the minimum of the variance is flat, and the best time shift
    # is not refined.
    curvature = variance_before - 2.0 * min_residual + variance_after
    return float(
        (
            best_index
            - max_shift
            + (0.5 * (variance_before - variance_after) / curvature if curvature > 0 else 0.0)
        )
        * period
    )


def resampled_field(log: RunLog, field: str, start: float, times: Array) -> Array:
    """Interpolate a telemetry field of a log at the given times, and return the values (times, n).

    Args:
        log: log to read.
        field: name of the telemetry field.
        start: time in the run that corresponds to the time 0 in `times` [s].
        times: times after `start` [s]. For times outside the log, the result is the value in the
            first or last tick of the log, whichever is nearer.
    """
    values = log.field(field)
    return np.column_stack([np.interp(times + start, log.times, column) for column in values.T])


def compare_runs(
    a: RunLog, start_of_first_run_s: float, b: RunLog, start_of_second_run_s: float, duration: float
) -> dict[str, Any]:
    """Compare two runs over an interval: the angles of all joints [deg] and the tensions of all tendons [N].

    The positions of prismatic joints are compared in mm.

    Args:
        a: first run.
        start_of_first_run_s: start of the interval in the first run [s].
        b: second run, of the same hand.
        start_of_second_run_s: start of the interval in the second run [s].
        duration: length of both intervals [s].
    """
    period = a.header.period_ns * 1e-9
    times = np.asarray(np.arange(round(duration / period)) * period, np.float64)
    result: dict[str, Any] = {}
    for field, (axis, factor, unit) in COMPARED_SIGNALS.items():
        signals_before, signals_after = (
            factor * resampled_field(*run, times)
            for run in ((a, field, start_of_first_run_s), (b, field, start_of_second_run_s))
        )
        differences_by_name = compare_signals(
            a.header.axis_names(axis), signals_before, signals_after, period
        )
        prismatic = prismatic_joints(a.header) if field == "q" else frozenset()
        result[f"{axis}_{unit}"] = {
            name: differences
            for name, differences in differences_by_name.items()
            if name not in prismatic
        }
        if prismatic:
            factors_to_mm = np.array([MM_PER_M / factor, MM_PER_M / factor, 1.0])
            result[f"{axis}_mm"] = {
                name: dict(
                    zip(
                        differences,
                        (factors_to_mm * list(differences.values())).tolist(),
                        strict=True,
                    )
                )
                for name, differences in differences_by_name.items()
                if name in prismatic
            }
    return result


def difference_lines(comparison: dict[str, Any]) -> Iterator[str]:
    """Yield one line of text about the difference of each joint and tendon that has values in both runs.

    Args:
        comparison: result of `compare_runs`.
    """
    for signal, rows in comparison.items():
        unit = signal.partition("_")[2]
        for name, row in rows.items():
            ms = 1e3 * row["delay_s"]
            delay_text = (
                ""
                if math.isnan(ms)
                else ", in time"
                if abs(ms) < MIN_REPORTED_DELAY_MS
                else f", {_delay_text(ms)}"
            )
            if not math.isnan(row["rms"]):
                yield f"{name:<16} rms {row['rms']:.3f} {unit}, peak {row['peak']:.3f} {unit}{delay_text}"


def _delay_text(delay_ms: float) -> str:
    """Return a delay [ms] as text."""
    return f"{abs(delay_ms):.1f} ms {'behind' if delay_ms > 0 else 'ahead'}"
