"""Goal of a digit at an instant, from a task, an operator or a program."""

import enum
import math
from dataclasses import dataclass

from handctl.core.law.trajectory import Streamed, Trajectory
from handctl.core.types import Vector


class Kind(enum.IntEnum):
    """Type of control of a digit."""

    LIMP = 0
    """Enabled, without torque."""
    MOTION = 1
    """Along a trajectory, by computed torque."""
    TENSION = 2
    """Each tendon at a tension."""


@dataclass(frozen=True, slots=True, eq=False)
class DigitGoal:
    """Goal of a digit. Goals are compared by identity, so derived values can be cached.

    Attributes:
        kind: type of control.
        trajectory: for MOTION, in the digit's coordinates. For TENSION, the expected motion: fed
            forward, without feedback on deviations.
        since: start of the trajectory [s on the run's clock].
        tension: for TENSION, (n_t,) target at the load cells [N].
        rate: for TENSION, rate of approaching the target [N/s].
        force_limit: largest motor force at the tendon for the goal [N].
    """

    kind: Kind = Kind.LIMP
    trajectory: Trajectory | Streamed | None = None
    since: float = 0.0
    tension: Vector | None = None
    rate: float = 200.0
    force_limit: float = math.inf
