"""Test the tensions that the allocation chooses for given joint torques.

The bounded least-squares solver of scipy computes the expected tensions.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from handctl.core.control_law.tension_allocation import (
    REGULARISATION_WEIGHT,
    solve_bounded_tensions,
    tensions_for_torque,
)
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand

DIGIT_BY_CASE = {
    f"{name} {digit}": (load_hand(name), digit)
    for name, digit in (("jamia", "index"), ("jamia11", "index"), ("jamia11", "thumb"))
}
EXTENSOR_MOMENT_ARMS = np.array(
    [[9e-3, 0.0, 0.0], [3e-3, 6e-3, 0.0], [3e-3, 3e-3, 3e-3], [-9e-3, -6e-3, -3e-3]]
)
"""Moment arms of four tendons of a digit, each at three joints [m].

The last of the four tendons opens all joints, with moment arms in the ratio 3:2:1. The digit with
these moment arms has one tendon more than joints.
"""


def moment_arms_of_case(digit_case: str) -> np.ndarray:
    if digit_case == "N + 1":
        return EXTENSOR_MOMENT_ARMS
    hand, digit = DIGIT_BY_CASE[digit_case]
    return DigitModel.from_hand(hand, digit).reduced_moment_arms


DIGIT_CASES = [*DIGIT_BY_CASE, "N + 1"]


@pytest.mark.parametrize("digit_case", DIGIT_CASES)
def test_feasible_torques_are_made_exactly(digit_case: str) -> None:
    arms, rng = moment_arms_of_case(digit_case), np.random.default_rng(1)
    floor, ceiling = np.full(len(arms), 3.0), np.full(len(arms), 110.0)
    for _ in range(200):
        expected = rng.uniform(3.5, 105.0, len(arms))
        torque = arms.T @ expected
        tension, missing = tensions_for_torque(arms, torque, floor, ceiling)
        np.testing.assert_allclose(arms.T @ tension, torque, rtol=1e-4, atol=2e-5)
        np.testing.assert_allclose(missing, torque - arms.T @ tension, atol=1e-15)
        assert (tension >= floor).all()
        assert (tension <= ceiling).all()
        if len(arms) == arms.shape[1]:
            np.testing.assert_allclose(
                tension, expected, rtol=1e-9, err_msg="one tendon a coordinate: no choice"
            )
        else:
            assert tension.sum() <= expected.sum() * 1.001, "no more co-contraction than needed"


def allocation_cost(
    arms: np.ndarray, torque: np.ndarray, floor: np.ndarray, tension: np.ndarray
) -> float:
    """Return the cost that the allocation assigns to given tensions.

    The docstring of the allocation module defines the cost of tensions.
    """
    r = np.abs(arms).mean()
    return float(
        ((arms.T @ tension - torque) ** 2).sum() / r**2
        + REGULARISATION_WEIGHT * ((tension - floor) ** 2).sum()
    )


@pytest.mark.parametrize("digit_case", DIGIT_CASES)
def test_bounded_solution_has_the_smallest_error(digit_case: str) -> None:
    """The allocated tensions have no higher cost than the solution of scipy's bounded least-squares solver."""
    arms, rng = moment_arms_of_case(digit_case), np.random.default_rng(2)
    n, r = len(arms), np.abs(arms).mean()
    infeasible_count = 0
    for _ in range(200):
        floor = rng.uniform(0.0, 10.0, n)
        ceiling = floor + rng.uniform(5.0, 120.0, n)
        torque = rng.normal(size=arms.shape[1]) * r * rng.choice([10.0, 100.0, 500.0])
        tension, missing = tensions_for_torque(arms, torque, floor, ceiling)
        assert (tension >= floor).all()
        assert (tension <= ceiling).all()
        np.testing.assert_allclose(missing, torque - arms.T @ tension, atol=1e-15)
        weight = np.sqrt(REGULARISATION_WEIGHT)
        rows, weighted_torque = (
            np.vstack([arms.T / r, weight * np.eye(n)]),
            np.concatenate([torque / r, weight * floor]),
        )
        best = lsq_linear(rows, weighted_torque, (floor, ceiling), method="bvls", tol=1e-12).x
        assert (
            allocation_cost(arms, torque, floor, tension)
            <= allocation_cost(arms, torque, floor, best) * (1 + 1e-6) + 1e-6
        )
        infeasible_count += bool(np.abs(missing).max() > 1e-6)
    assert infeasible_count > 20, "torques that the bounds forbid were among them"


finite_torque_values = st.floats(-1e6, 1e6, allow_nan=False)


@given(
    joint_torque=st.lists(finite_torque_values, min_size=3, max_size=3),
    digit_case=st.sampled_from(["jamia11 index", "N + 1"]),
)
def test_bounds_hold_for_any_torque(joint_torque: list[float], digit_case: str) -> None:
    arms = moment_arms_of_case(digit_case)
    floor, ceiling = np.full(len(arms), 3.0), np.full(len(arms), 110.0)
    tension, missing = tensions_for_torque(arms, np.array(joint_torque), floor, ceiling)
    assert np.isfinite(tension).all()
    assert (tension >= floor).all()
    assert (tension <= ceiling).all()
    assert np.isfinite(missing).all()


@given(torque=finite_torque_values)
def test_one_tendon_pulls_between_its_bounds(torque: float) -> None:
    arms = moment_arms_of_case("jamia index")
    tension, missing = tensions_for_torque(
        arms, np.array([torque]), np.array([3.0]), np.array([110.0])
    )
    expected = min(max(torque / arms[0, 0], 3.0), 110.0)
    np.testing.assert_allclose(tension, [expected], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(missing, [torque - arms[0, 0] * expected], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("digit_case", DIGIT_CASES)
def test_where_the_solver_starts_changes_nothing(digit_case: str) -> None:
    arms, rng = moment_arms_of_case(digit_case), np.random.default_rng(3)
    n = len(arms)
    floor, ceiling = np.full(n, 3.0), np.full(n, 110.0)
    for _ in range(100):
        torque = arms.T @ rng.uniform(-100.0, 200.0, n)
        first_solution = solve_bounded_tensions(arms, torque, floor, ceiling, floor)
        for near in (ceiling, rng.uniform(-1e3, 1e3, n), np.where(rng.random(n) < 0.5, -1e9, 1e9)):
            np.testing.assert_allclose(
                solve_bounded_tensions(arms, torque, floor, ceiling, near),
                first_solution,
                rtol=1e-7,
                atol=1e-7,
            )


def test_arguments_are_not_changed() -> None:
    arms = EXTENSOR_MOMENT_ARMS.copy()
    torque, floor, ceiling = np.array([5.0, -5.0, 5.0]), np.full(4, 3.0), np.full(4, 110.0)
    tensions_for_torque(arms, torque, floor, ceiling)
    np.testing.assert_array_equal(arms, EXTENSOR_MOMENT_ARMS)
    np.testing.assert_array_equal(torque, [5.0, -5.0, 5.0])
    assert (floor == 3.0).all()
    assert (ceiling == 110.0).all()
