"""Transfer of the goals of all digits into the state block.

The goals must be transferred again only after a goal of a digit has changed.
"""

import functools

import numpy as np

from handctl.core import state_block as s
from handctl.core.block_schema import BlockArray, BlockLayout
from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.digit_reference import MINIMUM_JERK, NO_TRAJECTORY, SAMPLED, STREAMED
from handctl.core.control_law.trajectory import MinimumJerk, StreamedTrajectory, Trajectory
from handctl.core.hand_model import HandModel


def write_goals(
    model: HandModel, layout: BlockLayout, block: BlockArray, goals: tuple[DigitGoal, ...]
) -> None:
    """Write the goals of all digits into the state block.

    Args:
        model: model of the hand.
        layout: layout of the state block.
        block: state block, modified in place.
        goals: goal of each digit.
    """
    tendon = layout.table(block, "tendon")
    digit = layout.table(block, "digit")
    kinds = layout.table(block, "tendon_int")[s.GOAL_KIND]
    trajectory_kinds = layout.table(block, "digit_int")[s.TRAJECTORY_KIND]
    coordinate = layout.table(block, "coordinate")
    for d, (goal, tendons, coordinate_slice) in enumerate(
        zip(goals, model.digit_tendons, model.digit_coordinates, strict=True)
    ):
        kinds[tendons] = int(_goal_kind_of(goal))
        if goal.kind == GoalKind.TENSION and goal.trajectory is not None:
            # While the other tendons of a digit pull, a spool pair that moves the digit sideways
            # holds its position.
            kinds[tendons][model.redundancy.closing_sign[tendons] == 0.0] = int(GoalKind.MOTION)
        if goal.kind == GoalKind.TENSION and goal.tension is not None:
            tendon[s.TENSION_TARGET, tendons] = np.clip(
                goal.tension, np.minimum(model.floor[tendons], 0.0), model.ceiling[tendons]
            )
            tendon[s.TENSION_SETPOINT_STEP, tendons] = goal.rate * model.period
            tendon[s.FORCE_LIMIT, tendons] = goal.force_limit
        trajectory_kinds[d] = NO_TRAJECTORY if goal.trajectory is None else SAMPLED
        if isinstance(goal.trajectory, StreamedTrajectory):
            trajectory_kinds[d] = STREAMED
        if isinstance(goal.trajectory, MinimumJerk):
            trajectory_kinds[d] = MINIMUM_JERK
            coordinate[s.TRAJECTORY_START, coordinate_slice] = goal.trajectory.start
            coordinate[s.TRAJECTORY_END, coordinate_slice] = goal.trajectory.end
            digit[s.TRAJECTORY_START_TIME, d] = goal.since
            digit[s.TRAJECTORY_DURATION, d] = goal.trajectory.duration
            blend = goal.trajectory.blend
            digit[s.TRAJECTORY_BLEND_TIME, d] = blend.duration if blend else 1.0
            coordinate[s.TRAJECTORY_START_SPEED, coordinate_slice] = blend.speed if blend else 0.0
            coordinate[s.TRAJECTORY_START_ACCELERATION, coordinate_slice] = (
                blend.acceleration if blend else 0.0
            )


def _goal_kind_of(goal: DigitGoal) -> GoalKind:
    """Return the kind of control of a goal.

    If the kind requires a trajectory or a tension that the goal does not have, the result is LIMP.
    """
    if (goal.kind == GoalKind.MOTION and goal.trajectory is None) or (
        goal.kind == GoalKind.TENSION and goal.tension is None
    ):
        return GoalKind.LIMP
    return goal.kind


def sample_trajectories(
    model: HandModel, layout: BlockLayout, block: BlockArray, goals: tuple[DigitGoal, ...], t: float
) -> None:
    """Write the motion at time t [s] for trajectories that compiled code cannot evaluate."""
    for trajectory, start_time, coordinate_slice in trajectories_evaluated_by_python(model, goals):
        layout.table(block, "coordinate")[s.TRAJECTORY : s.TRAJECTORY + 3, coordinate_slice] = (
            trajectory.motion_at(t - start_time)
        )


@functools.lru_cache(maxsize=16)
def trajectories_evaluated_by_python(
    model: HandModel, goals: tuple[DigitGoal, ...]
) -> tuple[tuple[Trajectory, float, slice], ...]:
    """Return the trajectories that Python code must evaluate, each with start time [s] and coordinates."""
    goals_and_coordinates = zip(goals, model.digit_coordinates, strict=True)
    return tuple(
        (goal.trajectory, goal.since, coordinate_slice)
        for goal, coordinate_slice in goals_and_coordinates
        if goal.trajectory is not None
        and not isinstance(goal.trajectory, MinimumJerk | StreamedTrajectory)
    )
