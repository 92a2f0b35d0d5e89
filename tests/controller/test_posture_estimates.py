"""Test estimated joint angles and their standard deviations in simulated grasps.

Further tests compare the equations of the joint-angle estimate with plain linear algebra.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from handctl.compiled import kernel
from handctl.controller.controller_state import ControllerState
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import constant_tables
from handctl.core.estimation import posture
from handctl.core.gains.gains import Gains
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.core.tick_types import HandMode
from handctl.hand.hand_loading import PACKAGED_HANDS_FOLDER, load_hand
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller
from handctl.session.task_loading import load_task_for_hand
from tests.controller.synthetic_states import (
    SyntheticEstimate,
    active_state,
    constant_tables_of,
    controller_of,
    detect_contacts,
    estimate_under_tension,
)

RATE_HZ = 250.0
PERIOD_NS = round(1e9 / RATE_HZ)
SIMULATOR_SEEDS = range(20) if os.environ.get("HANDCTL_NIGHTLY") else (3,)
GRASPS_AND_OBJECTS = [
    ("grasp.toml", "cylinder"),
    ("pinch.toml", "sphere"),
    ("hook.toml", "handle"),
    ("grasp.toml", "box"),
]
HELD_PHASES, FREE_PHASES = ("close", "hold", "release"), ("tighten", "home")


class GraspPostureSample(NamedTuple):
    """Values of one tick of a grasp: the phase, the angle of each joint [rad], and the contact force on each digit [N].

    The joint angles are the true angles, the estimated angles with their standard deviations, and
    ``angles_of_free_hand``. ``angles_of_free_hand`` are the angles that the digits would have
    without contact.
    """

    phase: str
    true_angles: np.ndarray
    q: np.ndarray
    sigma: np.ndarray
    angles_of_free_hand: np.ndarray
    force: np.ndarray


def packaged_task(task_name: str) -> Path:
    return PACKAGED_HANDS_FOLDER / f"{task_name}.toml"


def hand_file_with_encoders(folder: Path, joints_with_encoders: int | None = None) -> Path:
    """Write a hand file of jamia with encoders at all joints, or at the first ``joints_with_encoders`` joints.

    Return the path of the hand file.
    """
    text = packaged_task("jamia").read_text(encoding="utf-8")
    read = load_hand("jamia").joints[:joints_with_encoders]
    path = folder / "encoders.toml"
    path.write_text(
        text.replace("joints = []", f"joints = {list(read)}".replace("'", '"')), encoding="utf-8"
    )
    return path


def run_grasp(
    hand_file: Path, task_name: str, scene_name: str, seed: int
) -> Iterator[GraspPostureSample]:
    """Yield one ``GraspPostureSample`` for each tick of a simulated grasp."""
    model = HandModel.from_hand(load_hand(str(hand_file)), Gains(), RATE_HZ)
    program = TaskProgram(load_task_for_hand(Path(task_name), model.hand)[0])
    with SimulatorSettings(hand_file, scene_name, seed, homed=True).begin_run(
        homed_controller(model, program)
    ) as run:
        plant, run.are_ticks_recorded = run.simulated_hand.world.plant, False
        for _, out in run.run_ticks():
            numbers, real = out.telemetry, np.array(plant.engine.q)
            force = np.linalg.norm(np.reshape(plant.contact_forces(), (-1, 3)), axis=1)
            free = model.excursion_to_joints @ numbers.excursion
            yield GraspPostureSample(out.phase, real, numbers.q, numbers.q_sigma, free, force)
            if run.state.mode == HandMode.RELAX:
                break


def root_mean_square(errors: np.ndarray) -> float:
    return float(np.degrees(np.sqrt(np.mean(errors**2))))


@pytest.mark.parametrize(
    ("task_name", "scene_name"),
    GRASPS_AND_OBJECTS if os.environ.get("HANDCTL_NIGHTLY") else GRASPS_AND_OBJECTS[:2],
)
def test_the_truth_is_within_two_sigma_in_a_grasp(task_name: str, scene_name: str) -> None:
    """For at least 95 % of the joints and ticks, the true joint angle is within two standard deviations.

    While a hand holds an object, the error of each joint angle is nearly constant. A run of a hand
    with eleven joints therefore gives only eleven different errors. A single error above two
    standard deviations does not show that a standard deviation is wrong. The limit of 95 % applies
    to the runs with all seeds together. In a single run, the error of one joint is allowed to
    exceed two standard deviations.

    During the hold of an object, joint angles that are computed without regard to the contact have
    larger errors.
    """
    is_within_two_sigma = []
    for seed in SIMULATOR_SEEDS:
        grasp_samples = list(run_grasp(packaged_task("jamia"), task_name, scene_name, seed))
        held_samples = [sample for sample in grasp_samples if sample.phase in HELD_PHASES]
        is_inside = np.array(
            [np.abs(sample.q - sample.true_angles) <= 2.0 * sample.sigma for sample in held_samples]
        )
        is_within_two_sigma.append(is_inside.mean())
        assert is_within_two_sigma[-1] >= 1.0 - 1.0 / is_inside.shape[1], f"seed {seed}"
        hold = [sample for sample in grasp_samples if sample.phase == "hold"]
        assert len(hold) > 1000
        error = root_mean_square(np.array([sample.q - sample.true_angles for sample in hold]))
        assumed_rms = root_mean_square(
            np.array([sample.angles_of_free_hand - sample.true_angles for sample in hold])
        )
        assert error < 0.7 * assumed_rms, (
            f"seed {seed}: {error:.1f} deg, free digit {assumed_rms:.1f} deg"
        )
        free = [sample for sample in grasp_samples if sample.phase in FREE_PHASES]
        assert root_mean_square(np.array([sample.sigma for sample in free])) < 1.0
        assert root_mean_square(np.array([sample.q - sample.true_angles for sample in free])) < 0.5
    assert np.mean(is_within_two_sigma) >= 0.95


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
def test_joint_encoders_measure_the_angles_of_a_held_digit(tmp_path: Path, seed: int) -> None:
    grasp_samples = list(
        run_grasp(hand_file_with_encoders(tmp_path), "grasp.toml", "cylinder", seed)
    )
    hold = [sample for sample in grasp_samples if sample.phase == "hold"]
    error = np.array([sample.q - sample.true_angles for sample in hold])
    assert root_mean_square(error) < 0.2
    assert root_mean_square(np.array([sample.sigma for sample in hold])) < 0.2
    moving = [sample for sample in grasp_samples if sample.phase in ("close", "release", "open")]
    is_within_two_sigma = np.mean(
        [np.abs(sample.q - sample.true_angles) <= 2.0 * sample.sigma for sample in moving + hold]
    )
    assert is_within_two_sigma >= 0.9


class JointAngles(NamedTuple):
    """Angle of each joint, and the standard deviation of each angle [rad]."""

    q: np.ndarray
    sigma: np.ndarray


def angles_of_tick(
    model: HandModel,
    state: ControllerState,
    estimate: SyntheticEstimate,
    external_tension: np.ndarray,
    tick_index: int,
) -> JointAngles:
    """Return the joint angles that are estimated in tick ``tick_index`` if each digit has a given external tension [N].

    The function also writes the external tensions, the tick number and the joint angles into the
    state.
    """
    state.view("touch")[...] = external_tension
    state.run_integers[s.K] = tick_index
    detect_contacts(
        model,
        state,
        estimate._replace(external_tension=external_tension[list(model.digit_of_tendon)]),
    )
    np.testing.assert_allclose(state.view("touch"), external_tension, err_msg="it lasts")
    return JointAngles(state.view("q").copy(), state.view("q_sigma").copy())


@pytest.mark.parametrize("hand", ["jamia", "jamia_bench", "jamia11"])
def test_contact_turns_joints_and_keeps_the_excursion(hand: str) -> None:
    model = HandModel.from_hand(load_hand(hand), Gains(), RATE_HZ)
    estimate, state = estimate_under_tension(model, 30.0, 0.6), active_state(model)
    contact_forces = np.full(len(model.digits), 15.0)
    for k in range(200):
        angles = angles_of_tick(model, state, estimate, contact_forces, k)
    moment_arms = model.hand.moment_arms
    np.testing.assert_allclose(moment_arms @ angles.q, moment_arms @ estimate.q, atol=1e-9)
    turned = np.degrees(np.abs(angles.q - estimate.q).max())
    assert (turned > 5.0) == (hand != "jamia11")
    assert (np.degrees(angles.sigma.max()) > 5.0) == (hand != "jamia11")


def test_the_deviation_grows_with_the_force_and_fades_after_it(model: HandModel) -> None:
    estimate, state = estimate_under_tension(model, 30.0, 0.6), active_state(model)
    zero_force = np.zeros(len(model.digits))

    def angles_after_contact(contact_forces: np.ndarray, seconds: float) -> JointAngles:
        for k in range(round(seconds / model.period)):
            angles = angles_of_tick(model, state, estimate, contact_forces, k)
        return angles

    constants = constant_tables_of(model)
    free = bool(constants.run_int[h.HAS_NULL_SPACE])
    first_angles = angles_of_tick(model, state, estimate, zero_force, 1)
    if free:
        span = np.concatenate([digit.joint_max - digit.joint_min for digit in model.digits])
        np.testing.assert_array_equal(constants.joint[h.ANGLE_RANGE_SIGMA], span / np.sqrt(12.0))
        np.testing.assert_array_equal(
            first_angles.sigma, constants.joint[h.ANGLE_RANGE_SIGMA], "nothing is known yet"
        )
    sizes = []
    for force in (0.0, 3.0, 10.0):
        sizes.append(float(angles_after_contact(zero_force + force, 0.5).sigma.mean()))
    if free:
        assert sizes == sorted(sizes)
        assert sizes[-1] > 2.0 * sizes[0]
    angles = angles_after_contact(zero_force, 3.0)
    assert float(angles.sigma.mean()) == pytest.approx(sizes[0], rel=0.1)


@kernel("block", "layout", "constants", "layout", "matrix", "matrix", "count")
def _fuse_encoders(
    block: BlockArray,
    state_offsets: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    covariance_columns: np.ndarray,
    angle_deviations: np.ndarray,
    t_ns: int,
) -> None:
    posture._fuse_encoders(
        state_tables(block, state_offsets),
        constant_tables(constants, constant_offsets),
        covariance_columns,
        angle_deviations,
        t_ns,
    )


def state_after_fusion(
    model: HandModel,
    state: ControllerState,
    covariance_columns: np.ndarray,
    angle_deviations: np.ndarray,
    t_ns: int,
) -> ControllerState:
    """Return the state after the filter has fused readings of joint encoders with the estimate.

    Two arguments define the covariance of the estimated joint angles before the fusion. Each row of
    ``covariance_columns`` (deviations, joints) [rad] is a deviation of all joint angles. The
    deviations of different rows are statistically independent. ``angle_deviations`` (joints,
    tendons) [rad] contains the error that the excursion error of each tendon causes in each joint
    angle.
    """
    state_after = state.copy()
    _fuse_encoders(
        state_after.block,
        *controller_of(model).derived_constants.kernel_args,
        covariance_columns,
        angle_deviations,
        t_ns,
    )
    return state_after


def test_encoders_are_fused_as_a_kalman_filter_does(tmp_path: Path) -> None:
    """In this test, only one joint has an encoder.

    The filter weights the estimated angle and the encoder reading of this joint according to their
    covariances. The filter also corrects the angles of joints without an encoder, because their
    errors are correlated with the error of the measured joint.
    """
    model = HandModel.from_hand(
        load_hand(str(hand_file_with_encoders(tmp_path, joints_with_encoders=1))), Gains(), RATE_HZ
    )
    joints, state = len(model.hand.joints), active_state(model)
    noise = constant_tables_of(model).joint[h.ENCODER_VARIANCE]
    columns = np.zeros((2, joints))
    columns[0, :3] = (0.2, -0.1, -0.1)
    columns[1, :3] = (0.0, 0.05, -0.05)
    state.view("q")[...], state.view("q_sigma")[...] = 0.5, np.sqrt((columns**2).sum(axis=0))
    state.view("joint_angle")[0] = 0.7
    state.view("group_ns")[...] = 0
    spread = np.zeros((joints, model.tendon_count))
    state_after = state_after_fusion(model, state, columns, spread, 0)
    P = columns.T @ columns
    gain = P[:, 0] / (P[0, 0] + noise[0])
    np.testing.assert_allclose(state_after.view("q"), 0.5 + gain * 0.2, rtol=1e-9)
    np.testing.assert_allclose(
        state_after.view("q_sigma")[0] ** 2, P[0, 0] - gain[0] * P[0, 0], atol=1e-12
    )
    np.testing.assert_array_equal(state_after.view("q_sigma")[1:], state.view("q_sigma")[1:])
    state_after_old_reading = state_after_fusion(model, state, columns, spread, round(1e9))
    np.testing.assert_array_equal(
        state_after_old_reading.block,
        state.block,
        "of a reading that is a second old nothing is used",
    )


@pytest.mark.parametrize("seed", range(20))
def test_sequential_encoder_updates_equal_one_matrix_update(tmp_path: Path, seed: int) -> None:
    """The estimator fuses the readings of the joint encoders one after the other.

    One matrix update with all encoders gives the same result as a series of updates with one
    encoder each. Both kinds of update leave out encoder readings from frames that are too old.
    """
    model = HandModel.from_hand(load_hand(str(hand_file_with_encoders(tmp_path))), Gains(), RATE_HZ)
    rng, constants, state = (
        np.random.default_rng(seed),
        constant_tables_of(model),
        active_state(model),
    )
    joints, now = len(model.hand.joints), 10**9
    columns, spread = (
        0.2 * rng.normal(size=(12, joints)),
        0.02 * rng.normal(size=(joints, model.tendon_count)),
    )
    state.view("q")[...], state.view("dq")[...] = (
        rng.uniform(0.0, 1.5, joints),
        rng.normal(size=joints),
    )
    state.view("joint_angle")[...] = state.view("q") + 0.2 * rng.normal(size=joints)
    heard_ns = rng.integers(
        now - round(1.5 * posture.MAX_READING_AGE_S * 1e9), now, len(state.view("group_ns"))
    )
    state.view("group_ns")[...] = heard_ns
    state_after = state_after_fusion(model, state, columns, spread, now)

    age = (now - heard_ns[constants.joint_int[h.JOINT_GROUP]]) * 1e-9
    read = np.flatnonzero(
        constants.joint_int[h.IS_ENCODER_FUSED].astype(bool) & (age < posture.MAX_READING_AGE_S)
    )
    moved = state.view("dq") * age
    digit = np.repeat(
        np.arange(len(model.digits)), [digit_model.joint_count for digit_model in model.digits]
    )
    P = (columns.T @ columns + spread @ spread.T) * (digit[:, None] == digit)
    R = np.diag(
        constants.joint[h.ENCODER_VARIANCE, read] + (posture.RATE_ERROR_FRACTION * moved[read]) ** 2
    )
    H = np.eye(joints)[read]
    gain = np.linalg.solve(H @ P @ H.T + R, H @ P).T
    q = state.view("q") + gain @ (state.view("joint_angle") + moved - state.view("q"))[read]
    np.testing.assert_allclose(state_after.view("q"), q, rtol=0.0, atol=1e-12)
    if len(read):
        remaining_fraction = np.eye(joints) - gain @ H
        variance = np.diagonal(remaining_fraction @ P @ remaining_fraction.T + gain @ R @ gain.T)
        np.testing.assert_allclose(state_after.view("q_sigma") ** 2, variance, rtol=0.0, atol=1e-12)
