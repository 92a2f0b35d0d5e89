"""Test the postures that bring a fingertip as close as possible to a point.

All returned postures are within the joint limits.
"""

import time

import numpy as np
import pytest
from scipy.optimize import least_squares

from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand
from handctl.hand.inverse_kinematics import closest_tip, inverse_kinematics_coupled
from handctl.hand.kinematics import joint_points
from tests.hand.random_chains import random_hand

TESTED_HANDS = ("jamia", "jamia11", "t42", "n_plus_1")
SEED_COUNT = 20


def palm_digits(hand_name: str) -> list[DigitModel]:
    """Return the digits of a hand that are mounted on its palm."""
    description = load_hand(hand_name)
    return [
        DigitModel.from_hand(description, digit.name)
        for digit in description.digit
        if digit.mount_on is None
    ]


def tip_position(digit: DigitModel, joint_angles: np.ndarray) -> np.ndarray:
    """Return the position of the tip of a digit [m].

    The joint coordinates of the digit are ``joint_angles``.
    """
    return joint_points(digit, digit.coupling @ joint_angles)[-1]


@pytest.mark.parametrize("hand", TESTED_HANDS)
def test_a_point_in_reach_is_reached_within_the_limits(hand: str) -> None:
    for digit in palm_digits(hand):
        low, high = digit.coordinate_limits
        for seed in range(SEED_COUNT):
            theta = np.random.default_rng(seed).uniform(low, high)
            solution = closest_tip(
                digit, tip_position(digit, theta), 0.5 * (theta + 0.5 * (low + high))
            )
            assert solution.distance < 1e-6, (digit.name, seed)
            assert (solution.coordinates >= low).all()
            assert (solution.coordinates <= high).all()


@pytest.mark.parametrize("hand", TESTED_HANDS)
def test_a_point_anywhere_is_met_as_closely_as_by_scipy(hand: str) -> None:
    """The expected distance from the fingertip to the point comes from scipy's bounded least squares.

    The search of scipy starts in the middle of the joint ranges.
    """
    worse_solution_count = 0
    for digit in palm_digits(hand):
        low, high = digit.coordinate_limits
        for seed in range(SEED_COUNT):
            random = np.random.default_rng(seed)
            target = tip_position(digit, random.uniform(low, high)) + random.normal(
                scale=0.03, size=3
            )
            start = 0.5 * (low + high)
            solution = closest_tip(digit, target)
            scipy_result = least_squares(
                lambda theta, d=digit, x=target: tip_position(d, theta) - x,
                start,
                bounds=(low, high),
            )
            assert solution.distance == pytest.approx(
                np.linalg.norm(tip_position(digit, solution.coordinates) - target), abs=1e-12
            )
            assert (solution.coordinates >= low).all()
            assert (solution.coordinates <= high).all()
            worse_solution_count += solution.distance > np.linalg.norm(scipy_result.fun) + 1e-5
    assert worse_solution_count <= 1, "another local minimum in at most one case"


def test_a_coupled_digit_meets_the_global_minimum() -> None:
    for digit in palm_digits("jamia"):
        for seed in range(SEED_COUNT):
            random = np.random.default_rng(seed)
            target = tip_position(digit, random.uniform(*digit.coordinate_limits)) + random.normal(
                scale=0.01, size=3
            )
            if digit.coupling.shape[1] == 1:
                assert (
                    closest_tip(digit, target).distance
                    <= inverse_kinematics_coupled(digit, target)[1] + 1e-6
                )


def test_a_path_of_points_gives_postures_without_jumps() -> None:
    digit = palm_digits("jamia11")[0]
    low, high = digit.coordinate_limits
    joint_angles_of_path = np.linspace(low, 0.9 * high, 200)
    theta = closest_tip(digit, tip_position(digit, joint_angles_of_path[0])).coordinates
    trajectory = [theta]
    for joint_angles in joint_angles_of_path[1:]:
        trajectory.append(
            closest_tip(digit, tip_position(digit, joint_angles), trajectory[-1]).coordinates
        )
    assert np.degrees(np.abs(np.diff(trajectory, axis=0))).max() < 3.0


@pytest.mark.parametrize("seed", range(SEED_COUNT))
def test_tips_of_random_chains_are_closest(seed: int) -> None:
    """The digits of this test have one to eight links, and joint axes in any direction."""
    random = np.random.default_rng(seed)
    description = random_hand(seed)
    digit = DigitModel.from_hand(description, description.digit_names[0])
    low, high = digit.coordinate_limits
    theta = random.uniform(low, high)
    solution = closest_tip(
        digit, tip_position(digit, theta), theta + random.normal(scale=0.05, size=len(theta))
    )
    assert solution.distance < 1e-6
    assert ((solution.coordinates >= low) & (solution.coordinates <= high)).all()


def test_a_digit_takes_less_than_a_millisecond_per_target() -> None:
    digit = palm_digits("jamia11")[0]
    low, high = digit.coordinate_limits
    theta = 0.5 * (low + high)
    durations_s = []
    for i in range(100):
        target = tip_position(digit, 0.5 * (low + high) + 0.2 * np.sin(0.1 * i))
        start_cpu_s = time.process_time()
        theta = closest_tip(digit, target, theta).coordinates
        durations_s.append(time.process_time() - start_cpu_s)
    print(f"{1e3 * np.median(durations_s):.2f} ms")
    assert np.median(durations_s) < 5e-3
