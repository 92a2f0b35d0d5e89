"""Tensions that the goals of the digits require.

The required tensions are the tensions at the joints, after the friction of the pulleys. Compiled
code computes the required tensions of most digits. If the joint torques of a digit do not determine
its tensions, or if these tensions exceed their bounds, Python code solves a bounded least-squares
problem.
"""

from dataclasses import replace

import numpy as np

from handctl.core import tick_stages
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.control_law.tension_allocation import solve_bounded_tensions
from handctl.core.control_law.tension_allocation import tensions_for_torque as allocate_tension
from handctl.core.hand_constants import HandConstants
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import Vector
from handctl.hand.dynamics import DigitModel, required_torque
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED_M_S


def evaluate_goals(
    model: HandModel,
    layout: BlockLayout,
    constants: HandConstants,
    block: BlockArray,
    action: int = 0,
) -> int:
    """Evaluate the goals of all digits, see ``tick_stages.evaluate_goals``.

    Args:
        model: model of the hand.
        layout: layout of the state block.
        constants: constants of the hand.
        block: state block, modified in place.
        action: reaction of the safety monitor, as a value of ``safety.safety_action.SafetyAction``.

    Returns:
        An integer with one bit for each digit. The bit of a digit is 1 if the bounded least-squares
        problem of the digit must still be solved.
    """
    if model.inverse_dynamics is required_torque:
        return tick_stages.evaluate_goals(
            block, layout.offsets, constants.block, constants.layout.offsets, action
        )
    return _evaluate_goals_of_experiment(model, layout, constants, block, action)


def write_motor_torques(
    model: HandModel,
    layout: BlockLayout,
    constants: HandConstants,
    block: BlockArray,
    unsolved_digits: int,
    relax_rate: float = 0.0,
    open_loop: int = 0,
    ticks: int = 1,
) -> None:
    """Write the required tensions of the unsolved digits, and the motor torques of all digits.

    Args:
        model: model of the hand.
        layout: layout of the state block.
        constants: constants of the hand.
        block: state block after the evaluation of the goals, modified in place.
        unsolved_digits: result of ``evaluate_goals``.
        relax_rate: see ``tick_stages.compute_motor_torques``.
        open_loop: see ``tick_stages.compute_motor_torques``.
        ticks: see ``tick_stages.compute_motor_torques``.
    """
    kernel_args = block, layout.offsets, constants.block, constants.layout.offsets
    if unsolved_digits:
        trajectory = tick_stages.joint_motion(*kernel_args)
        allocate_bounded_tensions(model, layout, constants, block, unsolved_digits, trajectory)
    tick_stages.compute_motor_torques(*kernel_args, relax_rate, open_loop, ticks)


def _evaluate_goals_of_experiment(
    model: HandModel, layout: BlockLayout, constants: HandConstants, block: BlockArray, action: int
) -> int:
    """Evaluate the goals like ``tick_stages.evaluate_goals``, but with the inverse dynamics of an experiment."""
    kernel_args = block, layout.offsets, constants.block, constants.layout.offsets
    tick_stages.evaluate_goals(*kernel_args, action)
    required = layout.view(block, "joint_required")
    trajectory = tick_stages.joint_motion(*kernel_args)
    for digit in model.digits:
        required[digit.joints] = model.inverse_dynamics(
            digit, *(row[digit.joints].tolist() for row in trajectory)
        )
    return tick_stages.write_loads(*kernel_args)


def allocate_bounded_tensions(
    model: HandModel,
    layout: BlockLayout,
    constants: HandConstants,
    block: BlockArray,
    unsolved_digits: int,
    trajectory: Vector,
) -> None:
    """Solve the least-squares problem of each digit that compiled code has marked as unsolved.

    Args:
        model: model of the hand.
        layout: layout of the state block.
        constants: constants of the hand, with the moment arms at the present joint angles.
        block: state block, modified in place.
        unsolved_digits: an integer with one bit for each digit. The bit of a digit is 1 if its
            least-squares problem must be solved.
        trajectory: (3, J) angles, rates and accelerations of the joints on their trajectories.
    """
    required = layout.view(block, "joint_required")
    load = layout.view(block, "load")
    for d, digit in enumerate(model.digits):
        if unsolved_digits >> d & 1:
            tendons = digit.tendons
            if digit.has_varying_arm:
                digit = _with_present_moment_arms(digit, constants)
            if model.redundancy.has_surplus[tendons.start]:
                load[tendons] = _tensions_with_friction(
                    model, digit, required[digit.joints], trajectory[:2, digit.joints]
                )
                continue
            required_torque = required[digit.joints] @ digit.coupling
            low = model.floor[tendons]
            high = model.ceiling[tendons]
            load[tendons] = solve_bounded_tensions(
                digit.reduced_moment_arms, required_torque, low, high, load[tendons]
            )


def _with_present_moment_arms(digit: DigitModel, constants: HandConstants) -> DigitModel:
    """Return a copy of a digit's model with the moment arms at the present joint angles."""
    arms = constants.layout.view(constants.block, "moment_arms")[digit.tendons, digit.joints]
    return replace(digit, moment_arms=arms, reduced_moment_arms=arms @ digit.coupling)


def _tensions_with_friction(
    model: HandModel, digit: DigitModel, required: Vector, trajectory: Vector
) -> Vector:
    """Return the tensions (n_t,) at the joints of a digit that has antagonistic tendons and friction [N].

    Each pulley of a tendon has its own friction. In a digit without springs, the torques of all
    tendons must be in balance at each joint. The moment arms of the least-squares problem therefore
    include the friction of each pulley.

    Args:
        model: model of the hand.
        digit: model of the digit.
        required: (n,) joint torques [N m].
        trajectory: (2, n) angles [rad] and rates [rad/s] of the joints on the trajectory.
    """
    tendons = digit.tendons
    arms = digit.moment_arms
    friction_share = model.gains.motion.friction_share
    winding_directions = np.tanh(arms @ trajectory[1] / CAPSTAN_FRICTION_SPEED_M_S)
    has_pulley = (arms != 0.0) & ~digit.is_prismatic
    friction_loss = digit.friction[:, None] * (
        digit.wrap[:, None] + np.cumsum(has_pulley * trajectory[0], axis=1)
    )
    factors = (
        1.0 - friction_share + friction_share * np.exp(-friction_loss * winding_directions[:, None])
    )
    low = model.floor[tendons]
    high = model.ceiling[tendons]
    reduced_arms = (arms * factors) @ digit.coupling
    tension, _ = allocate_tension(reduced_arms, required @ digit.coupling, low, high)
    # The control law later divides the tensions by the mean efficiency over the pulleys, so the
    # tensions are multiplied by the mean efficiency here.
    weights = model.pulley_weights[tendons, digit.joints]
    if digit.has_varying_arm:
        weights = np.abs(arms) / np.abs(arms).sum(axis=1, keepdims=True)
    efficiency = (weights * np.exp(-friction_loss)).sum(axis=1)
    return np.asarray(
        tension * (1.0 - friction_share + friction_share * efficiency**winding_directions)
    )
