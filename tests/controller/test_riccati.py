"""Test that handctl and the Python package ``control`` solve Riccati equations with equal results, to the last bit."""

import control
import numpy as np
import pytest

from handctl.core.gains.riccati import solve_covariance, solve_lqr


@pytest.mark.parametrize("seed", range(8))
def test_solutions_are_those_of_control(seed: int) -> None:
    random = np.random.default_rng(seed)
    n = int(random.integers(1, 8))
    m = int(random.integers(1, n + 1))
    F = np.eye(n) + 0.1 * random.standard_normal((n, n))
    G = random.standard_normal((n, m))
    Q = np.diag(random.uniform(0.1, 10.0, n))
    R = np.diag(random.uniform(0.1, 10.0, m))
    gain, *_ = control.dlqr(F, G, Q, R, method="scipy")
    assert solve_lqr(F, G, Q, R).tobytes() == np.asarray(gain).tobytes()
    _, covariance, _ = control.dlqe(F, np.eye(n), G.T, Q, R, method="scipy")
    assert solve_covariance(F, G.T, Q, R).tobytes() == np.asarray(covariance).tobytes()
