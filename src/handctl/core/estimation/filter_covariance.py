"""Propagation of the covariance of the tension filter after a missing measurement.

The steady-state gains of the filter assume a measurement in every tick. If measurements come only
in every second tick, the steady-state gains overestimate the error of the speed. With steady-state
gains, the filter would correct the speed for too long, and the estimate would oscillate or diverge.
From the first missing measurement on, the covariances of all tendons are propagated, and the gains
follow from the propagated covariances. The propagation of the covariances ends when all covariances
are close to their steady values.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.filter_types import STATE_COUNT, E
from handctl.core.state_block import StateTables

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

CELL_ERROR = E
"""Index of the load-cell error among the states of a tendon."""
MISSING_READING_VARIANCE_FACTOR = 1e12
"""Factor on the variance of a missing measurement.

The factor makes the Kalman gain of a missing measurement practically zero.
"""
STEADY_VARIANCE_TOLERANCE = 0.02
"""Largest relative difference between a variance and its steady value at which a covariance counts as steady."""
MAX_TORQUE_HOLD_TIME_S = 0.05
"""Longest time without a command over which states are predicted [s].

If no command comes for 0.05 s, the watchdogs of the drives remove the torque.
"""


@kernel_helper
def correct_tendon_covariance(
    x: StateTables,
    c: ConstantTables,
    n: int,
    z: Vector,
    gain: Matrix,
    predicted_covariances: Matrix,
    information: Vector,
) -> float:
    """Correct the covariance of a tendon by the measurements of its encoder and its load cell.

    The gain for the joint encoders stays unchanged.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        z: (3,) measurements, NaN if missing.
        gain: (7, 3) steady gains. The function replaces the first two columns of the gain, which
            belong to the encoder and the load cell.
        predicted_covariances: (7, 7) result: covariance after the correction.
        information: (3,) result: inverse covariance of the two innovations, see
            ``constants.INFORMATION_OFFSET``.

    Returns:
        Standard deviation of the difference between measured and expected load-cell reading [N].
    """
    kind = x.tendon_int[s.FILTER_KIND, n]
    H = np.zeros((2, STATE_COUNT))
    for m in range(2):
        for i in range(STATE_COUNT):
            H[m, i] = c.design[n, kind, h.MEASUREMENT_MATRIX_OFFSET + STATE_COUNT * m + i]
    is_cell_error_observable = c.design[n, kind, h.CELL_ERROR_OBSERVABLE_OFFSET]
    H[1, CELL_ERROR] = is_cell_error_observable
    P = _present_covariance(x, c, n, kind)
    state_measurement_covariance = _multiply_by_transposed(P, H)
    innovation_covariance = _multiply_matrices(H, state_measurement_covariance)
    R = np.zeros(2)
    for m in range(2):
        R[m] = c.design[n, kind, h.MEASUREMENT_NOISE_OFFSET + m] * (
            MISSING_READING_VARIANCE_FACTOR if math.isnan(z[m]) else 1.0
        )
    # The inverse of the innovation covariance [[a, b], [b, d]] is computed by a formula.
    a = innovation_covariance[0, 0] + R[0]
    b = innovation_covariance[0, 1]
    d = innovation_covariance[1, 1] + R[1]
    determinant = a * d - b * b
    information[0] = d / determinant
    information[1] = -2.0 * b / determinant
    information[2] = a / determinant
    for i in range(STATE_COUNT):
        # If no measurement distinguishes a load-cell error from tension, the load-cell error is not
        # corrected, and its variance grows.
        is_observable = is_cell_error_observable if i == CELL_ERROR else 1.0
        gain[i, 0] = (
            is_observable
            * (state_measurement_covariance[i, 0] * d - state_measurement_covariance[i, 1] * b)
            / determinant
        )
        gain[i, 1] = (
            is_observable
            * (state_measurement_covariance[i, 1] * a - state_measurement_covariance[i, 0] * b)
            / determinant
        )
    identity_minus_correction = np.zeros((STATE_COUNT, STATE_COUNT))
    for i in range(STATE_COUNT):
        for j in range(STATE_COUNT):
            identity_minus_correction[i, j] = (1.0 if i == j else 0.0) - (
                gain[i, 0] * H[0, j] + gain[i, 1] * H[1, j]
            )
    # The Joseph form of the covariance is (I - K H) P (I - K H)^T + K R K^T. The Joseph form is
    # symmetric and positive for any gain, even for a gain that leaves the load-cell error
    # uncorrected (Schmidt's consider filter).
    joseph_term = _multiply_by_transposed(
        _multiply_matrices(identity_minus_correction, P), identity_minus_correction
    )
    for i in range(STATE_COUNT):
        for j in range(STATE_COUNT):
            predicted_covariances[i, j] = (
                joseph_term[i, j] + gain[i, 0] * R[0] * gain[j, 0] + gain[i, 1] * R[1] * gain[j, 1]
            )
    return math.sqrt(d)


@kernel_helper
def predict_covariances(
    x: StateTables, c: ConstantTables, predicted_covariances: Matrix, missed_ticks: int
) -> None:
    """Predict the covariances (N, 7, 7) of all tendons to the next tick.

    End the propagation if all covariances are steady.

    If the filter design of a tendon has changed, the covariance of the tendon is set to the
    constant covariance of the new design.
    """
    periods = 1 + ticks_to_predict(c, missed_ticks)
    are_all_steady = True
    for n in range(len(predicted_covariances)):
        kind = x.tendon_int[s.FILTER_KIND, n]
        F = _copy_design_matrix(c, n, kind, h.TRANSITION_MATRIX_OFFSET)
        Q = _copy_design_matrix(c, n, kind, h.PROCESS_NOISE_OFFSET)
        P = predicted_covariances[n]
        for _ in range(periods):
            P = _multiply_by_transposed(_multiply_matrices(F, P), F)
            for i in range(STATE_COUNT):
                for j in range(STATE_COUNT):
                    P[i, j] += Q[i, j]
        # The covariance before the change of the filter design belongs to the old design.
        if kind != x.tendon_int[s.LAST_FILTER_KIND, n]:
            P = _copy_design_matrix(c, n, kind, h.COVARIANCE_OFFSET)
        for i in range(STATE_COUNT):
            for j in range(STATE_COUNT):
                x.tendon[s.COVARIANCE + STATE_COUNT * i + j, n] = P[i, j]
        are_all_steady &= _is_steady(c, n, kind, P)
    x.run_int[s.COVARIANCE_PROPAGATED] = not are_all_steady


@kernel_helper
def ticks_to_predict(c: ConstantTables, missed_ticks: int) -> int:
    """Return the number of missed ticks over which the covariance is predicted."""
    return min(missed_ticks, round(MAX_TORQUE_HOLD_TIME_S / c.run[h.CONTROL_PERIOD]))


@kernel_helper
def predicted_tension_sigma(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the standard deviation of a tendon's predicted tension, computed from the propagated covariance [N]."""
    kind = x.tendon_int[s.FILTER_KIND, n]
    P = np.empty((STATE_COUNT, STATE_COUNT))
    for i in range(STATE_COUNT):
        for j in range(STATE_COUNT):
            P[i, j] = x.tendon[s.COVARIANCE + STATE_COUNT * i + j, n]
    return math.sqrt(
        _tension_variance(c, n, kind, P) + c.design[n, kind, h.CELL_ERROR_VARIANCE_OFFSET]
    )


@kernel_helper
def _present_covariance(x: StateTables, c: ConstantTables, n: int, design_kind: int) -> Matrix:
    """Return the covariance (7, 7) of a tendon's predicted states.

    While the covariance is propagated from tick to tick, the result is the propagated covariance.
    Otherwise, the result is the constant covariance of the filter design.
    """
    P = _copy_design_matrix(c, n, design_kind, h.COVARIANCE_OFFSET)
    if x.run_int[s.COVARIANCE_PROPAGATED]:
        for i in range(STATE_COUNT):
            for j in range(STATE_COUNT):
                P[i, j] = x.tendon[s.COVARIANCE + STATE_COUNT * i + j, n]
    return P


@kernel_helper
def _is_steady(c: ConstantTables, n: int, design_kind: int, P: Matrix) -> bool:
    steady_covariance = _copy_design_matrix(c, n, design_kind, h.COVARIANCE_OFFSET)
    for i in range(STATE_COUNT):
        is_observable = (
            c.design[n, design_kind, h.CELL_ERROR_OBSERVABLE_OFFSET] if i == CELL_ERROR else 1.0
        )
        if (
            abs(P[i, i] - steady_covariance[i, i]) * is_observable
            > STEADY_VARIANCE_TOLERANCE * steady_covariance[i, i] * is_observable
        ):
            return False
    variance = _tension_variance(c, n, design_kind, steady_covariance)
    return (
        abs(_tension_variance(c, n, design_kind, P) - variance)
        <= STEADY_VARIANCE_TOLERANCE * variance
    )


@kernel_helper
def _tension_variance(c: ConstantTables, n: int, design_kind: int, P: Matrix) -> float:
    variance = 0.0
    for i in range(STATE_COUNT):
        for j in range(STATE_COUNT):
            variance += (
                c.design[n, design_kind, h.TENSION_ROW_OFFSET + i]
                * P[i, j]
                * c.design[n, design_kind, h.TENSION_ROW_OFFSET + j]
            )
    return variance


@kernel_helper
def _copy_design_matrix(c: ConstantTables, n: int, design_kind: int, first_column: int) -> Matrix:
    """Return a copy of a (7, 7) matrix of a tendon's filter design."""
    matrix = np.empty((STATE_COUNT, STATE_COUNT))
    for i in range(STATE_COUNT):
        for j in range(STATE_COUNT):
            matrix[i, j] = c.design[n, design_kind, first_column + STATE_COUNT * i + j]
    return matrix


@kernel_helper
def _multiply_matrices(left_matrix: Matrix, right_matrix: Matrix) -> Matrix:
    """Return the product of two matrices.

    The products of the matrix elements are always added in the same order, so that equal inputs
    give equal results.
    """
    matrix = np.zeros((left_matrix.shape[0], right_matrix.shape[1]))
    for i in range(left_matrix.shape[0]):
        for j in range(right_matrix.shape[1]):
            for k in range(left_matrix.shape[1]):
                matrix[i, j] += left_matrix[i, k] * right_matrix[k, j]
    return matrix


@kernel_helper
def _multiply_by_transposed(left_matrix: Matrix, right_matrix: Matrix) -> Matrix:
    """Return the product of a matrix and a transposed matrix."""
    matrix = np.zeros((left_matrix.shape[0], right_matrix.shape[0]))
    for i in range(left_matrix.shape[0]):
        for j in range(right_matrix.shape[0]):
            for k in range(left_matrix.shape[1]):
                matrix[i, j] += left_matrix[i, k] * right_matrix[j, k]
    return matrix
