"""Tensions at the joints required by the goals: the compiled reference, and the decisions of Python."""

from handctl.core import stages
from handctl.core.hand_constants import HandConstants
from handctl.core.law.allocation import bounded
from handctl.core.model import HandModel
from handctl.core.schema import Block, Layout
from handctl.hand.dynamics import required_torque


def write_loads(model: HandModel, layout: Layout, constants: HandConstants, block: Block, action: int = 0) -> None:
    """Evaluate the goals and write the tensions of all moving tendons.

    Args:
        model: the hand.
        layout: of the block.
        constants: of the hand.
        block: the state, modified in place.
        action: demanded by safety, ``safety.action.Action``.
    """
    constants_in = constants.block, constants.layout.places
    undecided = stages.refer(block, layout.places, *constants_in, action)
    required = layout.view(block, "joint_required")
    if model.inverse is not required_torque:  # another law of the digits, for experiments
        way = stages.on_joints(block, layout.places, *constants_in)
        for digit in model.digits:
            required[digit.joints] = model.inverse(digit, *(row[digit.joints].tolist() for row in way))
        undecided = stages.load(block, layout.places, *constants_in)
    allocate(model, layout, block, undecided)


def allocate(model: HandModel, layout: Layout, block: Block, undecided: int) -> None:
    """Solve the bounded least-squares problem of digits with tensions out of bounds or not unique.

    Args:
        model: the hand.
        layout: of the block.
        block: the state, modified in place.
        undecided: a bit for each of these digits.
    """
    required = layout.view(block, "joint_required")
    load = layout.view(block, "load")
    for d, digit in enumerate(model.digits):
        if undecided >> d & 1:
            tendons = digit.tendons
            required_torque = required[digit.joints] @ digit.coupling
            low = model.floor[tendons]
            high = model.ceiling[tendons]
            load[tendons] = bounded(digit.reduced_moment_arms, required_torque, low, high, load[tendons])
