"""Test hands in which two antagonistic tendons share one motor (a spool pair).

The tests of spool pairs cover the hand file, the controller and the simulator.
"""

import os
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from handctl.controller.run_setup import make_controller
from handctl.core import state_block as s
from handctl.core.calibration import Calibration
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.tendon_redundancy import tendon_directions
from handctl.core.estimation.spool_pair import net_tension_at_joint, net_tension_at_spool
from handctl.core.gains.gains import Gains
from handctl.core.hand_estimate import HandEstimate, TickMeasurements
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import HandMode
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.hand_loading import hand_content, hand_from_content, load_hand, validate_content
from handctl.hand.readiness_checks import reasons_not_ready
from handctl.log.header import RunHeader
from handctl.log.topics.message_streams import TopicRegistry
from handctl.log.topics.state_topics import SPOOL_PAIRS_TOPIC, StateTopics
from handctl.log.topics.topic_set import TopicSet
from handctl.programs.commission import PULL_TENSION_N, CommissionProgram, calibration_of_result
from handctl.programs.default_task import default_task
from handctl.programs.program import Program, ProgramProgress, ProgressAndEvents
from handctl.programs.task import ClosePhase, HoldPhase, Task
from handctl.programs.task_program import TaskProgram
from handctl.session.calibration import homed_calibration
from handctl.session.lockstep_simulation import SimulatedHand, SimulatedRun, SimulatorSettings
from tests.controller.synthetic_states import uncompiled_function

RATE_HZ = 500.0
SPOOL_FINGER_FILE = Path(__file__).with_name("spool_finger.toml")
SIMULATOR_SEEDS = range(20 if os.environ.get("HANDCTL_NIGHTLY") == "1" else 2)


@cache
def spool_finger() -> Hand:
    """Return a hand with one finger that has two joints.

    At each joint of the finger, two antagonistic tendons share one motor.
    """
    return load_hand(SPOOL_FINGER_FILE)


# --- net tension and tendons --------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(20))
def test_the_net_tension_is_the_difference_of_two_tensions_that_only_pull(seed: int) -> None:
    random = np.random.default_rng(seed)
    net, pretension = random.uniform(-60.0, 60.0), random.uniform(0.0, 20.0)
    assert uncompiled_function(net_tension_at_joint)(net, pretension, 1.0) == pytest.approx(net)
    # The second net tension is half of the first tendon's tension minus twice the second tendon's
    # tension. The second net tension gives a second equation for the two tensions.
    net_tension_at_half_ratio = uncompiled_function(net_tension_at_joint)(net, pretension, 0.5)
    first_tension = (2.0 * net - net_tension_at_half_ratio) / 1.5
    second_tension = first_tension - net
    assert min(first_tension, second_tension) >= -1e-9
    assert (min(first_tension, second_tension) < 1e-9) == (abs(net) >= 2.0 * pretension)
    assert max(first_tension, second_tension) == pytest.approx(
        max(pretension + abs(net) / 2.0, abs(net))
    )


@pytest.mark.parametrize("seed", range(20))
def test_friction_of_both_tendons_is_subtracted_and_added_back(seed: int) -> None:
    random = np.random.default_rng(seed)
    net, pretension, passed = (
        random.uniform(-60.0, 60.0),
        random.uniform(0.0, 20.0),
        np.exp(random.uniform(-0.3, 0.3)),
    )
    behind = uncompiled_function(net_tension_at_joint)(net, pretension, passed)
    assert uncompiled_function(net_tension_at_spool)(behind, pretension, passed) == pytest.approx(
        net, abs=1e-9
    )
    # The pretension of a spool pair causes friction even without net tension. Friction reduces the
    # tension of the tendon that is wound up, and raises the tension of the other tendon.
    lost = net - uncompiled_function(net_tension_at_joint)(
        net, pretension, min(passed, 1.0 / passed)
    )
    assert lost >= 0.0


def test_a_single_tendon_is_the_limit_of_a_pair_without_pretension() -> None:
    assert uncompiled_function(net_tension_at_joint)(10.0, 0.0, 0.8) == pytest.approx(8.0)
    assert uncompiled_function(net_tension_at_joint)(-10.0, 0.0, 0.8) == pytest.approx(-12.5)


@pytest.mark.parametrize("stretch_mm", [0.0, 0.1, -0.1, 0.16, 0.4, -0.4])
def test_the_simulated_spool_pulls_one_tendon_and_slackens_the_other(stretch_mm: float) -> None:
    """Up to a net tension of twice the pretension, both tendons are taut, and their stiffnesses add up.

    Above a net tension of twice the pretension, only one of the two tendons is taut.
    """
    tendon, motor = spool_finger().tendon[0], spool_finger().motor[0]
    pretension = tendon.pretension_N
    assert pretension is not None
    with SimulatorSettings(spool_finger(), None, 0, homed=True).simulated_hand(2_000_000) as peer:
        plant = peer.world.plant
        plant.engine.set_joints([0.0, 0.0], [0.0, 0.0])
        plant.motors[motor.name].theta = stretch_mm * 1e-3 / motor.spool_radius_m
        first_tension, second_tension = plant.tensions_in_pairs()[:2]
        tension_change = tendon.stiffness_N_per_m * stretch_mm * 1e-3
        assert first_tension == pytest.approx(max(pretension + tension_change, 0.0), abs=1e-9)
        assert second_tension == pytest.approx(max(pretension - tension_change, 0.0), abs=1e-9)
        assert plant.tensions()[0] == pytest.approx(first_tension - second_tension)


# --- control ------------------------------------------------------------------------------------------------------


def begin_run(
    simulated_hand: SimulatedHand,
    hand: Hand,
    program: Program,
    calibration: Calibration | None,
    first_tick: int,
) -> SimulatedRun:
    """Begin a run in which a program controls a simulated hand.

    The run begins at tick ``first_tick``.

    An earlier run can have moved the simulated hand.
    """
    controller = make_controller(hand, Gains(), RATE_HZ, program, calibration, arm_at_once=True)
    run = SimulatedRun.start_run(controller, simulated_hand)
    run.k = first_tick
    run.are_ticks_recorded = False
    run.state.run_integers[s.K] = first_tick - 1
    return run


MOVES_TASK = Task.model_validate(
    {
        "schema": 1,
        "name": "moves",
        "description": "moves",
        "phase": tuple(
            {"kind": "move", "name": f"move {i}", "angle_deg": angle, "duration_s": duration}
            for i, (angle, duration) in enumerate(
                [(0.0, 0.6), (50.0, 0.6), (-5.0, 0.6), (50.0, 0.25)]
            )
        ),
    }
)


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_it_commissions_tracks_and_relaxes_from_a_cold_start(seed: int) -> None:
    """The commissioning program finds the true motor zeros of the simulated hand.

    The joints of the commissioned hand follow their goals within one degree, and no tendon exceeds
    its tension limit.
    """
    hand = spool_finger()
    with SimulatorSettings(hand, None, seed).simulated_hand(round(1e9 / RATE_HZ)) as peer:
        plant = peer.world.plant
        run = begin_run(peer, hand, CommissionProgram(), None, 0)
        for _, out in run.run_ticks(60.0):
            assert not [event for event in out.events if event.level == "error"]
        assert not run.state.progress.failure
        calibration = calibration_of_result(
            run.controller.model, run.state.progress, "2026-01-01T00:00:00+00:00"
        )
        assert all(
            row.answer_N == pytest.approx(PULL_TENSION_N, abs=0.8)
            for row in calibration.tendon.values()
        )
        # Without load cells and joint encoders, friction makes each motor zero uncertain by 0.1 mm
        # of tendon. An error of 0.1 mm corresponds to half a degree of joint angle.
        offset = [peer.world.encoder_offset[name] for name in hand.motor_names]
        wound = [tendon.extra_length + hand.tendon[i].pretension_N / hand.tendon[i].stiffness_N_per_m
                 for i, (tendon, _) in enumerate(plant.tendons[: len(hand.tendon)])]  # fmt: skip
        travel_errors = (
            calibration.motor_zeros(hand) - offset
        ) * run.controller.model.tendon_constants.spool_radius - wound
        np.testing.assert_allclose(travel_errors, 0.0, atol=1e-4)

        run = begin_run(peer, hand, TaskProgram(MOVES_TASK), calibration, run.k)
        errors = list[np.ndarray]()
        largest = 0.0
        for _, out in run.run_ticks(run.k / RATE_HZ + 30.0):
            assert not [event for event in out.events if event.level == "error"]
            largest = max(largest, *plant.tensions_in_pairs())
            if run.state.mode == HandMode.ACTIVE and run.state.progress.phase.startswith("move"):
                errors.append(np.degrees(run.state.view("q_goal") - plant.engine.q))
        assert np.sqrt(np.mean(np.square(errors))) < 1.0
        assert largest < hand.tendon[0].tension_max_N
        assert run.state.mode == HandMode.DONE
        assert np.abs(plant.tensions()).max() < 6.0, "friction alone holds the joints"


@dataclass(frozen=True)
class PullProgram:
    """Program that pulls both spool pairs of the finger with the same net tension [N]."""

    tension: float

    def initial_progress(self, model: HandModel) -> ProgramProgress:
        return ProgramProgress.initial(len(model.digits), "pull")

    def advance(
        self,
        model: HandModel,
        progress: ProgramProgress,
        estimate: HandEstimate,
        measurements: TickMeasurements,
        t: float,
    ) -> ProgressAndEvents:
        if progress.step:
            return progress, ()
        goal = DigitGoal(GoalKind.TENSION, tension=np.full(2, self.tension), rate=60.0)
        return replace(progress, step=1, goals=(goal,), contact=(True,)), ()


@pytest.mark.parametrize("tension", [-200.0, -40.0, 12.0, 40.0, 200.0])
def test_it_pulls_both_ways_and_never_above_the_limit(tension: float) -> None:
    """When a joint rests at its mechanical stop, the net tension of the spool pair reaches the commanded net tension.

    The controller limits the commanded net tension to the tension limit of the hand minus a margin.
    The margin is a multiple of the standard deviation of the estimated tension.
    """
    hand = spool_finger()
    limit = hand.tendon[0].tension_max_N
    with SimulatorSettings(hand, None, 0, homed=True).simulated_hand(round(1e9 / RATE_HZ)) as peer:
        run = begin_run(peer, hand, PullProgram(tension), homed_calibration(hand, {}), 0)
        model = run.controller.model
        goal = np.clip(tension, model.floor, model.ceiling)
        for _, out in run.run_ticks(4.5):
            assert not [event for event in out.events if event.level == "error"]
            assert max(peer.world.plant.tensions_in_pairs()) < limit
        np.testing.assert_allclose(run.state.view("tension"), goal, atol=0.5)
        np.testing.assert_allclose(peer.world.plant.tensions(), goal, atol=1.0)


@pytest.mark.parametrize(
    ("tension", "tendon"), [(40.0, "finger_mcp"), (-40.0, "finger_mcp_antagonist")]
)
def test_a_tendon_that_snaps_under_load_is_found(tension: float, tendon: str) -> None:
    hand = spool_finger()
    with SimulatorSettings(hand, None, 0, homed=True).simulated_hand(round(1e9 / RATE_HZ)) as peer:
        run = begin_run(peer, hand, PullProgram(tension), homed_calibration(hand, {}), 0)
        peer.inject(f"snap tendon={tendon} at=2s")
        faults = [
            event.text
            for _, out in run.run_ticks(4.5)
            for event in out.events
            if event.level == "error"
        ]
        assert faults
        assert "finger_mcp" in faults[0]
        assert run.state.mode in (HandMode.RELAX, HandMode.DISARM, HandMode.DONE)


# --- hand files ---------------------------------------------------------------------------------------------------


def content_with_tendon(**tendon_fields: object) -> dict[str, object]:
    """Return the content of the finger's hand file, in which ``tendon_fields`` replace values of the first tendon."""
    content = hand_content(SPOOL_FINGER_FILE)
    return content | {"tendon": [content["tendon"][0] | tendon_fields, *content["tendon"][1:]]}


def content_with_digit(**digit_fields: object) -> dict[str, object]:
    """Return the content of the finger's hand file, in which ``digit_fields`` replace values of the digit."""
    content = hand_content(SPOOL_FINGER_FILE)
    return content | {"digit": [content["digit"][0] | digit_fields]}


def content_without_pretension() -> dict[str, object]:
    content = content_with_tendon(tension_floor_N=2.0)
    del content["tendon"][0]["pretension_N"]  # type: ignore[index]
    return content


HAND_FILE_MISTAKES = {
    "half the limit": (
        content_with_tendon(pretension_N=31.0),
        "pretension_N",
        "at most tension_max_N / 2 = 30 N",
    ),
    "a floor": (
        content_with_tendon(tension_floor_N=2.0),
        "tension_floor_N",
        "0 in the section of this spool pair",
    ),
    "one single": (
        content_without_pretension(),
        "finger_mcp",
        "pretension_N on all tendons of finger, or on none",
    ),
    "one motor": (
        content_with_tendon(motor="finger_pip"),
        "finger_pip",
        "one tendon with pretension_N for both tendons",
    ),
    "coupling": (
        content_with_digit(coupling=[[1.0], [1.0]]),
        "digit[finger].tendon",
        "one spool pair per coordinate",
    ),
    "springs": (
        content_with_digit(spring_stiffness_N_m_per_rad=[0.1, 0.1], spring_preload_rad=[0.1, 0.1]),
        "spring_stiffness_N_m_per_rad",
        "no springs",
    ),
}


@pytest.mark.parametrize("mistake_name", HAND_FILE_MISTAKES)
def test_a_mistake_is_one_line_that_names_the_key(mistake_name: str) -> None:
    content, where, expected_text = HAND_FILE_MISTAKES[mistake_name]
    hand, mistakes = validate_content(content)
    assert hand is None
    text = str(mistakes[0].error("x.toml"))
    assert where in text
    assert expected_text in text
    assert "\n" not in text


def test_a_load_cell_on_a_pair_is_refused() -> None:
    node = hand_content("t42")["sensor_node"] | {"tendons": ["finger_mcp"]}
    _, mistakes = validate_content(hand_content(SPOOL_FINGER_FILE) | {"sensor_node": node})
    assert "finger_mcp is a spool pair" in str(mistakes[0].error("x.toml"))


def test_a_hand_with_pairs_is_ready_and_reads_back_as_itself() -> None:
    hand = spool_finger()
    assert not list(reasons_not_ready(hand))
    assert [tendon.tension_floor_N for tendon in hand.tendon] == [0.0, 0.0]
    repeated_hand = hand_from_content(hand.content, "again")
    assert repeated_hand.identity == hand.identity
    assert "pretension_N" not in load_hand("jamia").to_toml(), (
        "hands without pairs keep their identity"
    )


# --- orca_like ----------------------------------------------------------------------------------------------------


def test_orca_like_closes_its_fingers_and_does_not_spread_them() -> None:
    hand = load_hand("orca_like")
    assert len(hand.joints) == len(hand.motor) == 17
    assert hand.is_pair.all()
    close, hold = default_task(hand)[0].phase[1:3]
    assert isinstance(close, ClosePhase)
    assert isinstance(hold, HoldPhase)
    assert isinstance(close.angle_deg, dict)
    assert set(close.angle_deg) == {"index", "middle", "ring", "pinky", "thumb"}
    for name in ("index", "middle", "ring", "pinky"):
        digit = DigitModel.from_hand(hand, name)
        assert tendon_directions(digit, hand.is_pair[digit.tendons]).tolist() == [0.0, 1.0, 1.0]
        assert close.angle_deg[name] == (0.0, 85.0, 91.0)
    thumb = DigitModel.from_hand(hand, "thumb")
    assert tendon_directions(thumb, hand.is_pair[thumb.tendons]).tolist() == [1.0, 0.0, 1.0, 1.0]


def test_the_log_has_both_tensions_of_each_pair() -> None:
    header = RunHeader.from_hand(load_hand("orca_like").to_toml(), 2_500_000)
    assert SPOOL_PAIRS_TOPIC in {channel.topic for channel in TopicSet(header).channels}
    assert SPOOL_PAIRS_TOPIC not in {
        channel.topic
        for channel in TopicSet(
            RunHeader.from_hand(load_hand("jamia").to_toml(), 2_500_000)
        ).channels
    }
    state = StateTopics(header, TopicRegistry())
    net = np.zeros((1, 17))
    net[0, :3] = 4.0, -30.0, 30.0
    tendon_tensions = state._pair_tensions(net).reshape(17, 2)
    np.testing.assert_allclose(
        tendon_tensions[:4], [[12.0, 8.0], [0.0, 30.0], [30.0, 0.0], [10.0, 10.0]]
    )
