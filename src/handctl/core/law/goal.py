"""What each digit is asked to do at this instant, whoever asks: a task, a person or a program."""

import enum
import math
from dataclasses import dataclass

from handctl.core.law.trajectory import Trajectory
from handctl.core.types import Vector


class Kind(enum.IntEnum):
    """How a digit is driven."""

    LIMP = 0
    """Enabled, but no torque."""
    MOTION = 1
    """Along a trajectory, by computed torque."""
    TENSION = 2
    """Each tendon at a tension."""


@dataclass(frozen=True, slots=True, eq=False)
class DigitGoal:
    """The goal of one digit; two are the same only if they are one object, so that what follows from it can be kept.

    Attributes:
        kind: how it is driven.
        trajectory: for MOTION, in the digit's coordinates; for TENSION, the way on which its cables are expected: it
            is fed forward, and departing from it is not corrected.
        since: time at which the trajectory starts [s on the run's clock].
        tension: for TENSION, (n_t,) target at the load cells [N].
        rate: for TENSION, how fast the target is approached [N/s].
        force_limit: most motor force at the cable that the goal may use [N].
    """

    kind: Kind = Kind.LIMP
    trajectory: Trajectory | None = None
    since: float = 0.0
    tension: Vector | None = None
    rate: float = 200.0
    force_limit: float = math.inf
