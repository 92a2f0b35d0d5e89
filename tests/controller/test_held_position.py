"""Test the joints that keep their angles in a hold while tension-controlled joints close the hand."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from handctl.core import state_block as s
from handctl.core.control_law.digit_reference import MOTION, STREAMED, TENSION
from handctl.core.control_law.held_position import (
    RESET_FACTOR,
    STATIC_GAIN,
    holds_position,
    is_hand_pulling,
    position_integral,
)
from handctl.core.gains.gains import packaged_gains
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.core.tick_types import HandMode
from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_from_content, load_hand
from handctl.programs.default_task import default_task
from handctl.programs.task_program import TaskProgram
from handctl.session.simulate import SimulatorSettings, homed_controller
from tests.conftest import NIGHTLY
from tests.controller.synthetic_states import (
    active_state,
    constant_tables_of,
    controller_of,
    uncompiled_function,
)
from tests.hand.hand_on_wrist import mount_on_wrist

RATE_HZ = 400.0
SIMULATOR_SEEDS = range(10) if NIGHTLY else range(2)
ABDUCTION_ARM_M = 0.002
"""Distance at which the flexors of a finger pass the axis of its abduction [m]."""
LOADED_AFTER_S = 1.5
"""Time after the start of a hold at which the tensions are at their targets [s]."""


def orca_with_passing_flexors() -> Hand:
    """Return ``orca_like`` with fingers whose flexors also turn the abduction joint."""
    content: dict[str, Any] = json.loads(json.dumps(load_hand("orca_like").content))
    for tendon in content["tendon"]:
        digit, _, name = tendon["name"].rpartition("_")
        if name in ("mcp", "pip") and digit != "thumb":
            tendon["moment_arm_m"][f"{digit}_j1"] = ABDUCTION_ARM_M
    return hand_from_content(content | {"name": "orca_passing"}, "orca_passing")


TESTED_HANDS: dict[str, tuple[Callable[[], Hand], float]] = {
    "orca_like": (lambda: load_hand("orca_like"), 2.0),
    "orca_passing": (orca_with_passing_flexors, 2.0),
    "jamia_wrist": (lambda: mount_on_wrist("jamia"), 0.5),
    "n_plus_1_wrist": (lambda: mount_on_wrist("n_plus_1"), 0.5),
}
"""Hand, and limit of the largest error of a joint that keeps its angle [deg].

Regression: without an integral of the position error, these joints gave way under the contact.
"""


def errors_in_hold(hand: Hand, seed: int) -> dict[str, float]:
    """Return true less commanded angle at the end of a hold [deg], for the joints that keep their angles."""
    gains = packaged_gains("orca_like" if hand.name.startswith("orca") else hand.name)
    model = HandModel.from_hand(hand, gains, RATE_HZ)
    task, _ = default_task(hand)
    ends = next(i for i, phase in enumerate(task.phase) if phase.kind == "hold") + 1
    hold = task.phase[ends - 1].model_copy(update={"duration_s": LOADED_AFTER_S})
    task = task.model_copy(update={"phase": (*task.phase[: ends - 1], hold)})
    controller = homed_controller(model, TaskProgram(task), hand)
    last = np.full(len(hand.joints), np.nan)
    keeps = np.zeros(len(hand.joints), dtype=bool)
    with SimulatorSettings(hand, "cylinder", seed, homed=True).begin_run(controller) as run:
        run.record_ticks = False
        for _, out in run.run_ticks(20.0):
            assert not [event for event in out.events if event.level == "error"]
            if run.state.mode == HandMode.ACTIVE and run.state.progress.phase == "hold":
                last = run.state.view("q_goal") - run.simulated_hand.world.plant.engine.q
                kept = controller.constants.layout.view(
                    controller.constants.block, "keeps_position"
                )
                keeps = (np.abs(hand.own_arms[kept != 0]) > 0.0).any(axis=0)
    names = zip(hand.joints, np.degrees(last), keeps & ~np.isnan(last), strict=True)
    return {joint: float(error) for joint, error, kept in names if kept}


@pytest.mark.parametrize("seed", SIMULATOR_SEEDS)
@pytest.mark.parametrize("name", TESTED_HANDS)
def test_joints_that_do_not_close_keep_their_angles_in_a_hold(name: str, seed: int) -> None:
    make, limit_deg = TESTED_HANDS[name]
    errors = errors_in_hold(make(), seed)
    assert errors
    worst = max(errors, key=lambda joint: abs(errors[joint]))
    assert abs(errors[worst]) < limit_deg, errors


# --- the law of one tendon ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def model() -> HandModel:
    return HandModel.from_hand(load_hand("orca_like"), packaged_gains("orca_like"), RATE_HZ)


def integral_after(model: HandModel, ticks: int, holds: bool, start_N: float = 0.0) -> float:
    """Return the integral of the first tendon [N] after some ticks with a position force of 1 N."""
    state = active_state(model)
    x = uncompiled_function(state_tables)(state.block, state.layout.places)
    c = constant_tables_of(model)
    x.tendon[s.TENSION_INTEGRAL, 0] = start_N
    for _ in range(ticks):
        x.tendon[s.TENSION_INTEGRAL, 0] = uncompiled_function(position_integral)(
            x, c, 0, holds, 1e-4, 1e4
        )
    return float(x.tendon[s.TENSION_INTEGRAL, 0])


def test_the_integral_adds_the_static_gain_and_rises_within_its_reset_time(
    model: HandModel,
) -> None:
    assert integral_after(model, 20_000, True) == pytest.approx(STATIC_GAIN, rel=1e-3)
    controller = controller_of(model)
    damping = controller.constants.layout.view(controller.constants.block, "speed_gain")[0]
    ticks = round(RATE_HZ * RESET_FACTOR / damping)
    assert integral_after(model, ticks, True) == pytest.approx(1.0, rel=0.1)


def test_the_integral_fades_after_a_hold(model: HandModel) -> None:
    faded = integral_after(model, round(0.2 * RATE_HZ), False, start_N=10.0)
    assert faded == pytest.approx(10.0 / np.e, rel=0.02)
    assert integral_after(model, round(4.0 * RATE_HZ), False, start_N=10.0) == 0.0


def test_only_kept_joints_hold_and_only_while_the_hand_pulls(model: HandModel) -> None:
    state = active_state(model)
    x = uncompiled_function(state_tables)(state.block, state.layout.places)
    c = constant_tables_of(model)
    pulls, holds = uncompiled_function(is_hand_pulling), uncompiled_function(holds_position)
    kinds = x.tendon_int[s.GOAL_KIND]
    kinds[:] = MOTION
    assert not pulls(x)
    names = model.hand.tendon_names
    kinds[names.index("index_mcp")] = TENSION
    assert pulls(x)
    kept = {name for n, name in enumerate(names) if holds(x, c, n, True)}
    sideways = {f"{digit}_abd" for digit in ("index", "middle", "ring", "pinky", "thumb")}
    assert kept == {"wrist_flex"} | sideways
    x.digit_int[s.TRAJECTORY_KIND, :] = STREAMED
    assert not any(holds(x, c, n, True) for n in range(len(names)))
    state.mode = HandMode.RELAX
    assert not pulls(x)
