"""Commission and move hands with prismatic joints in the simulator."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handctl.controller.run_setup import make_controller
from handctl.core.calibration import Calibration
from handctl.core.gains.gains import Gains
from handctl.core.hand_constants import HandConstants
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.document import validate_content
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand
from handctl.hand.inverse_kinematics import closest_tip
from handctl.hand.kinematics import joint_points
from handctl.programs.commission import PULL_TENSION_N, CommissionProgram, calibration_of_result
from handctl.programs.live_session import LiveProgram, apply_goal
from handctl.programs.program import Program
from handctl.programs.requests import MoveDigitsRequest
from handctl.programs.stream_plans import mapping_of_stream
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.report.run_summary import mean_angles
from handctl.session.lockstep_simulation import SimulatedRun, SimulatorSettings
from tests.controller.synthetic_states import slack_hand_estimate

HAND_FILE_FOLDER = Path(__file__).parents[1] / "hand"
GRIPPER_NAMES = ("parallel_gripper", "mixed_gripper")
SIMULATOR_SEEDS = range(5)
RATE_HZ = 500.0


def back_and_forth_task(hand_name: str) -> Task:
    """Return a task with positions in mm and deg that moves the digits of a hand to and fro."""
    angles = (
        [{"left": 20.0, "right": 10.0}, {"left": 2.0, "right": 18.0}]
        if hand_name == "parallel_gripper"
        else [{"jaw": 15.0, "finger_j1": 12.0, "finger_j2": 40.0}, {"jaw": 3.0, "finger_j1": 2.0, "finger_j2": 10.0}]
    )  # fmt: skip
    phases = [{"kind": "move", "angle_deg": angle, "duration_s": 0.8} for angle in angles * 2]
    return validate_content({"schema": 1, "name": "moves", "phase": phases}, Task, "moves")


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("hand_name", GRIPPER_NAMES)
def test_a_hand_is_commissioned_and_moves(hand_name: str, seed: int) -> None:
    hand = load_hand(HAND_FILE_FOLDER / f"{hand_name}.toml")
    settings = SimulatorSettings(hand, seed=seed)
    with settings.simulated_hand(round(1e9 / RATE_HZ)) as peer:

        def begin(
            program: Program, calibration: Calibration | None, first_tick: int
        ) -> SimulatedRun:
            controller = make_controller(hand, Gains(), RATE_HZ, program, calibration, True)
            run = SimulatedRun.start_run(controller, peer)
            run.are_ticks_recorded = False
            run.k = first_tick
            return run

        run = begin(CommissionProgram(), None, 0)
        for _, out in run.run_ticks(60.0):
            assert not [event for event in out.events if event.level == "error"]
        assert not run.state.progress.failure
        calibration = calibration_of_result(
            run.controller.model, run.state.progress, "2026-01-01T00:00:00+00:00"
        )
        for row in calibration.tendon.values():
            assert row.answer_N == pytest.approx(PULL_TENSION_N, abs=1.5)
        run = begin(TaskProgram(back_and_forth_task(hand_name)), calibration, run.k)
        errors = list[np.ndarray]()
        largest = np.zeros(len(hand.joints))
        for _, out in run.run_ticks(run.k / RATE_HZ + 30.0):
            assert not [event for event in out.events if event.level == "error"]
            if run.state.mode == HandMode.ACTIVE and run.state.progress.phase.startswith("move"):
                q = peer.world.plant.engine.q
                errors.append(hand.display_units.to_display_units(run.state.view("q_goal") - q))
                largest = np.maximum(largest, hand.display_units.to_display_units(q))
        assert run.state.mode == HandMode.DONE
        # The permitted RMS tracking error of a joint is 1 mm or 1 deg.
        assert np.sqrt(np.nanmean(np.square(errors), axis=0)).max() < 1.0
        assert largest[0] > 14.0


@pytest.mark.parametrize("hand_name", GRIPPER_NAMES)
def test_inverse_kinematics_finds_postures_of_prismatic_joints(hand_name: str) -> None:
    rng = np.random.default_rng(0)
    for digit in DigitModel.digit_models_of_hand(load_hand(HAND_FILE_FOLDER / f"{hand_name}.toml")):
        low, high = digit.coordinate_limits
        for _ in range(20):
            theta = rng.uniform(low, high)
            tip = joint_points(digit, digit.coupling @ theta)[-1]
            assert closest_tip(digit, tip, theta + 0.1 * (high - low)).distance < 1e-6


def test_the_mean_of_a_sliding_digit_is_its_position() -> None:
    gripper = load_hand(HAND_FILE_FOLDER / "parallel_gripper.toml")
    q = np.array([[0.01, 0.02]])
    np.testing.assert_allclose(mean_angles(gripper, q), q)
    mixed_gripper = load_hand(HAND_FILE_FOLDER / "mixed_gripper.toml")
    # The test treats 10 mm of the prismatic joint like 1 rad of a revolute joint.
    mean = mean_angles(mixed_gripper, np.array([[0.005, 0.01, 1.0]]))
    np.testing.assert_allclose(mean, [[0.005, 1.0]])
    assert mixed_gripper.display_units.names == ("mm", "mm", "deg")


def model_of(hand_name: str) -> HandModel:
    """Return the controller's model of a gripper."""
    return HandModel.from_hand(load_hand(HAND_FILE_FOLDER / f"{hand_name}.toml"), Gains(), RATE_HZ)


def test_targets_of_a_stream_are_in_mm_and_deg() -> None:
    model = model_of("mixed_gripper")
    matrix = mapping_of_stream(model, "joint", model.hand.joints).matrix
    np.testing.assert_allclose(matrix, np.diag([1e-3, 1e-3, np.pi / 180.0]))


def test_thresholds_count_10_mm_as_1_rad() -> None:
    model = model_of("mixed_gripper")
    constants = HandConstants(model, {})
    view = {
        name: constants.layout.view(constants.block, name).ravel()
        for name in ("joint_scale", "arms_sum", "encoder_variance")
    }
    np.testing.assert_allclose(view["joint_scale"], [0.01, 0.01, 1.0])
    # The order of the tendons is jaw_close, jaw_open, finger_slide, finger_bend. The tendon
    # finger_bend has a moment arm of 10 mm.
    np.testing.assert_allclose(view["arms_sum"], [0.01, 0.01, 0.01, 0.015])
    np.testing.assert_allclose(view["encoder_variance"][0], 4e-10 + 25e-10 / 12.0)


@pytest.mark.parametrize(
    ("angle_mm", "duration_s", "expected_message"),
    [
        (29.0, 1.0, "left 29 mm, expected from 0 to 28 mm"),
        (28.0, 0.2, "mm/s, expected at most 122.2 mm/s: give it more time"),
    ],
)
def test_a_live_move_is_refused_in_mm(
    angle_mm: float, duration_s: float, expected_message: str
) -> None:
    model = model_of("parallel_gripper")
    progress = replace(LiveProgram().initial_progress(model), phase="live")
    request = MoveDigitsRequest(do="move", angle_deg={"left": angle_mm}, duration_s=duration_s)
    progress_after, (event,) = apply_goal(model, progress, request, slack_hand_estimate(model), 0.0)
    assert progress_after.goals == progress.goals
    assert expected_message in event.text
