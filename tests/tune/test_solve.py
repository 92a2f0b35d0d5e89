"""The jackknife over blocks of time, also where a damaged log has all its rows in one block."""

import time

import numpy as np
import pytest

from handctl.tune.identify.solve import BLOCK_S, MOST_ROWS, _blocks, _covariance


@pytest.mark.parametrize("seed", range(20))
def test_rows_are_in_one_block_each(seed: int) -> None:
    random = np.random.default_rng(seed)
    times = np.sort(random.uniform(0.0, random.choice([0.01, 1.0, 20.0]), 3000))
    blocks = list(_blocks(times))
    assert sorted(np.concatenate(blocks).tolist()) == list(range(3000))
    assert max(map(len, blocks)) <= MOST_ROWS
    assert all(np.ptp(times[rows]) <= BLOCK_S for rows in blocks)


@pytest.mark.parametrize("span", [0.0, 0.1, 20.0])
def test_times_that_stand_still_cost_no_more_than_seconds(span: float) -> None:
    """4000 rows in one block took minutes."""
    random = np.random.default_rng(0)
    jacobian, residual = random.normal(size=(4010, 10)), random.normal(size=4010)
    begin = time.process_time()
    covariance, freedom = _covariance(jacobian, residual, np.linspace(0.0, span, 4000))
    assert time.process_time() - begin < 20.0
    assert np.isfinite(covariance).all()
    assert np.isfinite(freedom).all()
