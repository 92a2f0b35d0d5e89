"""Goal of a digit: the motion or tension that a task, an operator or a program requests."""

import enum
import math
from dataclasses import dataclass

from handctl.core.control_law.trajectory import StreamedTrajectory, Trajectory
from handctl.core.tick_types import Vector


class GoalKind(enum.IntEnum):
    """Kind of control of a digit, for example motion or tension."""

    LIMP = 0
    """The drives are enabled and make no torque."""
    MOTION = 1
    """The digit moves along a trajectory, by computed torque."""
    TENSION = 2
    """Each tendon has a tension goal."""


@dataclass(frozen=True, slots=True, eq=False)
class DigitGoal:
    """Goal of a digit: the requested motion or tension, and the largest force.

    Goals are compared by identity, so that values derived from a goal can be cached. Two goal
    objects with equal values count as different goals.

    Attributes:
        kind: kind of control.
        trajectory: trajectory of the digit's coordinates, for a goal of the kind MOTION. For a goal
            of the kind TENSION, the trajectory is the expected motion, which the control law feeds
            forward but does not correct.
        since: program time at which the trajectory starts [s].
        tension: (n_t,) target tensions at the load cells, for a goal of the kind TENSION [N].
        rate: rate at which the tension setpoint approaches the target, for a goal of the kind
            TENSION [N/s].
        force_limit: largest motor force that the goal allows [N].
    """

    kind: GoalKind = GoalKind.LIMP
    trajectory: Trajectory | StreamedTrajectory | None = None
    since: float = 0.0
    tension: Vector | None = None
    rate: float = 200.0
    force_limit: float = math.inf
