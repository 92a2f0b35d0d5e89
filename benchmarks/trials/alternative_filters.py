"""Alternatives to the controller's tension filter: an exponential average, and a filter on the load cell alone."""

import numpy as np
from scipy.linalg import solve_discrete_are

from trials.lockstep import Array

AVERAGE_WEIGHTS = np.concatenate((np.arange(0.05, 0.5, 0.05), np.arange(0.5, 1.01, 0.1)))
"""Candidates for the weight of the newest sample in the average.

The benchmark uses the weight with the smallest true error.
"""
TENSION_RATE_NOISES = np.array([30.0, 100.0, 300.0, 1000.0, 3000.0])
"""Candidates for the square root of the spectral density of the noise of the tension rate [N/s^1.5].

The benchmark uses the candidate with the smallest true error.
"""


def exponential_average(raw: Array, weight: float) -> Array:
    """Return the exponential average of the samples (ticks, N) [N]. Missing samples are skipped."""
    smooth = np.empty_like(raw)
    last = np.nan_to_num(raw[0])
    for k, sample in enumerate(raw):
        last = last + weight * np.where(np.isnan(sample), 0.0, sample - last)
        smooth[k] = last
    return smooth


def cell_only_estimate(raw: Array, period: float, noise: float, rate: float) -> Array:
    """Run a Kalman filter of tension and tension rate, whose only measurement is the load cell.

    Return the prediction of the filter for the present tension, (ticks, N) [N].

    Args:
        raw: (ticks, N) samples, one period old [N].
        period: control period [s].
        noise: standard deviation of a sample [N].
        rate: square root of the spectral density of the noise of the tension rate [N/s^1.5].
    """
    F = np.array([[1.0, period], [0.0, 1.0]])
    Q = rate**2 * np.array([[period**3 / 3, period**2 / 2], [period**2 / 2, period]])
    P = solve_discrete_are(F.T, np.array([[1.0], [0.0]]), Q, np.array([[noise**2]]))
    gain = P[:, 0] / (P[0, 0] + noise**2)
    f = np.nan_to_num(raw[0])
    df = np.zeros(raw.shape[1])
    out = np.empty_like(raw)
    for k, sample in enumerate(raw):
        innovation = np.where(np.isnan(sample), 0.0, sample - f)
        f = f + gain[0] * innovation
        df = df + gain[1] * innovation
        f = f + period * df
        out[k] = f
    return out
