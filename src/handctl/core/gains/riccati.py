"""Solutions of the Riccati equation by the package ``control``.

The solutions are feedback gains, and covariances of the Kalman filter.
"""

import numpy as np

from handctl.core.deferred_imports import DeferredModule, import_without_package_init
from handctl.core.tick_types import Vector

# The functions control.dlqr and control.dlqe call the same solver of the Riccati equation. An
# import of the whole package control would also import matplotlib and scipy.signal, which takes
# longer than the design of the gains.
_matrix_equations = DeferredModule("control.mateqn", import_without_package_init)


def solve_lqr(F: Vector, G: Vector, Q: Vector, R: Vector) -> Vector:
    """Return the gain (m, n) of the state feedback u = -K x that minimises the sum of x' Q x + u' R u.

    Args:
        F: (n, n) transition of the states over a period.
        G: (n, m) effect of the inputs on the states over a period.
        Q: (n, n) weights of the states in the sum.
        R: (m, m) weights of the inputs in the sum.

    Raises:
        ValueError: no stabilising solution exists, or a number is not finite.
    """
    _, _, K = _matrix_equations.dare(
        F, G, Q, R, np.zeros((len(Q), len(R))), method="scipy", _Ss="N"
    )
    return np.asarray(K)


def solve_covariance(F: Vector, H: Vector, Q: Vector, R: Vector) -> Vector:
    """Return the covariance (n, n) of the prediction of a Kalman filter in steady state.

    Args:
        F: (n, n) transition of the states over a period.
        H: (m, n) expected measurements per unit of each state.
        Q: (n, n) covariance of the process noise of a period.
        R: (m, m) covariance of the errors of the measurements.

    Raises:
        ValueError: no solution exists, or a number is not finite.
    """
    P, _, _ = _matrix_equations.dare(
        F.T, H.T, Q, R, method="scipy", _Bs="C", _Qs="QN", _Rs="RN", _Ss="NN"
    )
    return np.asarray(P)
