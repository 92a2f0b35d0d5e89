"""Test the jackknife method, which computes the confidence intervals of a fit.

The jackknife method divides the rows of a log into short time blocks. For each block, the method
computes the residuals of a fit without the rows of this block.

In a damaged log, all rows can have nearly the same time, so that all rows are in one time block.
"""

import time

import numpy as np
import pytest

from handctl.tune.identify.least_squares import (
    MAX_BLOCK_ROWS,
    NOISE_BLOCK_S,
    _parameter_covariance,
    _rows_by_time_block,
)


@pytest.mark.parametrize("seed", range(20))
def test_rows_are_in_one_block_each(seed: int) -> None:
    random = np.random.default_rng(seed)
    times = np.sort(random.uniform(0.0, random.choice([0.01, 1.0, 20.0]), 3000))
    blocks = list(_rows_by_time_block(times))
    assert sorted(np.concatenate(blocks).tolist()) == list(range(3000))
    assert max(map(len, blocks)) <= MAX_BLOCK_ROWS
    assert all(np.ptp(times[rows]) <= NOISE_BLOCK_S for rows in blocks)


@pytest.mark.parametrize("time_span_s", [0.0, 0.1, 20.0])
def test_equal_times_take_a_few_seconds_at_most(time_span_s: float) -> None:
    """Reproduce a defect: if 4000 rows were in one time block, the jackknife method took minutes."""
    random = np.random.default_rng(0)
    jacobian, residual = random.normal(size=(4010, 10)), random.normal(size=4010)
    begin = time.process_time()
    covariance, degrees_of_freedom = _parameter_covariance(
        jacobian, residual, np.linspace(0.0, time_span_s, 4000)
    )
    assert time.process_time() - begin < 20.0
    assert np.isfinite(covariance).all()
    assert np.isfinite(degrees_of_freedom).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_block_with_large_residuals_leaves_the_degrees_of_freedom(seed: int) -> None:
    """A time block with large residuals does not reduce the number of degrees of freedom.

    Earlier defect: a block with large residuals left only three degrees of freedom, so the
    confidence intervals were 1.5 times as wide.
    """
    random = np.random.default_rng(seed)
    jacobian, times = (
        random.normal(size=(2000, 3)),
        np.linspace(0.0, 20.0 * NOISE_BLOCK_S, 2000, endpoint=False),
    )
    residual = random.normal(size=2000)
    residual_with_large_block = residual * np.where(
        (times > NOISE_BLOCK_S) & (times < 2.0 * NOISE_BLOCK_S), 6.0, 1.0
    )
    _, degrees_of_freedom = _parameter_covariance(jacobian, residual, times)
    _, degrees_with_large_block = _parameter_covariance(jacobian, residual_with_large_block, times)
    assert degrees_with_large_block == pytest.approx(degrees_of_freedom)
    assert (degrees_of_freedom > 14.0).all()
    assert (degrees_of_freedom < 21.0).all()


def test_a_parameter_without_data_has_a_spread_of_its_prior() -> None:
    """A parameter on which the data do not depend keeps the standard deviation of its prior.

    Earlier defect: if a digit had hardly moved, the fit of the digit's data caused an overflow
    warning.
    """
    jacobian = np.vstack([np.column_stack([np.ones(100), np.full(100, 1e-160)]), np.eye(2)])
    with np.errstate(all="raise", under="ignore"):
        covariance, degrees_of_freedom = _parameter_covariance(
            jacobian, np.ones(102), np.linspace(0.0, 5.0, 100)
        )
    assert np.isfinite(covariance).all()
    assert degrees_of_freedom[0] < 30.0 < 1e6 < degrees_of_freedom[1] < np.inf
