"""Test the detection of an object that slips out of a hand, and the reaction of the grasp program to the slip.

The grasp program detects slip when the object pushes a digit open. After slip, the grasp program
raises the grip force up to the force limit of the task.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from handctl.core import state_block as s
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent
from handctl.programs import grip
from handctl.programs.grip import SLIP_EXCURSION_M, GripPlan, GripState, advance_grip
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from tests.controller.plant_run import run_on_plant
from tests.controller.synthetic_states import (
    SyntheticEstimate,
    active_state,
    detect_contacts,
    estimate_under_tension,
)

HOLD_TENSION_N = 20.0


class GripRun:
    """Grasp in which every digit except the last digit holds an object.

    The grasp program runs tick by tick with generated estimates.
    """

    def __init__(
        self, model: HandModel, grip_limit: float = np.nan, grip_stiffness: float = 0.0
    ) -> None:
        self.model, self.resting_estimate = (
            model,
            estimate_under_tension(model, HOLD_TENSION_N, 0.5),
        )
        sizes = [tendons.stop - tendons.start for tendons in model.digit_tendons]
        held_digit_goals = [
            DigitGoal(GoalKind.TENSION, tension=np.full(size, HOLD_TENSION_N)) for size in sizes
        ]
        self.goals: tuple[DigitGoal, ...] = (*held_digit_goals[:-1], DigitGoal())
        self.plan = GripPlan(grip_stiffness, np.full(model.tendon_count, grip_limit))
        self.t = 0.0
        self.grip = GripState.at_start_of_hold(model, self.goals, self.resting_estimate, self.t)
        self.state = active_state(model)
        detect_contacts(model, self.state, self.resting_estimate)
        self.state.run_integers[s.PROGRAM_HOLDS_OBJECT] = 1
        self.events: list[TickEvent] = []

    def tick(self, estimate: SyntheticEstimate, duration_s: float) -> None:
        for _ in range(round(duration_s / self.model.period)):
            self.state.goal_time = self.t
            self.state.run_reals[s.SLIP_DETECTION_START] = self.grip.ready
            estimate_with_contacts = detect_contacts(self.model, self.state, estimate)
            self.t += self.model.period
            self.grip, self.goals, events = advance_grip(
                self.model, self.grip, self.plan, self.goals, estimate_with_contacts, self.t
            )
            self.events += events

    def estimate_after_winding(
        self, extra_travel_m: float, digit_index: int = 0
    ) -> SyntheticEstimate:
        """Return an estimate in which the motors have wound up a length ``extra_travel_m`` [m] of a digit's tendons."""
        travel = self.resting_estimate.travel.copy()
        travel[self.model.digit_tendons[digit_index]] += extra_travel_m
        return self.resting_estimate._replace(travel=travel)

    @property
    def commanded_tension(self) -> float:
        assert self.goals[0].tension is not None
        return float(self.goals[0].tension[0])


def test_a_digit_that_is_pushed_open_raises_the_force_of_all(model: HandModel) -> None:
    grip_run = GripRun(model, grip_limit=30.0)
    grip_run.tick(grip_run.resting_estimate, 1.0)
    assert not grip_run.events
    grip_run.tick(grip_run.estimate_after_winding(-3 * SLIP_EXCURSION_M), 0.06)
    assert [event.where for event in grip_run.events] == [model.hand.digit_names[0]]
    for goal in grip_run.goals[:-1]:
        np.testing.assert_allclose(goal.tension, grip.TENSION_RAISE_FACTOR * HOLD_TENSION_N)
    assert grip_run.goals[-1].kind == GoalKind.LIMP, "what does not hold is left alone"


def test_a_slip_reaction_at_its_limit_is_reported_once(model: HandModel) -> None:
    grip_run = GripRun(model, grip_limit=26.0)
    grip_run.tick(grip_run.resting_estimate, 1.0)
    for step in range(1, 8):
        grip_run.tick(grip_run.estimate_after_winding(-3 * step * SLIP_EXCURSION_M), 0.5)
    assert grip_run.commanded_tension == pytest.approx(26.0)
    assert [("no more" in event.text) for event in grip_run.events] == [False, False, True]


def test_without_a_limit_slip_is_reported_without_a_reaction(model: HandModel) -> None:
    grip_run = GripRun(model)
    grip_run.tick(grip_run.resting_estimate, 1.0)
    grip_run.tick(grip_run.estimate_after_winding(-3 * SLIP_EXCURSION_M), 0.5)
    assert [event.level for event in grip_run.events] == ["warn"]
    assert grip_run.commanded_tension == HOLD_TENSION_N


def test_closing_creeping_noise_and_the_start_are_no_slip(model: HandModel) -> None:
    grip_run = GripRun(model, grip_limit=30.0)
    grip_run.tick(grip_run.estimate_after_winding(-5 * SLIP_EXCURSION_M), 0.2)
    grip_run.tick(grip_run.resting_estimate, 1.0)
    grip_run.tick(grip_run.estimate_after_winding(5 * SLIP_EXCURSION_M), 1.0)
    chance = np.random.default_rng(1)
    for k in range(round(20.0 / model.period)):
        creep_distance = -0.02e-3 * k * model.period
        grip_run.tick(
            grip_run.estimate_after_winding(
                5 * SLIP_EXCURSION_M + creep_distance + chance.normal(0.0, 3.5e-6)
            ),
            model.period,
        )
    assert not grip_run.events


def test_a_stiff_grip_pulls_back_what_is_pulled_out(model: HandModel) -> None:
    grip_run = GripRun(model, grip_limit=np.nan, grip_stiffness=5e3)
    grip_run.tick(grip_run.resting_estimate, 1.0)
    grip_run.tick(grip_run.estimate_after_winding(-0.2e-3), 0.01)
    assert grip_run.commanded_tension == pytest.approx(HOLD_TENSION_N + 1.0, abs=0.01)
    grip_run.tick(grip_run.estimate_after_winding(0.2e-3), 0.01)
    assert grip_run.commanded_tension == pytest.approx(HOLD_TENSION_N - 1.0, abs=0.01)


PULLED_CYLINDER_SCENE = """name = "pull"
[object]
shape = "cylinder"
diameter_m = 0.035
length_m = 0.093
mass_kg = 0.15
friction = {friction}
position_m = [0.0195, 0.0, 0.0]
[support]
drop_when = "grasped"
drop_hold_s = 0.2
sink_speed_m_s = 0.2
[load]
direction = [1.0, 0.0, 0.0]
start_s = 3.4
rate_N_per_s = {rate}
"""


def grasp_program(slip_limit_text: str) -> TaskProgram:
    phases = [
        {
            "kind": "move",
            "angle_deg": {"index": 18.0, "middle": 18.0, "ring": 18.0, "thumb": 3.0},
            "duration_s": 0.4,
        },
        {"kind": "close", "angle_deg": 85.0, "speed_deg_s": 80.0, "contact_tension_N": 14.0},
        {"kind": "hold", "tension_N": 20.0, "duration_s": 60.0}
        | ({"slip_limit_N": 80.0} if slip_limit_text else {}),
    ]
    return TaskProgram(
        Task.model_validate_json(json.dumps({"schema": 1, "name": "t", "phase": phases}))
    )


@pytest.mark.parametrize(
    ("hand_name", "object_friction", "load_rate"), [("jamia", 0.3, 5.0), ("jamia11", 0.2, 9.0)]
)
def test_a_growing_load_removes_the_object_only_without_slip_reaction(
    hand_name: str, object_friction: float, load_rate: float, tmp_path: Path
) -> None:
    """In this test, a run with slip reaction and a run without slip reaction have the same load, hand and seed.

    The two runs of this test differ only in the task key that permits a higher grip force.
    """
    scene, motion, tension = (
        PULLED_CYLINDER_SCENE.format(friction=object_friction, rate=load_rate),
        {},
        {},
    )
    for limit in ("", "limit"):
        run = run_on_plant(hand_name, grasp_program(limit), scene, tmp_path, 5.6)
        begin = run.time_s.index(3.4)
        motion[limit] = 1e3 * np.linalg.norm(
            np.subtract(run.object_position[-1], run.object_position[begin])
        )
        tension[limit] = max(float(row.max()) for row in run.estimated_tension[begin:])
        assert run.events_named("slip"), "noticed in either case"
        assert not [t for t, _ in run.events_named("slip") if t < 3.4], (
            "before the load nothing slips"
        )
    assert motion[""] > 20.0, "the positive control: it is pulled out"
    assert motion["limit"] < 8.0
    assert tension["limit"] > 25.0


def test_the_compiled_grip_opening_equals_numpy(model: HandModel) -> None:
    resting_estimate = estimate_under_tension(model, HOLD_TENSION_N, 0.5)
    closing_sign = model.redundancy.closing_sign
    for seed in range(20):
        random = np.random.default_rng(seed)
        state = active_state(model)
        state.tendon[[s.FAST_GRIP_TRAVEL, s.SLOW_GRIP_TRAVEL]] = random.normal(
            0.0, SLIP_EXCURSION_M, (2, model.tendon_count)
        )
        held_tension = np.where(random.random(model.tendon_count) < 0.5, np.nan, HOLD_TENSION_N)
        expected = resting_estimate._replace(grip_opening=state.estimate.grip_opening)
        assert state.estimate.largest_grip_opening(
            closing_sign, held_tension
        ) == expected.largest_grip_opening(closing_sign, held_tension)
