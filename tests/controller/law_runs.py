"""Run single ticks of the control law in tests. The module shows the law's state between ticks and its commands."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from handctl.compiled import kernel
from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.core import tick_stages
from handctl.core.block_schema import BlockArray, TablePlaces
from handctl.core.constants import constant_tables
from handctl.core.control_law import computed_torque, digit_reference
from handctl.core.control_law.digit_goal import DigitGoal
from handctl.core.control_law.goal_writer import write_goals
from handctl.core.control_law.required_tensions import allocate_bounded_tensions
from handctl.core.hand_model import HandModel
from handctl.core.state_block import state_tables
from handctl.safety.action import SafetyAction
from tests.controller.synthetic import (
    Estimate,
    active_state,
    constants,
    controller_of,
    state_with_estimate,
)


class LawState(NamedTuple):
    """State of the control law between two ticks. Each attribute has one value per tendon (N,).

    Attributes:
        setpoint: of the tension loop [N]. integral: integral part of the tension loop [N]. force: commanded motor
            force, without friction [N].
        planned: tension of a moving digit's tendon one period from now [N]. rate: planned change of the tension until
            then [N/s].
        trim: force that compensates a change of gains [N]. None after it has faded.
        held: limit of the tension while safety holds the hand [N]. None at other times.
        friction_state: how far the friction of each tendon is developed. NaN where that is not known, None before the
            first command.
    """

    setpoint: np.ndarray
    integral: np.ndarray
    force: np.ndarray
    planned: np.ndarray
    rate: np.ndarray
    trim: np.ndarray | None = None
    held: np.ndarray | None = None
    friction_state: np.ndarray | None = None

    @staticmethod
    def initial(n: int) -> "LawState":
        """Return the state of the control law of N tendons before its first command."""
        return LawState.idle(np.zeros(n))

    @staticmethod
    def idle(tension: np.ndarray) -> "LawState":
        """Return the state of the control law before its first command, with set-points at given tensions (N,) [N]."""
        return LawState(tension, *np.zeros((4, len(tension))))


class Command(NamedTuple):
    """Output of the control law: (N,) motor torque [N m] and tension goal [N], (J,) joint torque [N m] and goals."""

    torque: np.ndarray
    tension: np.ndarray
    joint_torque: np.ndarray
    q: np.ndarray
    dq: np.ndarray


def warm(model: HandModel, limit: np.ndarray) -> np.ndarray:
    """Return the temperatures (N,) [degC] at which drives are limited to tensions [N] between floor and ceiling."""
    limits = controller_of(model).limits
    fraction = (limit - model.floor) / (model.ceiling - model.floor)
    return limits.temperature_hard - fraction * (limits.temperature_hard - limits.temperature_soft)


def run_control_law(
    model: HandModel,
    state: ControllerState,
    goals: tuple[DigitGoal, ...],
    t: float,
    action: SafetyAction,
) -> None:
    """Run the control law of one tick on a controller's state, with given goals at time t [s]."""
    write_goals(model, state.layout, state.block, goals)
    state.decide(progress=replace(state.progress, goals=goals))
    state.goal_time = t
    controller_of(model)._compute_torques(state, action, 1)


def step(
    model: HandModel,
    law: LawState,
    estimate: Estimate,
    goals: tuple[DigitGoal, ...],
    t: float,
    most: np.ndarray | None = None,
    held: np.ndarray | None = None,
) -> tuple[LawState, Command]:
    """Run one tick of the control law for all digits of a hand.

    Args:
        model: the hand. law: state of the control law after the last tick. estimate: of the hand at t. goals: one per
            digit. t: time [s].
        most: (N,) limit of the tension by the temperature of each drive [N]. held: (N,) limit of the tension while
            safety holds the hand [N].
    """
    state = state_with_estimate(model, estimate)
    for name in ("setpoint", "integral", "force", "planned", "rate"):
        state.view(name)[...] = getattr(law, name)
    if law.trim is not None:
        state.view("trim")[...] = law.trim
        state.set_run_integer(s.TRIMMED, 1)
    if law.friction_state is not None:
        state.view("friction_state")[...] = law.friction_state
    if most is not None:
        state.view("temperature")[...] = warm(model, most)
    if held is not None:
        state.view("limit_held")[...] = held
        state.set_run_integer(s.HOLDING, 1)
    run_control_law(
        model, state, goals, t, SafetyAction.PASS if held is None else SafetyAction.HOLD
    )
    return law_state_of(state), command_of(state)


def law_state_of(state: ControllerState) -> LawState:
    """Return the state of the control law after a tick."""
    kept = {
        name: state.view(name).copy() for name in LawState._fields if name not in ("trim", "held")
    }
    trim = state.view("trim").copy() if state.run_integer(s.TRIMMED) else None
    held = state.view("limit_held").copy() if state.run_integer(s.HOLDING) else None
    return LawState(**kept, trim=trim, held=held)


def command_of(state: ControllerState) -> Command:
    """Return the commands that the control law has written into a controller's state."""
    names = ("torque", "tension_goal", "joint_torque", "q_goal", "dq_goal")
    return Command(*(state.view(name).copy() for name in names))


@kernel("block", "layout", "constants", "layout")
def _limit(block: BlockArray, at: TablePlaces, of: BlockArray, of_at: TablePlaces) -> np.ndarray:
    return computed_torque.present_tension_limits(
        state_tables(block, at), constant_tables(of, of_at)
    )


def limit_of(model: HandModel, state: ControllerState) -> np.ndarray:
    """Return the tension limits (N,) in a controller's state [N], infinite where there is none.

    The limits of the hand file come in addition.
    """
    return _limit(state.block, state.layout.places, *constants(model))


@kernel("block", "layout", "constants", "layout", "matrix")
def _required(
    block: BlockArray, at: TablePlaces, of: BlockArray, of_at: TablePlaces, way: np.ndarray
) -> int:
    x, c = state_tables(block, at), constant_tables(of, of_at)
    digit_reference.write_required_torque(x, c, way)
    return digit_reference.write_required_tensions(x, c)


def load_of(model: HandModel, goals: tuple[DigitGoal, ...], way: np.ndarray) -> np.ndarray:
    """Return the tensions (N,) [N] whose torques at the joints of the moving digits make a motion ``way`` (3, J)."""
    state = active_state(model)
    write_goals(model, state.layout, state.block, goals)
    undecided = _required(state.block, state.layout.places, *constants(model), way)
    allocate_bounded_tensions(
        model, state.layout, controller_of(model).constants, state.block, undecided, way
    )
    return state.view("load")


def way_of(model: HandModel, goals: tuple[DigitGoal, ...], t: float) -> np.ndarray:
    """Return the angle, rate and acceleration (3, J) of each joint on its trajectory at time t [s]."""
    state = active_state(model)
    run_control_law(model, state, goals, t, SafetyAction.PASS)
    return tick_stages.joint_motion(state.block, state.layout.places, *constants(model))
