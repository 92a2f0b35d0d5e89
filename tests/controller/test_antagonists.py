"""Test hands without return springs in the simulator: commissioning, tracking, grasp and release.

In the hands of this file, a digit with n joints has n + 1 tendons. Only one hand has a thumb with n
joints and 2 n tendons.
"""

import os
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from handctl.controller.run_setup import make_controller
from handctl.core import state_block as s
from handctl.core.calibration import Calibration
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode, TickEvent
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand
from handctl.hand.readiness_checks import reasons_not_ready
from handctl.programs.commission import PULL_TENSION_N, CommissionProgram, calibration_of_result
from handctl.programs.program import Program
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatedHand, SimulatedRun, SimulatorSettings

RATE_HZ = 250.0
ANTAGONIST_HAND = "n_plus_1"
SIMULATOR_SEEDS = range(20 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 2)


@cache
def n_plus_1_hand() -> Hand:
    """Return a hand with two fingers and a thumb.

    Each finger of the hand has three joints and four tendons. The thumb of the hand has two joints
    and three tendons.
    """
    return load_hand(ANTAGONIST_HAND)


@cache
def hand_without_encoders() -> Hand:
    """Return the packaged hand ``n_plus_1``, but without joint encoders.

    The motor zeros of this hand refer to the lower joint limits.
    """
    content = hand_content("n_plus_1")
    return hand_from_content(
        content | {"sensor_node": content["sensor_node"] | {"joints": []}}, "no encoders"
    )


@cache
def two_n_hand() -> Hand:
    """Return the packaged hand ``n_plus_1`` with another thumb.

    Each joint of this thumb has two tendons: a flexor and an extensor.
    """
    content = hand_content("n_plus_1")
    base = content["tendon"][-1]
    motor = content["motor"][-1]
    arm = 0.004948
    moment_arms_by_tendon = {
        "f1": {"thumb_j1": arm},
        "e1": {"thumb_j1": -arm},
        "f2": {"thumb_j1": arm, "thumb_j2": arm},
        "e2": {"thumb_j1": -arm, "thumb_j2": -arm},
    }
    tendons = [tendon for tendon in content["tendon"] if not tendon["name"].startswith("thumb")]
    motors = [entry for entry in content["motor"] if not entry["name"].startswith("thumb")]
    for i, (name, arms) in enumerate(moment_arms_by_tendon.items()):
        tendons.append(
            base | {"name": f"thumb_{name}", "motor": f"thumb_m{name}", "moment_arm_m": arms}
        )
        motors.append(motor | {"name": f"thumb_m{name}", "node_id": 9 + i})
    node = content["sensor_node"] | {"tendons": [tendon["name"] for tendon in tendons]}
    return hand_from_content(
        content | {"tendon": tendons, "motor": motors, "sensor_node": node}, "2 n"
    )


@cache
def antagonist_model() -> HandModel:
    """Return the model of a hand at the control rate of the tests in this file."""
    return HandModel.from_hand(n_plus_1_hand(), Gains(), RATE_HZ)


def task_of_moves(*digit_and_thumb_angles_deg: tuple[float, float]) -> Task:
    """Return a task with one move for each pair of an angle and a duration.

    A pair contains one target angle for all joints [deg] and the duration of the move [s].
    """
    phases = [
        {"kind": "move", "name": f"move {i}", "angle_deg": angle, "duration_s": duration}
        for i, (angle, duration) in enumerate(digit_and_thumb_angles_deg)
    ]
    return Task.model_validate(
        {"schema": 1, "name": "moves", "description": "moves", "phase": tuple(phases)}
    )


def begin_run(
    simulated_hand: SimulatedHand,
    program: Program,
    calibration: Calibration | None,
    first_tick: int,
    hand: Hand | None = None,
) -> tuple[SimulatedRun, Iterator[None]]:
    """Begin a run of a program on a simulated hand at tick ``first_tick``.

    An earlier run can have moved the simulated hand.
    """
    controller = make_controller(
        hand or n_plus_1_hand(), Gains(), RATE_HZ, program, calibration, arm_at_once=True
    )
    run = SimulatedRun.start_run(controller, simulated_hand)
    run.k = first_tick
    run.are_ticks_recorded = False
    run.state.run_integers[s.K] = first_tick - 1
    return run, (None for _ in run.run_ticks(first_tick / RATE_HZ + 120.0))


def logged_events_of(run: SimulatedRun) -> tuple[TickEvent, ...]:
    assert run.last_output is not None
    return run.last_output.events


HAND_FACTORY_BY_KIND = {
    "n + 1": n_plus_1_hand,
    "n + 1 without joint encoders": hand_without_encoders,
    "2 n": two_n_hand,
}


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("hand_kind", HAND_FACTORY_BY_KIND)
def test_an_antagonistic_hand_commissions_and_tracks_from_a_cold_start(
    hand_kind: str, seed: int
) -> None:
    """The commissioning program finds the true motor zeros of the simulated hand.

    The joints of the commissioned hand follow their goals within one degree.
    """
    hand = HAND_FACTORY_BY_KIND[hand_kind]()
    period_ns = round(1e9 / RATE_HZ)
    with SimulatorSettings(hand, None, seed).simulated_hand(period_ns) as peer:
        plant = peer.world.plant
        run, ticks = begin_run(peer, CommissionProgram(), None, 0, hand)
        for _ in ticks:
            assert not [event for event in logged_events_of(run) if event.level == "error"]
        assert not run.state.progress.failure
        calibration = calibration_of_result(
            run.controller.model, run.state.progress, "2026-01-01T00:00:00+00:00"
        )
        for row in calibration.tendon.values():
            assert row.answer_N == pytest.approx(PULL_TENSION_N, abs=0.8)
        # The measured zero of a motor is the reading of the motor encoder when the digit is open
        # and the tendon is just taut. An error of the motor zero by 0.1 mm of tendon turns the
        # joints of a finger by one degree.
        offset = [peer.world.encoder_offset[name] for name in hand.motor_names]
        travel_errors = (
            calibration.motor_zeros(hand) - offset
        ) * run.controller.model.tendon_constants.spool_radius
        np.testing.assert_allclose(travel_errors, 0.0, atol=5e-5)

        task = TaskProgram(task_of_moves((0.0, 0.6), (40.0, 1.0), (5.0, 1.0), (40.0, 0.3)))
        run, ticks = begin_run(peer, task, calibration, run.k, hand)
        errors = list[np.ndarray]()
        smallest_tensions = list[float]()
        for _ in ticks:
            assert not [event for event in logged_events_of(run) if event.level == "error"]
            if run.state.mode == HandMode.ACTIVE and run.state.progress.phase.startswith("move"):
                errors.append(np.degrees(run.state.view("q_goal") - plant.engine.q))
                smallest_tensions.append(min(plant.tensions()))
        assert np.sqrt(np.mean(np.square(errors))) < 1.0
        assert min(smallest_tensions) > 0.5 * run.controller.model.floor.min(), (
            "no tendon comes near slack"
        )


GRASP_TASK = Task.model_validate(
    {
        "schema": 1,
        "name": "grasp",
        "description": "grasp",
        "phase": (
            {"kind": "move", "name": "home", "angle_deg": 0.0, "duration_s": 0.4},
            {
                "kind": "move",
                "name": "preshape",
                "angle_deg": {"index": 10.0, "middle": 10.0, "thumb": 5.0},
                "duration_s": 0.8,
            },
            {
                "kind": "close",
                "name": "close",
                "angle_deg": 80.0,
                "speed_deg_s": 50.0,
                "contact_tension_N": 18.0,
            },
            {
                "kind": "hold",
                "name": "hold",
                "tension_N": 40.0,
                "rate_N_per_s": 40.0,
                "duration_s": 3.5,
            },
            {"kind": "release", "name": "release", "tension_N": 9.0, "rate_N_per_s": 60.0},
            {"kind": "move", "name": "open", "angle_deg": 0.0, "duration_s": 0.8},
        ),
    }
)
CYLINDER_SCENE = """name = "cylinder"
[object]
shape = "cylinder"
diameter_m = 0.042
length_m = 0.093
mass_kg = 0.2
friction = 0.5
position_m = [0.023, 0.0, 0.0]
[support]
drop_when = "grasped"
drop_hold_s = 0.5
sink_speed_m_s = 0.2
"""


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_an_antagonistic_hand_grasps_holds_and_releases(seed: int) -> None:
    with SimulatorSettings(n_plus_1_hand(), CYLINDER_SCENE, seed, homed=True).simulated_hand(
        round(1e9 / RATE_HZ)
    ) as peer:
        plant = peer.world.plant
        run, ticks = begin_run(peer, TaskProgram(GRASP_TASK), None, 0)
        height, tension = dict[str, float](), dict[str, np.ndarray]()
        touched = set[str]()
        for _ in ticks:
            assert not [event for event in logged_events_of(run) if event.level == "error"]
            touched |= {event.where for event in logged_events_of(run) if event.name == "contact"}
            height[run.state.progress.phase] = plant.engine.object_pose()[2]
            tension[run.state.progress.phase] = np.array(plant.tensions())
        assert touched == {"index", "middle", "thumb"}
        assert height["hold"] == pytest.approx(0.0, abs=2e-3), "the table has sunk, the grasp holds"
        assert height["open"] < -0.05, "the antagonists open the digits"
        is_closing = antagonist_model().redundancy.closing_sign > 0.0
        np.testing.assert_allclose(tension["hold"][is_closing], 40.0, atol=3.0)
        np.testing.assert_allclose(
            tension["hold"][~is_closing],
            antagonist_model().redundancy.balance_tension[~is_closing],
            atol=2.0,
        )


def test_the_balance_makes_no_torque_and_is_at_the_floor_or_above() -> None:
    for digit in antagonist_model().digits:
        balance = antagonist_model().redundancy.balance_tension[digit.tendons]
        np.testing.assert_allclose(digit.moment_arms.T @ balance, 0.0, atol=1e-4)
        assert balance.min() == pytest.approx(
            antagonist_model().floor[digit.tendons].min(), rel=1e-3
        )


def test_springs_of_no_stiffness_are_no_springs() -> None:
    content = n_plus_1_hand().content
    digit_by_name = {digit["name"]: digit for digit in content["digit"]}
    assert digit_by_name["thumb"]["spring_stiffness_N_m_per_rad"] == (0.0, 0.0)
    assert hand_from_content(content, "x").identity == n_plus_1_hand().identity


def test_a_digit_that_nothing_opens_is_refused() -> None:
    content = n_plus_1_hand().content
    for tendon in content["tendon"]:
        if tendon["name"] == "thumb_e":
            tendon["moment_arm_m"] = {"thumb_j1": 0.004, "thumb_j2": 0.003}
    mistakes = [str(mistake) for mistake in reasons_not_ready(hand_from_content(content, "x"))]
    assert len(mistakes) == 1
    assert "digit[thumb]" in mistakes[0]
