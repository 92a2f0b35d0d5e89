"""Test the control of hands on a wrist.

The tendons of the digits pass the wrist at a distance from the axis of the wrist.
"""

from typing import NamedTuple

import numpy as np
import pytest

from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.description import Hand
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller
from tests.conftest import NIGHTLY
from tests.hand.hand_on_wrist import mount_on_wrist

RATE_HZ = 400.0
SIMULATOR_SEEDS = range(20) if NIGHTLY else range(1)
TRACKING_LIMITS_DEG = {"jamia": 0.6, "n_plus_1": 0.6, "jamia11": 1.3}
"""Limit of the tracking error of each hand [deg].

If the tendons pass through the axis of the wrist, the tracking errors of the three hands are 0.3,
0.15 and 1.0 deg.
"""
TESTED_HANDS = tuple(TRACKING_LIMITS_DEG) if NIGHTLY else ("jamia", "n_plus_1")
WAVE_ANGLES_DEG = ((30.0, 0.0), (45.0, 20.0), (45.0, -20.0), (20.0, 10.0), (50.0, 10.0))
"""Target angle of all digit joints, and target angle of the wrist, for each phase of the task [deg]."""


class ControlErrors(NamedTuple):
    """Errors of the controller in a simulated run.

    Attributes:
        tracking_error_deg: RMSE between commanded and true angle of the digits [deg]. The angle of a
            digit is the mean of its joint angles along a tendon.
        wrist_error_deg: RMSE between commanded and true angle of the wrist [deg].
        unexplained_tension_N: mean of that part of the tension of the wrist's tendon that the model
            does not explain [N].
    """

    tracking_error_deg: float
    wrist_error_deg: float
    unexplained_tension_N: float


def waving_task(hand: Hand) -> Task:
    """Return a task that moves the digits and the wrist of a hand in several phases."""
    phases = []
    for i, (digits, wrist) in enumerate(WAVE_ANGLES_DEG):
        angles = dict.fromkeys(hand.digit_names, digits) | {"wrist": wrist}
        phases.append({"kind": "move", "name": f"move {i}", "angle_deg": angles, "duration_s": 0.6})
    return Task.model_validate(
        {"schema": 1, "name": "wave", "description": "wave", "phase": tuple(phases)}
    )


def simulate_control_errors(
    assumed_hand: Hand, simulated_hand: Hand, seed: int
) -> ControlErrors | None:
    """Simulate the hand ``simulated_hand`` with a controller for the hand ``assumed_hand``.

    Return the control errors, or None if a fault ended the run.
    """
    model = HandModel.from_hand(assumed_hand, Gains(), RATE_HZ)
    # In a digit with one tendon, only the mean angle of the joints is controlled.
    along = simulated_hand.moment_arms_of_own_digit / np.abs(
        simulated_hand.moment_arms_of_own_digit
    ).sum(axis=1, keepdims=True)
    angle_errors = list[np.ndarray]()
    external_tension = list[float]()
    controller = homed_controller(model, TaskProgram(waving_task(assumed_hand)), simulated_hand)
    with SimulatorSettings(simulated_hand, None, seed, homed=True).begin_run(controller) as run:
        run.are_ticks_recorded = False
        for _, out in run.run_ticks(10.0):
            if [event for event in out.events if event.level == "error"]:
                return None
            if run.state.mode == HandMode.ACTIVE and run.state.progress.phase.startswith("move"):
                angle_errors.append(
                    np.degrees(
                        along @ (run.state.view("q_goal") - run.simulated_hand.world.plant.engine.q)
                    )
                )
                external_tension.append(run.state.view("external")[0])
        assert run.state.mode == HandMode.DONE
    squares = np.mean(np.square(angle_errors), axis=0)
    return ControlErrors(
        float(np.sqrt(squares[1:].mean())),
        float(np.sqrt(squares[0])),
        float(np.mean(np.abs(external_tension))),
    )


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("hand_name", TESTED_HANDS)
def test_a_digit_follows_while_the_wrist_turns(hand_name: str, seed: int) -> None:
    """A digit follows its goal even while the wrist turns.

    The tracking error becomes more than four times as large if the controller assumes that the
    tendons pass through the axis of the wrist.
    """
    hand = mount_on_wrist(hand_name)
    errors_with_wrist_model = simulate_control_errors(hand, hand, seed)
    assert errors_with_wrist_model is not None
    assert errors_with_wrist_model.tracking_error_deg < TRACKING_LIMITS_DEG[hand_name]
    assert errors_with_wrist_model.wrist_error_deg < 1.0
    errors_without_wrist_model = simulate_control_errors(mount_on_wrist(hand_name, 0.0), hand, seed)
    assert (
        errors_without_wrist_model is None
        or errors_without_wrist_model.tracking_error_deg
        > 4.0 * errors_with_wrist_model.tracking_error_deg
    )


def test_the_wrist_bears_the_tendons_that_pass_it() -> None:
    """The controller includes the torque that tendons of the fingers exert on the wrist.

    If the controller neglected the torque of the tendons on the wrist, the tension of bent fingers
    would look like an object that pushes the wrist.
    """
    hand = mount_on_wrist("jamia")
    errors_with_wrist_model = simulate_control_errors(hand, hand, 0)
    errors_without_wrist_model = simulate_control_errors(mount_on_wrist("jamia", 0.0), hand, 0)
    assert errors_with_wrist_model is not None
    assert errors_without_wrist_model is not None
    assert (
        errors_with_wrist_model.unexplained_tension_N
        < 0.5 * errors_without_wrist_model.unexplained_tension_N
    )


def test_arms_are_divided_between_a_digit_and_its_carriers() -> None:
    hand = mount_on_wrist("jamia11")
    assert np.array_equal(
        hand.moment_arms_of_own_digit + hand.moment_arms_of_carrying_digits, hand.moment_arms
    )
    joints = hand.digit_joints["middle"]
    tendons = hand.digit_tendons["middle"]
    assert not hand.moment_arms_of_carrying_digits[:, joints].any()
    assert np.array_equal(
        hand.moment_arms_of_own_digit[tendons, joints], hand.moment_arms[tendons, joints]
    )
    assert np.count_nonzero(hand.moment_arms_of_carrying_digits) == hand.moment_arms.shape[0] - 1
    assert hand.tendons_with_encoders[hand.digit_tendons["wrist"]].all()
