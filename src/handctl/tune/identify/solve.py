"""Solving a fit and judging it.

Intervals come from the spread of the residuals' scores in blocks of time, so that what the model lacks widens them, and
not from the assumption that every row is a new measurement.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

Array = NDArray[np.float64]

FREEDOM_LEAST = 3.0
"""Fewest degrees of freedom that an interval is given."""
LEAST_SHARE = 1e-9
"""Of the data in a parameter's variance, squared: below it the parameter is known from its prior alone."""
STEPS = 40
"""Most steps of the solver; data that need more do not tell what they are asked for."""
OUTLIER = 2.5
"""Residuals beyond so many standard deviations count less and less: contact that nobody expected."""
BLOCK_S = 0.25
"""Blocks of time whose residuals are taken to be independent of one another."""
MOST_ROWS = 500
"""Rows of one block, whose cost grows with their third power. A run at 500 Hz has up to 375.

A damaged log whose times stand still has all its rows in one block.
"""


@dataclass(frozen=True, slots=True)
class Solution:
    """Scaled parameters and what is known of them.

    Attributes:
        z: (n,). covariance: (n, n). jacobian: (rows, n), weighted. residual: (rows,). freedom: (n,) of each spread.
    """

    z: Array
    covariance: Array
    jacobian: Array
    residual: Array
    freedom: Array


def solve(residuals: Callable[[Array], Array], start: Array, bounds: tuple[Array, Array], times: Array) -> Solution:
    """Least squares in two rounds: a robust one finds the outliers, the second does without them.

    Args:
        residuals: of parameters (n,), in standard deviations: rows of data first, then priors.
        start: (n,).
        bounds: least and greatest parameters.
        times: of every row that is data [s].
    """
    run = partial(least_squares, x_scale="jac", bounds=bounds, max_nfev=STEPS)
    first = run(residuals, start, loss="soft_l1", f_scale=OUTLIER)
    weight = np.ones_like(first.fun)
    weight[: len(times)] = np.abs(first.fun[: len(times)]) < 2.0 * OUTLIER

    def weighted(z: Array) -> Array:
        return residuals(z) * weight

    found = run(weighted, first.x)
    jacobian = np.asarray(found.jac)
    covariance, freedom = _covariance(jacobian, found.fun, times)
    return Solution(found.x, covariance, jacobian, found.fun, freedom)


def _blocks(times: Array) -> Iterator[NDArray[np.intp]]:
    """Yield the rows of each block of time, in parts of at most ``MOST_ROWS``."""
    order = np.floor((times - times.min()) / BLOCK_S).astype(int)
    for block in np.unique(order):
        rows = np.flatnonzero(order == block)
        yield from np.array_split(rows, -(-len(rows) // MOST_ROWS))


def _covariance(jacobian: Array, residual: Array, times: Array) -> tuple[Array, Array]:
    """Covariance of the parameters and its degrees of freedom, from blocks of time and the priors as given.

    Each block is judged by a fit without it. Never less than what independent noise alone would give.

    The freedom is the design's: what each block would add under independent noise of one standard deviation. Taken from
    the residuals, one unlucky block of the fastest sweep would leave fewer than three degrees to the friction.
    Source: the jackknife over clusters in its linear form (Bell & McCaffrey 2002, CR3); Satterthwaite's freedom with
    their working model.
    """
    plain = np.linalg.pinv(jacobian.T @ jacobian, rcond=1e-12)
    middle = jacobian[len(times) :].T @ jacobian[len(times) :]
    expected = [np.diag(plain @ middle @ plain)]
    for rows in _blocks(times):
        part = jacobian[rows]
        left = np.eye(len(rows)) - part @ plain @ part.T
        alone = np.linalg.lstsq(left, np.column_stack([residual[rows], part]), rcond=1e-9)[0]
        score = part.T @ alone[:, 0]
        middle += np.outer(score, score)
        expected.append(np.maximum(np.diag(plain @ part.T @ alone[:, 1:] @ plain), 0.0))
    robust = plain @ middle @ plain
    wider = np.sqrt(np.maximum(np.diag(robust) / np.diag(plain), 1.0))
    shares = np.array(expected) / np.sum(expected, axis=0)
    freedom = 1.0 / np.maximum((shares[1:] ** 2).sum(axis=0), LEAST_SHARE)
    return np.asarray(plain * np.outer(wider, wider)), np.asarray(np.maximum(freedom, FREEDOM_LEAST))
