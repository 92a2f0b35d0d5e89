"""Test the planned positions of digits during a motion, and the tensions that the motion requires."""

from dataclasses import replace

import numpy as np
import pytest

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.tension_allocation import tensions_for_torque
from handctl.core.hand_model import HandModel
from tests.controller.control_law_runs import joint_motion_at, required_tensions_of
from tests.controller.digit_goals import moving_goals


def motion_goals(
    model: HandModel, start_time: float, durations_s: tuple[float, ...]
) -> tuple[DigitGoal, ...]:
    return moving_goals(model, 0.2, 0.9, durations_s, start_time)


@pytest.mark.parametrize("hand_name", ["jamia", "jamia11"])
@pytest.mark.parametrize("durations_s", [(0.5,) * 4, (0.5, 0.4, 0.5, 0.6)])
def test_a_motion_depends_on_the_time_since_its_start_only(
    hand_name: str, durations_s: tuple[float, ...], request: pytest.FixtureRequest
) -> None:
    """Test one motion with equal durations for all digits, and one motion with different durations."""
    model: HandModel = request.getfixturevalue(hand_name)
    first_goals, later_goals = (motion_goals(model, since, durations_s) for since in (0.0, 2.0))
    motion = joint_motion_at(model, first_goals, 0.1)
    np.testing.assert_allclose(joint_motion_at(model, later_goals, 2.1), motion, rtol=1e-9)
    assert (np.ptp(motion[1]) > 1e-3) == (len(set(durations_s)) > 1)
    assert motion[1].min() > 0.0


def required_tensions_by_digit(model: HandModel, joint_motion: np.ndarray) -> np.ndarray:
    """Compute the tensions (tendons,) [N] that a motion requires, for one digit after the other."""
    required_tensions = np.zeros(model.tendon_count)
    q, dq, ddq = joint_motion.tolist()
    for digit, tendons in zip(model.digits, model.digit_tendons, strict=True):
        own_joints = digit.joints
        torque = (
            np.array(model.inverse_dynamics(digit, q[own_joints], dq[own_joints], ddq[own_joints]))
            @ digit.coupling
        )
        low, high = model.floor[tendons], model.ceiling[tendons]
        required_tensions[tendons] = tensions_for_torque(
            digit.reduced_moment_arms, torque, low, high
        )[0]
    return required_tensions


@pytest.mark.parametrize("hand_name", ["jamia", "jamia11"])
def test_the_load_of_each_digit_is_limited_separately(
    hand_name: str, request: pytest.FixtureRequest
) -> None:
    """In this test, the required tensions reach a bound in some digits, and stay within the bounds in other digits.

    A required tension that reaches a bound in one digit does not change the required tensions of
    other digits.
    """
    model: HandModel = request.getfixturevalue(hand_name)
    goals, rng = motion_goals(model, 0.0, (0.5, 0.4, 0.5, 0.6)), np.random.default_rng(4)
    joints = len(model.hand.joints)
    kinds = set()
    for spread in (0.0, 1.0, 30.0, 1000.0, 1e5):
        for _ in range(20):
            motion = rng.normal(size=(3, joints)) * np.array([[0.3], [1.0], [spread]]) + np.array(
                [[0.7], [0.0], [0.0]]
            )
            load = required_tensions_of(model, goals, motion)
            np.testing.assert_allclose(
                load, required_tensions_by_digit(model, motion), rtol=1e-6, atol=1e-6
            )
            bound = (load <= model.floor) | (load >= model.ceiling)
            kinds.add("all" if bound.all() else "some" if bound.any() else "none")
    assert kinds >= {"some", "none"}


def test_resting_digits_load_no_moving_digit(jamia11: HandModel) -> None:
    goals = motion_goals(jamia11, 0.0, (0.5,) * 4)
    goals_of_one_digit = (
        goals[0],
        *(replace(goal, kind=GoalKind.LIMP, trajectory=None) for goal in goals[1:]),
    )
    motion = joint_motion_at(jamia11, goals, 0.2)
    own_tendons = jamia11.digit_tendons[0]
    required_tensions = [
        required_tensions_of(jamia11, goal_set, motion)[own_tendons]
        for goal_set in (goals, goals_of_one_digit)
    ]
    np.testing.assert_allclose(required_tensions[0], required_tensions[1], rtol=1e-9)
