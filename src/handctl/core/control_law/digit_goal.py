"""Goal of a digit, which a task, an operator or a program sets."""

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
    """Goal of a digit.

    Goals are compared by identity, so that values derived from a goal can be cached.

    Attributes:
        kind: type of control.
        trajectory: for MOTION, the trajectory in the digit's coordinates. For TENSION, the expected
            motion of the digit, which is fed forward without feedback.
        since: program time at which the trajectory starts [s].
        tension: for TENSION, (n_t,) target tensions at the load cells [N].
        rate: for TENSION, rate at which the setpoint approaches the target [N/s].
        force_limit: largest motor force that the goal allows [N].
    """

    kind: GoalKind = GoalKind.LIMP
    trajectory: Trajectory | StreamedTrajectory | None = None
    since: float = 0.0
    tension: Vector | None = None
    rate: float = 200.0
    force_limit: float = math.inf
