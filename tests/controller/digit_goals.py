"""Make goals for all digits of a hand. Tests of the control law use these goals."""

import math

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.control_law.trajectory import MinimumJerk
from handctl.core.hand_model import HandModel


def moving_goals(
    model: HandModel,
    start_angle: float,
    end_angle: float,
    duration_s: float | tuple[float, ...],
    start_time: float = 0.0,
) -> tuple[DigitGoal, ...]:
    """Return goals that move every digit from ``start_angle`` to ``end_angle`` [rad].

    ``duration_s`` [s] is one duration for all digits, or a tuple with one duration for each digit.
    """
    durations_s = duration_s if isinstance(duration_s, tuple) else (duration_s,) * len(model.digits)
    sizes = [digit.coupling.shape[1] for digit in model.digits]
    return tuple(
        DigitGoal(
            GoalKind.MOTION,
            MinimumJerk(np.full(n, start_angle), np.full(n, end_angle), duration_of_digit_s),
            since=start_time,
        )
        for n, duration_of_digit_s in zip(sizes, durations_s, strict=True)
    )


def holding_goals(
    model: HandModel, tension: float, tension_rate: float = 200.0, tension_limit: float = math.inf
) -> tuple[DigitGoal, ...]:
    """Return goals that hold the same tension ``tension`` [N] in the tendons of all digits."""
    return tuple(
        DigitGoal(
            GoalKind.TENSION,
            tension=np.full(s.stop - s.start, tension),
            rate=tension_rate,
            force_limit=tension_limit,
        )
        for s in model.digit_tendons
    )
