"""The filter's covariance where it is not the steady one: while measurements are missing, and until that is made up.

The steady gains are those of a measurement in every tick. Of one that comes every second tick only they would take a
speed to be wrong by twice as much as it is, and correct it for longer than they mean to: an estimate that swings, or
worse. So once something is missing every tendon's covariance is carried along, until it is the steady one again.
"""

import math

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STATES = 7
ERROR = 5
"""Index of the load cell's error among the states."""
MISSING = 1e12
"""Variance factor of a missing measurement. It makes the Kalman gain zero."""
STEADY_FRACTION = 0.02
"""A covariance is steady if none of its variances, nor that of the tension, is further from the steady one."""
HELD_TORQUE_S = 0.05
"""Longest time without a command that is predicted [s]; then the drives' watchdogs have let go."""


@inner
def update(x: Tables, c: ConstantTables, n: int, z: Vector, gain: Matrix, after: Matrix, information: Vector) -> float:
    """Take in encoder and load cell of one tendon; joint encoders keep their steady gain.

    Args:
        x: tables. c: constants. n: index of the tendon.
        z: (3,) measurements, NaN where missing.
        gain: (7, 3) steady gains, of which the first two columns are replaced.
        after: (7, 7) result: covariance once the measurements were used.
        information: (3,) result: inverse covariance of the innovations, see ``constants.INFORMATION_AT``.

    Returns:
        standard deviation of the load-cell innovation [N].
    """
    kind = x.tendon_int[s.KIND, n]
    H = np.zeros((2, STATES))
    for m in range(2):
        for i in range(STATES):
            H[m, i] = c.design[n, kind, h.H_AT + STATES * m + i]
    known = c.design[n, kind, h.KNOWN_AT]
    H[1, ERROR] = known
    P = _present(x, c, n, kind)
    crossed = _times_transposed(P, H)
    size = _times(H, crossed)
    R = np.zeros(2)
    for m in range(2):
        R[m] = c.design[n, kind, h.R_AT + m] * (MISSING if math.isnan(z[m]) else 1.0)
    a, b, d = size[0, 0] + R[0], size[0, 1], size[1, 1] + R[1]
    determinant = a * d - b * b
    information[0], information[1], information[2] = d / determinant, -2.0 * b / determinant, a / determinant
    for i in range(STATES):
        # What cannot be told from tension is not corrected, and its growth counts in the variance.
        told = known if i == ERROR else 1.0
        gain[i, 0] = told * (crossed[i, 0] * d - crossed[i, 1] * b) / determinant
        gain[i, 1] = told * (crossed[i, 1] * a - crossed[i, 0] * b) / determinant
    rest = np.zeros((STATES, STATES))
    for i in range(STATES):
        for j in range(STATES):
            rest[i, j] = (1.0 if i == j else 0.0) - (gain[i, 0] * H[0, j] + gain[i, 1] * H[1, j])
    joseph = _times_transposed(_times(rest, P), rest)
    for i in range(STATES):
        for j in range(STATES):
            after[i, j] = joseph[i, j] + gain[i, 0] * R[0] * gain[j, 0] + gain[i, 1] * R[1] * gain[j, 1]
    return math.sqrt(d)


@inner
def predict(x: Tables, c: ConstantTables, after: Matrix, missed: int) -> None:
    """Predict all covariances (N, 7, 7) to the next tick; end that once all of them are the steady ones.

    A tendon whose kind has just changed begins with the steady one.
    """
    periods = 1 + skipped(c, missed)
    steady = True
    for n in range(len(after)):
        kind = x.tendon_int[s.KIND, n]
        F, Q = _square(c, n, kind, h.F_AT), _square(c, n, kind, h.Q_AT)
        P = after[n]
        for _ in range(periods):
            P = _times_transposed(_times(F, P), F)
            for i in range(STATES):
                for j in range(STATES):
                    P[i, j] += Q[i, j]
        if kind != x.tendon_int[s.KIND_BEFORE, n]:
            P = _square(c, n, kind, h.P_AT)
        for i in range(STATES):
            for j in range(STATES):
                x.tendon[s.COVARIANCE + STATES * i + j, n] = P[i, j]
        steady &= _is_steady(c, n, kind, P)
    x.run_int[s.CARRIED] = not steady


@inner
def skipped(c: ConstantTables, missed: int) -> int:
    """Return how many of the missed ticks are predicted one by one."""
    return min(missed, round(HELD_TORQUE_S / c.run[h.PERIOD]))


@inner
def sigma(x: Tables, c: ConstantTables, n: int) -> float:
    """Return the standard deviation of a predicted tension [N]."""
    kind = x.tendon_int[s.KIND, n]
    P = np.empty((STATES, STATES))
    for i in range(STATES):
        for j in range(STATES):
            P[i, j] = x.tendon[s.COVARIANCE + STATES * i + j, n]
    return math.sqrt(_tension_variance(c, n, kind, P) + c.design[n, kind, h.DRIFT_AT])


@inner
def _present(x: Tables, c: ConstantTables, n: int, kind: int) -> Matrix:
    """Return the covariance (7, 7) of a tendon's prediction: the one that is carried, or the steady one."""
    P = _square(c, n, kind, h.P_AT)
    if x.run_int[s.CARRIED]:
        for i in range(STATES):
            for j in range(STATES):
                P[i, j] = x.tendon[s.COVARIANCE + STATES * i + j, n]
    return P


@inner
def _is_steady(c: ConstantTables, n: int, kind: int, P: Matrix) -> bool:
    steady = _square(c, n, kind, h.P_AT)
    for i in range(STATES):
        told = c.design[n, kind, h.KNOWN_AT] if i == ERROR else 1.0
        if abs(P[i, i] - steady[i, i]) * told > STEADY_FRACTION * steady[i, i] * told:
            return False
    variance = _tension_variance(c, n, kind, steady)
    return abs(_tension_variance(c, n, kind, P) - variance) <= STEADY_FRACTION * variance


@inner
def _tension_variance(c: ConstantTables, n: int, kind: int, P: Matrix) -> float:
    variance = 0.0
    for i in range(STATES):
        for j in range(STATES):
            variance += c.design[n, kind, h.TENSION_AT + i] * P[i, j] * c.design[n, kind, h.TENSION_AT + j]
    return variance


@inner
def _square(c: ConstantTables, n: int, kind: int, at: int) -> Matrix:
    """Return a copy of a (7, 7) matrix of the design."""
    found = np.empty((STATES, STATES))
    for i in range(STATES):
        for j in range(STATES):
            found[i, j] = c.design[n, kind, at + STATES * i + j]
    return found


@inner
def _times(left: Matrix, right: Matrix) -> Matrix:
    """Return the product of two matrices, by sums in a fixed order."""
    found = np.zeros((left.shape[0], right.shape[1]))
    for i in range(left.shape[0]):
        for j in range(right.shape[1]):
            for k in range(left.shape[1]):
                found[i, j] += left[i, k] * right[k, j]
    return found


@inner
def _times_transposed(left: Matrix, right: Matrix) -> Matrix:
    """Return the product of a matrix and the transpose of another one."""
    found = np.zeros((left.shape[0], right.shape[0]))
    for i in range(left.shape[0]):
        for j in range(right.shape[0]):
            for k in range(left.shape[1]):
                found[i, j] += left[i, k] * right[j, k]
    return found
