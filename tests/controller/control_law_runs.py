"""Run single ticks of the control law in tests.

Further functions of this module read the state of the control law, or its commands, from the state
of a controller.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from handctl.compiled import kernel
from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.block_schema import BlockArray, TableOffsets
from handctl.core.constants import constant_tables
from handctl.core.control_law import computed_torque, digit_reference
from handctl.core.control_law.digit_goal import DigitGoal
from handctl.core.control_law.goal_writer import write_goals
from handctl.core.control_law.required_tensions import allocate_bounded_tensions
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.safety.safety_action import SafetyAction
from tests.controller.synthetic_states import (
    SyntheticEstimate,
    active_state,
    constant_args_of,
    controller_of,
    state_with_estimate,
)


class ControlLawState(NamedTuple):
    """State of the control law between two ticks. Each attribute is an array (tendons,).

    Attributes:
        setpoint: setpoint of the tension loop [N].
        integral: integral part of the tension loop [N].
        force: commanded motor force, without friction [N].
        planned: tension that is planned for the next tick, for tendons of moving digits [N].
        rate: planned rate of change of the tension until the next tick [N/s].
        trim: force that compensates the step of the command at a change of gains [N]. The value is
            None after the force has decayed.
        held: tension limit while the safety monitor holds the hand [N]. None at other times.
        friction_state: friction of each tendon as a fraction of its full friction, from 1 (winding
            up) to -1 (paying out). NaN if the fraction is unknown, and None before the first
            command.
        friction_slider: travel at which the friction element of each tendon has no tension [m]. NaN
            if this travel is unknown, and None before the first command.
    """

    setpoint: np.ndarray
    integral: np.ndarray
    force: np.ndarray
    planned: np.ndarray
    rate: np.ndarray
    trim: np.ndarray | None = None
    held: np.ndarray | None = None
    friction_state: np.ndarray | None = None
    friction_slider: np.ndarray | None = None

    @staticmethod
    def initial_state(n: int) -> "ControlLawState":
        """Return the state that the control law of ``n`` tendons has before the first command."""
        return ControlLawState.initial_state_at_tensions(np.zeros(n))

    @staticmethod
    def initial_state_at_tensions(tension: np.ndarray) -> "ControlLawState":
        """Return the state that the control law has before the first command.

        The array ``tension`` (tendons,) contains the setpoint of each tendon [N].
        """
        return ControlLawState(tension, *np.zeros((4, len(tension))))


class ControlLawCommand(NamedTuple):
    """Output of the control law.

    The arrays ``torque`` and ``tension`` contain the motor torque [N m] and the tension goal [N] of
    each tendon. The other arrays contain the torque [N m], the angle goal [rad] and the rate goal
    [rad/s] of each joint.
    """

    torque: np.ndarray
    tension: np.ndarray
    joint_torque: np.ndarray
    q: np.ndarray
    dq: np.ndarray


def temperatures_for_limits(model: HandModel, tension_limit: np.ndarray) -> np.ndarray:
    """Return the temperature of each drive [degC] at which the tension limits are ``tension_limit`` [N].

    Each tension limit must be between the lowest and the highest tension that the hand allows.
    """
    limits = controller_of(model).derived_constants.limits
    fraction = (tension_limit - model.floor) / (model.ceiling - model.floor)
    return limits.temperature_hard - fraction * (limits.temperature_hard - limits.temperature_soft)


def run_control_law(
    model: HandModel,
    state: ControllerState,
    goals: tuple[DigitGoal, ...],
    t: float,
    action: SafetyAction,
) -> None:
    """Run the control law for one tick on a controller's state.

    The goals are evaluated at time t [s].
    """
    write_goals(model, state.layout, state.block, goals)
    state.decide(progress=replace(state.progress, goals=goals))
    state.goal_time = t
    controller_of(model)._compute_torques(state, action, 1)


def run_control_law_tick(
    model: HandModel,
    law: ControlLawState,
    estimate: SyntheticEstimate,
    goals: tuple[DigitGoal, ...],
    t: float,
    temperature_limit_N: np.ndarray | None = None,
    held_limit_N: np.ndarray | None = None,
) -> tuple[ControlLawState, ControlLawCommand]:
    """Run one tick of the control law for all digits of a hand.

    Args:
        model: model of the hand.
        law: state of the control law after the last tick.
        estimate: estimate of the hand at time t.
        goals: one goal for each digit.
        t: time [s].
        temperature_limit_N: (tendons,) tension limit that the temperature of each drive causes [N].
        held_limit_N: (tendons,) tension limit while the safety monitor holds the hand [N].
    """
    state = state_with_estimate(model, estimate)
    for name in ("setpoint", "integral", "force", "planned", "rate"):
        state.view(name)[...] = getattr(law, name)
    if law.trim is not None:
        state.view("trim")[...] = law.trim
        state.run_integers[s.TRIM_ACTIVE] = 1
    if law.friction_state is not None:
        state.view("friction_state")[...] = law.friction_state
    if law.friction_slider is not None:
        state.view("friction_slider")[...] = law.friction_slider
    if temperature_limit_N is not None:
        state.view("temperature")[...] = temperatures_for_limits(model, temperature_limit_N)
    if held_limit_N is not None:
        state.view("limit_held")[...] = held_limit_N
        state.run_integers[s.SAFETY_HOLD_ACTIVE] = 1
    run_control_law(
        model, state, goals, t, SafetyAction.PASS if held_limit_N is None else SafetyAction.HOLD
    )
    return control_law_state_of(state), control_law_command_of(state)


def control_law_state_of(state: ControllerState) -> ControlLawState:
    """Extract the state of the control law from a controller's state after a tick."""
    block_values = {
        name: state.view(name).copy()
        for name in ControlLawState._fields
        if name not in ("trim", "held")
    }
    trim = state.view("trim").copy() if state.run_integers[s.TRIM_ACTIVE] else None
    held_limits = (
        state.view("limit_held").copy() if state.run_integers[s.SAFETY_HOLD_ACTIVE] else None
    )
    return ControlLawState(**block_values, trim=trim, held=held_limits)


def control_law_command_of(state: ControllerState) -> ControlLawCommand:
    """Return the commands that the control law has written into a controller's state."""
    names = ("torque", "tension_goal", "joint_torque", "q_goal", "dq_goal")
    return ControlLawCommand(*(state.view(name).copy() for name in names))


@kernel("block", "layout", "constants", "layout")
def _tension_limits(
    block: BlockArray,
    state_offsets: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
) -> np.ndarray:
    return computed_torque.temporary_tension_limits(
        state_tables(block, state_offsets), constant_tables(constants, constant_offsets)
    )


def tension_limits_of(model: HandModel, state: ControllerState) -> np.ndarray:
    """Return the tension limit of each tendon [N] that a controller's state contains.

    For a tendon without a tension limit, the returned value is infinity. The tension limits of the
    hand file are not a part of the returned limits.
    """
    return _tension_limits(state.block, state.layout.offsets, *constant_args_of(model))


@kernel("block", "layout", "constants", "layout", "matrix")
def _required_tensions(
    block: BlockArray,
    state_offsets: TableOffsets,
    constants: BlockArray,
    constant_offsets: TableOffsets,
    motion: np.ndarray,
) -> int:
    x, c = state_tables(block, state_offsets), constant_tables(constants, constant_offsets)
    digit_reference.write_required_torque(x, c, motion)
    return digit_reference.write_required_tensions(x, c)


def required_tensions_of(
    model: HandModel, goals: tuple[DigitGoal, ...], motion: np.ndarray
) -> np.ndarray:
    """Return the tension [N] that each tendon of the moving digits needs for a motion.

    The rows of ``motion`` (3, joints) are the angle, the rate and the acceleration of each joint.
    """
    state = active_state(model)
    write_goals(model, state.layout, state.block, goals)
    unsolved_digits = _required_tensions(
        state.block, state.layout.offsets, *constant_args_of(model), motion
    )
    allocate_bounded_tensions(
        model,
        state.layout,
        controller_of(model).derived_constants.constants,
        state.block,
        unsolved_digits,
        motion,
    )
    return state.view("load")


def joint_motion_at(model: HandModel, goals: tuple[DigitGoal, ...], t: float) -> np.ndarray:
    """Return the angle, rate and acceleration of each joint on its trajectory at time t [s].

    The result is an array (3, joints).
    """
    state = active_state(model)
    run_control_law(model, state, goals, t, SafetyAction.PASS)
    return tick_stages.joint_motion(state.block, state.layout.offsets, *constant_args_of(model))
