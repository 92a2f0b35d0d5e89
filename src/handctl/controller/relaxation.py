"""Relaxing of the hand.

While the hand relaxes, every tension falls to the tension floor, and no motor command increases.
The tension loop itself can be the cause of the fault, for example with crossed feedback, late motor
replies or a wrong encoder. An upper bound, called the envelope, limits the motor force of each
tendon. No measurement can raise the envelope:

    e[k] = max(min(u[k-1], floor), u[k-1] - rate T)      0 <= u[k] <= e[k]

Here, u is the commanded motor force at the tendon [N], and T is the control period. For a spool
pair, u is the absolute value of the motor force, and the sign of the motor force does not change.

The envelope begins at the last motor command, but not above a limit. The limit is the present
tension plus ``MAX_SETPOINT_EXCESS_N`` plus the friction of the motor. Some tendons are controlled
by the tension loop, and have a load cell that could be wrong. For such a tendon, the limit is at
least the setpoint plus the friction of the motor. The tension loop cannot command more force than
the envelope. After a fault of the tension loop (``RelaxMethod.OPEN_LOOP``), the command u[k] equals
the envelope e[k]. If a motor brakes when relaxing begins, its command goes to zero.
"""

from dataclasses import replace

import numpy as np

from handctl.controller.controller_state import ControllerState
from handctl.core import state_block as s
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import Vector
from handctl.safety.faults.table import FAULT_BY_ID
from handctl.safety.safety_action import RelaxMethod

RELAX_RATE_N_PER_S = 500.0
OVER_TENSION_RATE_N_PER_S = 2000.0
MAX_START_FORCE_EXCESS_N = 15.0
"""Largest allowed excess of the first relaxing setpoint over the last commanded force [N].

Friction and motion can make the tension larger than the commanded force.
"""

RELAXED_TOLERANCE_N = 3.0
"""Distance above the tension of a relaxed tendon within which a tendon counts as relaxed [N]."""
MAX_SETPOINT_EXCESS_N = 3.0
"""Largest margin of the first setpoint of relaxing above the present tension [N].

During a steady hold, the margin of a setpoint above the tension is at most 2 N.
"""


def start_relaxation(model: HandModel, state: ControllerState) -> None:
    """Begin to relax the hand: set the tension setpoints, their rates, and the upper limits of the motor forces.

    Relaxing begins at the present tension. The setpoint of a held digit can be above the present
    tension. If relaxing began at the setpoint, the motor would continue to pull. Because the load
    cell can be wrong, the last commanded force also limits the first setpoint.
    """
    table = state.tendon
    tendon_integers = state.tendon_int
    in_tension_loop = np.array(
        [state.progress.goals[d].kind == GoalKind.TENSION for d in model.digit_of_tendon]
    )
    # A spool pair can pull in either direction, so all values are given in the direction of the
    # last command.
    sign = np.where(model.is_pair & (table[s.COMMANDED_FORCE] < 0.0), -1.0, 1.0)
    present_tensions = (
        np.maximum(sign * table[s.TENSION], model.relaxed_tensions) + MAX_SETPOINT_EXCESS_N
    )
    setpoint = sign * table[s.TENSION_SETPOINT]
    # A digit that follows a position goal has no tension setpoint.
    setpoint = np.where(in_tension_loop, np.minimum(setpoint, present_tensions), setpoint)
    start = np.minimum(
        setpoint, np.maximum(sign * table[s.FILTER_INPUT_FORCE], 0.0) + MAX_START_FORCE_EXCESS_N
    )
    goals = tuple(
        DigitGoal(
            GoalKind.TENSION,
            tension=_relaxed_goal(model, start)[tendons],
            rate=present_relax_rate(state),
        )
        for tendons in model.digit_tendons
    )
    state.decide(progress=replace(state.progress, goals=goals))
    table[s.TENSION_SETPOINT] = sign * start
    # COMMANDED_FORCE is the commanded motor force. The envelope starts from the commanded motor
    # force in the next tick.
    plausible_tension = present_tensions
    if any(
        FAULT_BY_ID[latched_fault.id].makes_tension_unreliable
        for latched_fault in state.latched_faults
    ):
        # If the load cell could be wrong, the true tension can be as large as the tension setpoint.
        # A digit that follows a position goal has no tension setpoint.
        plausible_tension = np.where(
            in_tension_loop, np.maximum(present_tensions, start), present_tensions
        )
    table[s.COMMANDED_FORCE] = _envelope_start(model, state, sign, plausible_tension)
    tendon_integers[s.GOAL_KIND] = int(GoalKind.TENSION)


def _relaxed_goal(model: HandModel, start_tensions: Vector) -> Vector:
    """Return the tension [N] that relaxing should reach in each tendon, shape (N,).

    The goals are the tensions of a relaxed hand, limited to the setpoints (N,) at the start of
    relaxing.
    """
    return np.where(model.is_pair, 0.0, np.minimum(start_tensions, model.relaxed_tensions))


def _envelope_start(
    model: HandModel, state: ControllerState, sign: Vector, plausible_tension: Vector
) -> Vector:
    """Return the motor force [N] at which the envelope of each tendon starts, shape (N,).

    Usually, the envelope starts at the last commanded force. If the last commanded force is much
    larger than the present tension, the envelope starts at the present tension plus the friction of
    the motor. For example, an unstable control loop can command 100 N for a tendon whose tension is
    10 N.

    Args:
        model: model of the hand.
        state: state when relaxing starts.
        sign: (N,) direction of the commanded force.
        plausible_tension: (N,) largest tension in the direction ``sign`` that agrees with the
            measurement or the setpoint [N].
    """
    commanded_force = np.nan_to_num(state.tendon[s.COMMANDED_FORCE], nan=0.0)
    return sign * np.minimum(
        sign * commanded_force, plausible_tension + model.tendon_constants.coulomb_friction
    )


def are_commands_relaxed(model: HandModel, state: ControllerState) -> bool:
    """Return True if each commanded force is at most slightly above the tension of a relaxed tendon."""
    return not np.any(
        _force_magnitudes(model, state.tendon[s.COMMANDED_FORCE])
        > model.relaxed_tensions + RELAXED_TOLERANCE_N
    )


def are_tensions_relaxed(model: HandModel, state: ControllerState) -> bool:
    """Return True if each tension is at most slightly above the tension of a relaxed tendon."""
    return bool(
        np.all(
            _force_magnitudes(model, state.tendon[s.TENSION])
            < model.relaxed_tensions + RELAXED_TOLERANCE_N
        )
    )


def _force_magnitudes(model: HandModel, forces: Vector) -> Vector:
    """Return the absolute values of forces or tensions [N], shape (N,).

    Only a spool pair can have a negative force.
    """
    return np.where(model.is_pair, np.abs(forces), forces)


def update_relax_rate(state: ControllerState) -> None:
    """Switch to the faster relaxing rate as soon as a tendon is overloaded."""
    rate = present_relax_rate(state)
    if state.progress.goals[0].rate != rate:
        goals = tuple([replace(goal, rate=rate) for goal in state.progress.goals])
        state.decide(progress=replace(state.progress, goals=goals))


def present_relax_rate(state: ControllerState) -> float:
    """Return the rate at which the envelope of the motor forces falls [N/s]."""
    return (
        OVER_TENSION_RATE_N_PER_S
        if RelaxMethod.FAST_TENSION_LOOP in _relax_methods(state)
        else RELAX_RATE_N_PER_S
    )


def is_open_loop(state: ControllerState) -> bool:
    """Return True if the command of each motor is the envelope itself.

    The envelope is an upper limit of the motor force that falls with time. If the command equals
    this limit, measurements from later ticks do not change the command.
    """
    return RelaxMethod.OPEN_LOOP in _relax_methods(state)


def _relax_methods(state: ControllerState) -> set[RelaxMethod]:
    """Return the methods of relaxing that the latched faults require."""
    return {FAULT_BY_ID[latched_fault.id].relax_method for latched_fault in state.latched_faults}
