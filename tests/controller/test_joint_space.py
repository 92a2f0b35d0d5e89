"""Test tasks and trajectories that name single joints.

Joints that a task does not name keep their angles. A task must set coupled joints to the same
angle.
"""

from typing import Any

import numpy as np
import pytest

from handctl.core.control_law.trajectory import CurveTrajectory
from handctl.document import validate_content
from handctl.errors import ConfigError
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import load_hand
from handctl.programs.task import Task, task_from_trajectory_file
from handctl.programs.task_checks import check_task_for_hand
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller
from tests.controller.plant_run import model_of

SETTLED_ERROR_DEG = 2.0


def task_of_phases(*phase_fields: dict[str, Any]) -> Task:
    return validate_content({"schema": 1, "name": "t", "phase": list(phase_fields)}, Task, "t")


def move_phase(angle_by_joint_deg: dict[str, Any], duration_s: float = 0.4) -> dict[str, Any]:
    return {"kind": "move", "angle_deg": angle_by_joint_deg, "duration_s": duration_s}


def final_joint_angles(hand_name: str, program: Task, duration_s: float) -> dict[str, float]:
    """Return the true joint angles [deg] of a simulated hand after a task."""
    check_task_for_hand(program, load_hand(hand_name), "t")
    with SimulatorSettings(hand_name, None, 0, homed=True).begin_run(
        homed_controller(model_of(hand_name), TaskProgram(program))
    ) as run:
        run.are_ticks_recorded = False
        for _entry, out in run.run_ticks(duration_s):
            angles = np.degrees(run.simulated_hand.world.plant.engine.q)
            if out.events and any(event.text == "task complete" for event in out.events):
                break
        assert not run.state.failure
        assert run.state.progress.finished
        return dict(zip(load_hand(hand_name).joints, angles.tolist(), strict=True))


def test_a_move_of_one_joint_leaves_the_others() -> None:
    wait = move_phase({"thumb_j2": 10.0})
    angles = final_joint_angles(
        "jamia11",
        task_of_phases(
            move_phase({"index": 20.0}),
            move_phase({"index_j2": 30.0, "thumb_j2": 10.0}),
            wait,
            wait,
        ),
        6.0,
    )
    expected = {
        "index_j1": 20.0,
        "index_j2": 30.0,
        "index_j3": 20.0,
        "thumb_j1": 0.0,
        "thumb_j2": 10.0,
        "ring_j1": 0.0,
    }
    assert {name: angles[name] for name in expected} == pytest.approx(
        expected, abs=SETTLED_ERROR_DEG
    )


def test_a_trajectory_can_name_single_joints() -> None:
    content = {
        "schema": 1,
        "name": "wave",
        "time_s": [0.0, 0.5, 1.0],
        "angle_deg": {
            "index_j1": [5.0, 40.0, 30.0],
            "index_j2": [5.0, 5.0, 20.0],
            "thumb": [0.0, 10.0, 20.0],
        },
    }
    program = task_from_trajectory_file(content, "t")
    wait = {
        **program.phase[0].model_dump(),
        "angle_deg": {"index_j1": 30.0, "index_j2": 20.0},
        "duration_s": 0.5,
    }
    angles = final_joint_angles(
        "jamia11", task_of_phases(*[phase.model_dump() for phase in program.phase], wait), 8.0
    )
    expected = {
        "index_j1": 30.0,
        "index_j2": 20.0,
        "index_j3": 0.0,
        "thumb_j1": 20.0,
        "thumb_j2": 20.0,
    }
    assert {name: angles[name] for name in expected} == pytest.approx(
        expected, abs=SETTLED_ERROR_DEG
    )


def test_a_joint_of_a_one_tendon_digit_stands_for_all() -> None:
    coordinates_from_joint = DigitModel.from_hand(load_hand("t42"), "left").with_joint_angles(
        {1: 10.0}, [0.0]
    )
    assert coordinates_from_joint.tolist() == pytest.approx([40.0])


def test_a_curve_for_each_coordinate_is_that_of_each() -> None:
    times = (0.0, 0.4, 1.0, 1.7)
    points = np.array([[0.0, 0.1], [0.5, 0.0], [0.2, 0.7], [0.9, 0.3]])
    curve = CurveTrajectory.curve_through_points(times, points, 2)
    curves = [CurveTrajectory.curve_through_points(times, tuple(column), 1) for column in points.T]
    for t in (-0.1, 0.0, 0.3, 0.4, 1.2, 1.7, 2.0):
        assert curve.motion_at(t) == pytest.approx(
            np.hstack([diagonal_element.motion_at(t) for diagonal_element in curves]), abs=1e-12
        )
    assert curve.peak_speed() == pytest.approx(
        max(diagonal_element.peak_speed() for diagonal_element in curves)
    )
    assert curve.duration == 1.7


@pytest.mark.parametrize(
    ("hand_name", "angle_by_joint_deg", "expected_message"),
    [
        (
            "jamia11",
            {"index_j4": 10.0},
            "no digit 'index_j4'; expected one of index, middle, ring, thumb, or a joint",
        ),
        (
            "jamia11",
            {"index": 10.0, "index_j1": 20.0},
            "index and index_j1; expected either the digit or its joints",
        ),
        ("jamia11", {"index_j1": [10.0, 20.0]}, "2 numbers for index_j1; expected one number"),
        ("jamia11", {"index_j1": 120.0}, "120 deg for index_j1; expected 0 to 100 deg"),
        ("t42", {"left_j2": 60.0}, "60 deg for left_j2; expected 0 to 37.5 deg"),
        ("t42", {"left_j1": 60.0, "left_j2": 60.0}, "expected"),
        (
            "jamia",
            {"index_j1": 30.0, "index_j2": 10.0},
            "index_j1, index_j2 are coupled; expected index, one angle",
        ),
    ],
)
def test_joint_angles_that_a_hand_cannot_have(
    hand_name: str, angle_by_joint_deg: dict[str, Any], expected_message: str
) -> None:
    with pytest.raises(ConfigError, match=rf"t: phase\[0\]\.angle_deg: .*{expected_message}"):
        check_task_for_hand(
            task_of_phases(move_phase(angle_by_joint_deg)), load_hand(hand_name), "t"
        )


def test_a_curve_of_a_joint_is_checked_at_every_time() -> None:
    follow = {
        "kind": "follow",
        "time_s": (0.0, 1.0, 2.0),
        "angle_deg": {"index_j1": (0.0, 110.0, 0.0)},
    }
    with pytest.raises(ConfigError, match="110 deg for index_j1; expected 0 to 100 deg"):
        check_task_for_hand(task_of_phases(follow), load_hand("jamia11"), "t")
