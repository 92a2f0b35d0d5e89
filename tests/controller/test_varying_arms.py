"""Test the control of hands whose moment arms depend on the joint angle."""

from functools import cache

import numpy as np
import pytest

from handctl.compiled import kernel
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import constant_tables
from handctl.core.estimation import varying_moment_arms
from handctl.core.gains.gains import Gains
from handctl.core.hand_constants import HandConstants, _joint_compliance
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.core.tick_types import HandMode
from handctl.hand.description import Hand
from handctl.hand.hand_loading import packaged_hands
from handctl.hand.tendons import excursions
from handctl.programs.task import Task
from handctl.programs.task_program import TaskProgram
from handctl.session.lockstep_simulation import SimulatorSettings, homed_controller
from tests.conftest import NIGHTLY
from tests.controller.synthetic_states import active_state
from tests.hand.varying_arm_hands import hand_with_varying_arms

PACKAGED_HANDS = packaged_hands()
RATE_HZ = 400.0
SIMULATOR_SEEDS = range(20) if NIGHTLY else range(2)


@kernel("block", "layout", "block", "layout")
def _update_structure(
    block: BlockArray,
    state_offsets: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
) -> None:
    varying_moment_arms.update_moment_arm_tables(
        state_tables(block, state_offsets), constant_tables(constants, constant_offsets)
    )


@kernel("block", "layout", "constants", "layout", "count", "count", "real")
def _excursion_and_derivatives(
    block: BlockArray,
    state_offsets: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    tendon_index: int,
    joint_index: int,
    joint_angle: float,
) -> np.ndarray:
    c = constant_tables(constants, constant_offsets)
    return np.array([
        varying_moment_arms.joint_excursion(c, tendon_index, joint_index, joint_angle),
        varying_moment_arms.moment_arm(c, tendon_index, joint_index, joint_angle),
        varying_moment_arms.moment_arm_slope(c, tendon_index, joint_index, joint_angle),
    ])  # fmt: skip


@cache
def model_of(hand_name: str, arm_variation: float = 0.3) -> HandModel:
    return HandModel.from_hand(hand_with_varying_arms(hand_name, arm_variation), Gains(), RATE_HZ)


@pytest.mark.parametrize("hand_name", PACKAGED_HANDS)
def test_the_structure_tables_are_those_at_the_present_angles(hand_name: str) -> None:
    model = model_of(hand_name)
    constants = HandConstants(model, {})
    for seed in SIMULATOR_SEEDS:
        chance = np.random.default_rng(seed)
        state = active_state(model)
        q = np.zeros(len(model.hand.joints))
        for digit in model.digits:
            low, high = digit.coordinate_limits
            q[digit.joints] = digit.coupling @ chance.uniform(0.7 * low + 0.3 * high, high)
            q[digit.joints] = np.clip(q[digit.joints], digit.joint_min, digit.joint_max)
            q[digit.joints] = digit.coupling @ (digit.joints_to_coordinates @ q[digit.joints])
            state.view("excursion")[digit.tendons] = excursions(digit, q[digit.joints])
        state.view("q")[...] = np.nan if seed == 0 else chance.uniform(0.0, 1.0, len(q))
        _update_structure(
            state.block, state.layout.offsets, constants.block, constants.layout.offsets
        )
        view = {field: constants.layout.view(constants.block, field) for field in STRUCTURE_FIELDS}
        angles_of_free_digits = (
            view["excursion_to_joints"] @ state.view("excursion") + view["angle_offset"]
        )
        np.testing.assert_allclose(angles_of_free_digits, q, atol=1e-9)
        for digit in model.digits:
            digit_at_angles = digit.with_moment_arms_at(q[digit.joints])
            block = np.ix_(
                range(*digit.joints.indices(len(q))),
                range(*digit.tendons.indices(model.tendon_count)),
            )
            np.testing.assert_allclose(
                view["moment_arms"].T[block], digit_at_angles.moment_arms.T, atol=1e-8
            )
            for field in ("excursion_to_joints", "torque_to_tension"):
                structure_table = view[field] if field == "excursion_to_joints" else view[field].T
                np.testing.assert_allclose(
                    structure_table[block],
                    digit_at_angles.excursion_to_joints,
                    rtol=1e-4,
                    atol=1e-3,
                )
            joint_block = np.ix_(*[range(*digit.joints.indices(len(q)))] * 2)
            np.testing.assert_allclose(
                view["compliance"][joint_block],
                _joint_compliance(digit_at_angles),
                rtol=1e-4,
                atol=1e-4,
            )
            balance = view["balance"][digit.tendons]
            if model.redundancy.has_surplus[digit.tendons.start]:
                assert (balance > 0.0).all()
                arms = digit_at_angles.reduced_moment_arms
                np.testing.assert_allclose(
                    arms.T @ balance, 0.0, atol=2e-3 * np.abs(arms).max() * balance.max()
                )


STRUCTURE_FIELDS = (
    "excursion_to_joints",
    "angle_offset",
    "moment_arms",
    "torque_to_tension",
    "compliance",
    "balance",
)


def test_arm_and_slope_are_derivatives_of_the_excursion() -> None:
    model = model_of("jamia11")
    constants = HandConstants(model, {})
    state = active_state(model)
    blocks_and_offsets = (
        state.block,
        state.layout.offsets,
        constants.block,
        constants.layout.offsets,
    )
    for q in np.random.default_rng(3).uniform(-0.2, 2.0, 20).tolist():
        step = 1e-5
        values_at_angle, values_before, values_after = (
            _excursion_and_derivatives(*blocks_and_offsets, 2, 1, angle)
            for angle in (q, q - step, q + step)
        )
        np.testing.assert_allclose(
            (values_after - values_before)[:2] / (2 * step), values_at_angle[1:], atol=1e-8
        )


def task_of_moves(*angles_deg: tuple[float, float]) -> Task:
    """Return a task with one move for each pair of an angle and a duration.

    A pair contains one target angle for all joints [deg] and the duration of the move [s].
    """
    phases = [
        {"kind": "move", "name": f"move {i}", "angle_deg": angle, "duration_s": duration}
        for i, (angle, duration) in enumerate(angles_deg)
    ]
    return Task.model_validate(
        {"schema": 1, "name": "moves", "description": "moves", "phase": tuple(phases)}
    )


def tracking_error_deg(model: HandModel, hand: Hand, seed: int) -> float:
    """Return the RMSE between true and commanded joint angles [deg] while a simulated hand moves."""
    task = TaskProgram(
        task_of_moves((5.0, 0.5), (42.0, 0.7), (15.0, 0.6), (45.0, 0.6), (10.0, 0.6))
    )
    errors = list[np.ndarray]()
    with SimulatorSettings(hand, None, seed, homed=True).begin_run(
        homed_controller(model, task, hand)
    ) as run:
        run.are_ticks_recorded = False
        for _, out in run.run_ticks(10.0):
            assert not [event for event in out.events if event.level == "error"]
            if run.state.mode == HandMode.ACTIVE and run.state.progress.phase.startswith("move"):
                errors.append(
                    np.degrees(run.state.view("q_goal") - run.simulated_hand.world.plant.engine.q)
                )
        assert run.state.mode == HandMode.DONE
    return float(np.sqrt(np.mean(np.square(errors))))


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("hand_name", ["jamia11", "n_plus_1"])
def test_arms_by_angle_track_better_than_constant_arms(hand_name: str, seed: int) -> None:
    """The moment arms in the simulator vary by 30 % with the joint angle.

    A second controller, for comparison, uses the mean moment arms R. The second controller computes
    the tendon excursions as R q from the joint angles q.
    """
    hand = hand_with_varying_arms(hand_name, 0.3, with_joint_encoders=False)
    constant_hand = hand_with_varying_arms(hand_name, 0.0, with_joint_encoders=False)
    error_with_varying_moment_arms_deg = tracking_error_deg(
        HandModel.from_hand(hand, Gains(), RATE_HZ), hand, seed
    )
    error_with_mean_moment_arms_deg = tracking_error_deg(
        HandModel.from_hand(constant_hand, Gains(), RATE_HZ), hand, seed
    )
    assert error_with_varying_moment_arms_deg < 1.0
    assert error_with_mean_moment_arms_deg > 3.0 * error_with_varying_moment_arms_deg
