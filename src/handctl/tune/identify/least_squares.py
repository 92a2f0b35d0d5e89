"""Solution of a least-squares fit, and the uncertainty of the fitted parameters.

The confidence intervals follow from the variation of the residuals between blocks of time.
Therefore errors of the model widen the intervals, and the intervals are also right for rows of data
that are not independent.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]

MIN_DEGREES_OF_FREEDOM = 3.0
"""Smallest number of degrees of freedom of a confidence interval."""
MIN_VARIANCE_FRACTION = 1e-9
"""Lower bound of the squared contribution of the data to the variance of a parameter.

If the contribution of the data is below the bound, only the prior determines the parameter.
"""
MAX_SOLVER_STEPS = 40
"""Largest number of evaluations by the solver.

If the solver needs more evaluations, the data do not determine the parameters.
"""
OUTLIER_RESIDUAL = 2.5
"""Residual above which a row of data gets less weight, e.g. during an unexpected contact [standard deviations]."""
NOISE_BLOCK_S = 0.25
"""Duration of the blocks of time [s]. Residuals of different blocks count as independent."""
MAX_BLOCK_ROWS = 500
"""Largest number of rows in a block. The computing time increases with the third power of the number of rows.

A block of a run at 500 Hz has up to 375 rows. In a damaged log in which all times are equal, one
block would contain all rows.
"""


@dataclass(frozen=True, slots=True)
class FitSolution:
    """Solution of a least-squares fit: the scaled parameters, and the uncertainty of each parameter.

    Attributes:
        z: (n,) parameters.
        covariance: (n, n) covariance of the parameters.
        jacobian: (rows, n) Jacobian of the residuals. The rows of outliers are zero.
        residual: (rows,) residuals. The rows of outliers are zero.
        degrees_of_freedom: (n,) degrees of freedom of the variance of each parameter.
    """

    z: Array
    covariance: Array
    jacobian: Array
    residual: Array
    degrees_of_freedom: Array


def solve_least_squares(
    residual_function: Callable[[Array], Array],
    start_parameters: Array,
    parameter_bounds: tuple[Array, Array],
    sample_times: Array,
) -> FitSolution:
    """Solve a least-squares problem in two rounds.

    The first round of the solver is robust, and finds the outliers. The second round of the solver
    leaves the outliers out.

    Args:
        residual_function: function from parameters (n,) to residuals in standard deviations. The rows of
            data come first, then the priors.
        start_parameters: (n,) parameters at which the solver starts.
        parameter_bounds: lower and upper bounds of the parameters.
        sample_times: time of every row with measured data [s].
    """
    run = partial(least_squares, x_scale="jac", bounds=parameter_bounds, max_nfev=MAX_SOLVER_STEPS)
    # In the first round, a soft L1 loss limits the effect of outliers.
    first_solution = run(
        residual_function, start_parameters, loss="soft_l1", f_scale=OUTLIER_RESIDUAL
    )
    weight = np.ones_like(first_solution.fun)
    weight[: len(sample_times)] = (
        np.abs(first_solution.fun[: len(sample_times)]) < 2.0 * OUTLIER_RESIDUAL
    )

    def weighted_residuals(z: Array) -> Array:
        return residual_function(z) * weight

    result = run(weighted_residuals, first_solution.x)
    jacobian = np.asarray(result.jac)
    covariance, degrees_of_freedom = _parameter_covariance(jacobian, result.fun, sample_times)
    return FitSolution(result.x, covariance, jacobian, result.fun, degrees_of_freedom)


def _rows_by_time_block(sample_times: Array) -> Iterator[NDArray[np.intp]]:
    """Yield, for each block of time, the indices of its rows.

    A long block is divided into parts of `MAX_BLOCK_ROWS` rows.
    """
    block_of_row = np.floor((sample_times - sample_times.min()) / NOISE_BLOCK_S).astype(int)
    for block in np.unique(block_of_row):
        rows = np.flatnonzero(block_of_row == block)
        yield from np.array_split(rows, -(-len(rows) // MAX_BLOCK_ROWS))


def _parameter_covariance(
    jacobian: Array, residual: Array, sample_times: Array
) -> tuple[Array, Array]:
    """Return the covariance of the parameters, and the degrees of freedom of each parameter's variance.

    The covariance and the degrees of freedom follow from the variation of the residuals between
    blocks of time, and from the prior knowledge.

    The residuals of each block are corrected, so that they equal the residuals of a fit without the
    block. The covariance is never smaller than the covariance for independent noise.

    The degrees of freedom are calculated for independent noise with a standard deviation of 1, and
    not from the residuals. If the degrees of freedom were calculated from the residuals, a single
    block with large residuals would have too much influence. The friction, for example, could have
    fewer than three degrees of freedom.

    Source: Bell & McCaffrey 2002, for the linear jackknife over clusters (CR3), and for
    Satterthwaite's degrees of freedom with a working model of the noise.
    """
    plain_covariance = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12)
    # The rows with prior knowledge are exact by definition. Therefore the rows of the priors enter
    # the middle factor of the sandwich estimator without correction.
    score_covariance = jacobian[len(sample_times) :].T @ jacobian[len(sample_times) :]
    expected = [np.diag(plain_covariance @ score_covariance @ plain_covariance)]
    for rows in _rows_by_time_block(sample_times):
        block_jacobian = jacobian[rows]
        residual_maker = np.eye(len(rows)) - block_jacobian @ plain_covariance @ block_jacobian.T
        # If a single block determines a parameter alone, the matrix (I - H) is singular. Therefore
        # a least-squares solution replaces the inverse of (I - H).
        corrected_columns = np.linalg.lstsq(
            residual_maker, np.column_stack([residual[rows], block_jacobian]), rcond=1e-9
        )[0]
        score = block_jacobian.T @ corrected_columns[:, 0]
        score_covariance += np.outer(score, score)
        expected.append(
            np.maximum(
                np.diag(
                    plain_covariance
                    @ block_jacobian.T
                    @ corrected_columns[:, 1:]
                    @ plain_covariance
                ),
                0.0,
            )
        )
    robust_covariance = plain_covariance @ score_covariance @ plain_covariance
    # The robust covariance can be larger than the covariance for independent noise, but never
    # smaller.
    robust_width_factor = np.sqrt(
        np.maximum(np.diag(robust_covariance) / np.diag(plain_covariance), 1.0)
    )
    variance_fractions = np.array(expected) / np.sum(expected, axis=0)
    degrees_of_freedom = 1.0 / np.maximum(
        (variance_fractions[1:] ** 2).sum(axis=0), MIN_VARIANCE_FRACTION
    )
    return np.asarray(
        plain_covariance * np.outer(robust_width_factor, robust_width_factor)
    ), np.asarray(np.maximum(degrees_of_freedom, MIN_DEGREES_OF_FREEDOM))
