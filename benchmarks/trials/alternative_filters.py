"""Alternatives to the controller's tension filter: an exponential average, and a filter on the load cell alone."""

import numpy as np
from scipy.linalg import solve_discrete_are

from trials.lockstep_trial import FloatArray

AVERAGE_WEIGHTS = np.concatenate((np.arange(0.05, 0.5, 0.05), np.arange(0.5, 1.01, 0.1)))
"""Candidates for the weight of the newest sample in the average.

The benchmark uses the weight that gives the smallest true error of the tension.
"""
TENSION_RATE_NOISES = np.array([30.0, 100.0, 300.0, 1000.0, 3000.0])
"""Candidates for the square root of the spectral density of the noise of the tension rate [N/s^1.5].

The benchmark uses the candidate that gives the smallest true error of the tension.
"""


def exponential_average(raw_tension: FloatArray, sample_weight: float) -> FloatArray:
    """Return the exponential average of load-cell samples [N].

    The average skips missing samples. The result is an array (ticks, tendons).
    """
    smoothed_tension = np.empty_like(raw_tension)
    last_tension = np.nan_to_num(raw_tension[0])
    for k, sample in enumerate(raw_tension):
        last_tension = last_tension + sample_weight * np.where(
            np.isnan(sample), 0.0, sample - last_tension
        )
        smoothed_tension[k] = last_tension
    return smoothed_tension


def cell_only_estimate(
    raw_tension: FloatArray, period_s: float, cell_noise: float, tension_rate_noise: float
) -> FloatArray:
    """Run a Kalman filter of tension and tension rate, whose only measurement is the load cell.

    Return the tension [N] that the filter predicts for the present, as an array (ticks, tendons).

    Args:
        raw_tension: load-cell samples [N], an array (ticks, tendons). The samples are one control
            period old.
        period_s: control period [s].
        cell_noise: standard deviation of the noise of a load-cell sample [N].
        tension_rate_noise: square root of the spectral density of the noise of the tension rate [N/s^1.5].
    """
    F = np.array([[1.0, period_s], [0.0, 1.0]])
    Q = tension_rate_noise**2 * np.array(
        [[period_s**3 / 3, period_s**2 / 2], [period_s**2 / 2, period_s]]
    )
    P = solve_discrete_are(F.T, np.array([[1.0], [0.0]]), Q, np.array([[cell_noise**2]]))
    gain = P[:, 0] / (P[0, 0] + cell_noise**2)
    f = np.nan_to_num(raw_tension[0])
    df = np.zeros(raw_tension.shape[1])
    tension_estimate = np.empty_like(raw_tension)
    for k, sample in enumerate(raw_tension):
        innovation = np.where(np.isnan(sample), 0.0, sample - f)
        f = f + gain[0] * innovation
        df = df + gain[1] * innovation
        f = f + period_s * df
        tension_estimate[k] = f
    return tension_estimate
