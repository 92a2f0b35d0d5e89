"""Compute the model and the filter gain of a tendon independently of handctl.

The independent implementation covers the differential equations of a tendon and the steady-state
Kalman gain.
"""

import numpy as np
from scipy.integrate import solve_ivp

from handctl.core.estimation.filter_types import (
    STATE_COUNT,
    D,
    E,
    FilterBlock,
    O,
    TendonRegime,
    V,
    W,
)
from handctl.core.hand_model import HandModel

FILTER_STATE_UNITS = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1.0, 0.1, 1e-5])
"""Unit of each of the seven filter states.

In the units of ``FILTER_STATE_UNITS``, the values of all filter states are of the order of one.
"""


def rates_of_change(
    model: HandModel,
    tendon_index: int,
    regime: TendonRegime,
    tendon_state: np.ndarray,
    motor_force: float,
    planned_rate: float,
) -> np.ndarray:
    """Return the time derivatives of the seven filter states of the tendon ``tendon_index``."""
    space, gains = model.tendon_constants, model.gains.filter
    x, v, s, w, d, e, o = tendon_state
    f = 0.0
    if regime != TendonRegime.SLACK:
        f = space.stiffness[tendon_index] * (x - s - o) + space.damping[tendon_index] * (v - w)
    dv = (motor_force + d - f - space.motor_damping[tendon_index] * v) / space.motor_mass[
        tendon_index
    ]
    if regime == TendonRegime.FREE:
        ds, dw = w - planned_rate / space.stiffness[tendon_index], dv - (w - v) / gains.free_time_s
    else:
        ds, dw = w - s / 1e4, -w / gains.held_time_s
    return np.array([v, dv, ds, dw, -d / unknown_motor_force(model, regime)[1], -e / 1e4, -o / 1e4])


def unknown_motor_force(model: HandModel, regime: TendonRegime) -> tuple[float, float, float]:
    """Return three parameters of the unknown force on a motor.

    The unknown force is the sum of a Gauss-Markov force and white noise. The parameters are the
    standard deviation [N] and the time constant [s] of the Gauss-Markov force, and the white force
    noise [N].
    """
    kind = "held" if regime == TendonRegime.HELD else "motor"
    names = ("disturbance_N", "disturbance_time_s", "acceleration_noise_N")
    return tuple(getattr(model.gains.filter, f"{kind}_{name}") for name in names)


def differential_equation_matrices(
    model: HandModel, tendon_index: int, regime: TendonRegime
) -> tuple[np.ndarray, np.ndarray]:
    """Determine the matrices A and B of the linear differential equations of a tendon, column by column."""
    zero = np.zeros(STATE_COUNT)
    A = np.column_stack(
        [
            rates_of_change(model, tendon_index, regime, unit_vector, 0.0, 0.0)
            for unit_vector in np.eye(STATE_COUNT)
        ]
    )
    return A, np.column_stack(
        [rates_of_change(model, tendon_index, regime, zero, *u) for u in ((1.0, 0.0), (0.0, 1.0))]
    )


def process_noise_density(model: HandModel, tendon_index: int, regime: TendonRegime) -> np.ndarray:
    """Return the spectral density of the process noise (STATES, STATES).

    The density of a Gauss-Markov state with standard deviation sigma and time constant tau is 2
    sigma^2 / tau. The density of a random walk with standard deviation sigma after the time tau is
    sigma^2 / tau. A digit without contact follows the spool of its tendon, so the noise of the
    spool speed also acts on the digit.
    """
    space, gains = model.tendon_constants, model.gains.filter
    disturbance, time_constant_s, force_noise = unknown_motor_force(model, regime)
    spool = np.zeros(STATE_COUNT)
    spool[V] = force_noise / space.motor_mass[tendon_index]
    digit = np.zeros(STATE_COUNT)
    if regime == TendonRegime.FREE:
        spool[W] = spool[V]
        digit[W] = (
            np.sqrt(2 / gains.free_time_s) * gains.free_rate_N_per_s / space.stiffness[tendon_index]
        )
    else:
        digit[W] = np.sqrt(2 / gains.held_time_s) * gains.held_speed_m_s
    unit = np.eye(STATE_COUNT)
    sources = [
        spool,
        digit,
        unit[D] * disturbance * np.sqrt(2 / time_constant_s),
        unit[E] * gains.cell_drift_N / np.sqrt(gains.cell_drift_time_s),
        unit[O] * gains.offset_m * np.sqrt(2 / gains.offset_time_s),
    ]
    return sum(np.outer(source, source) for source in sources)


def integrate_one_period(
    model: HandModel, tendon_index: int, regime: TendonRegime
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return transition matrix F, input matrix B and noise covariance of one control period, in scaled units.

    A Runge-Kutta method integrates the differential equations of the tendon over the control
    period.
    """
    A, B = differential_equation_matrices(model, tendon_index, regime)
    A, B = A * FILTER_STATE_UNITS / FILTER_STATE_UNITS[:, None], B / FILTER_STATE_UNITS[:, None]
    Q = process_noise_density(model, tendon_index, regime) / np.outer(
        FILTER_STATE_UNITS, FILTER_STATE_UNITS
    )
    n, m = B.shape

    def derivatives_of_matrices(t: float, y: np.ndarray) -> np.ndarray:
        F, G, P = (
            y[: n * n].reshape(n, n),
            y[n * n : n * (n + m)].reshape(n, m),
            y[n * (n + m) :].reshape(n, n),
        )
        return np.concatenate([(A @ F).ravel(), (A @ G + B).ravel(), (A @ P + P @ A.T + Q).ravel()])

    start = np.concatenate([np.eye(n).ravel(), np.zeros(n * m), np.zeros(n * n)])
    end = solve_ivp(
        derivatives_of_matrices, (0.0, model.period), start, method="DOP853", rtol=1e-11, atol=1e-13
    ).y[:, -1]
    return (
        end[: n * n].reshape(n, n),
        end[n * n : n * (n + m)].reshape(n, m),
        end[n * (n + m) :].reshape(n, n),
    )


def measurement_noise(model: HandModel, tendon_index: int) -> np.ndarray:
    """Return the standard deviations of encoder and load cell that the design of the filter gain assumes."""
    space, gains = model.tendon_constants, model.gains.filter
    return np.array(
        [
            space.encoder_step[tendon_index] * gains.encoder_noise_counts,
            space.tension_noise[tendon_index],
        ]
    )


def covariance_by_doubling(
    F: np.ndarray, H: np.ndarray, Q: np.ndarray, R: np.ndarray
) -> np.ndarray:
    """Return the steady-state covariance of a Kalman filter's prediction, by structured doubling (Anderson 1978)."""
    A, G, P = F.T, H.T @ np.linalg.solve(R, H), Q
    for _ in range(60):
        inner_matrix = np.linalg.inv(np.eye(len(A)) + G @ P)
        A, G, next_covariance = (
            A @ inner_matrix @ A,
            G + A @ inner_matrix @ G @ A.T,
            P + A.T @ P @ inner_matrix @ A,
        )
        if np.abs(next_covariance - P).max() <= 1e-14 * np.abs(next_covariance).max():
            return next_covariance
        P = next_covariance
    raise AssertionError("the Riccati equation did not converge")


def assumed_measurements(block: FilterBlock, regime: TendonRegime) -> np.ndarray:
    """Return the measurement matrix H (2, 7) that the design of the filter gain assumes.

    The measurement matrix H has an entry for the load-cell error only if the tendon is slack.
    """
    H = block.H[:2].copy()
    H[1, E] = float(regime == TendonRegime.SLACK)
    return H


def joseph_update(
    block: FilterBlock, P: np.ndarray, is_missing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the Kalman gain (7, 2), and the covariance after an update with the readings of encoder and load cell.

    ``is_missing`` (2,) marks missing readings of encoder and load cell.

    The filter can distinguish a load-cell error from tension only in a slack tendon. In a taut
    tendon, the filter does not correct the estimated load-cell error, but uses the variance of this
    estimate.
    """
    H, R = block.H[:2].copy(), np.diag(block.R * np.where(is_missing, 1e12, 1.0))
    H[1, E] = float(block.is_cell_error_observable)
    gain = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    gain[E] *= float(block.is_cell_error_observable)
    remaining_fraction = np.eye(STATE_COUNT) - gain @ H
    return gain, remaining_fraction @ P @ remaining_fraction.T + gain @ R @ gain.T


def assert_same_covariance(computed: np.ndarray, expected: np.ndarray) -> None:
    """Assert that two arrays of covariances (..., n, n) agree.

    The permitted difference of an element is 1e-9 times the product of the standard deviations of
    its two states.
    """
    sigma = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
    size = sigma[..., :, None] * sigma[..., None, :]
    np.testing.assert_array_less(np.abs(computed - expected), 1e-9 * size + 1e-300)
