"""Whether the moves of a task are slow enough: a rotor that is stopped dead adds tension in proportion to its speed."""

import math

import numpy as np

from handctl.core.law.trajectory import duration_for
from handctl.core.types import Vector
from handctl.errors import ConfigError
from handctl.programs.task import FOLLOW_SPEED_DEG_S, Close, Follow, Move, Phase, Task, for_digit

Span = tuple[Vector, Vector]
"""Where the coordinates of a digit may be: least and most [deg]."""


def check_pace(task: Task, digits: tuple[str, ...], where: str) -> None:
    """Refuse a move that would be faster than any curve may be, from wherever the phases before it leave a digit.

    Args:
        task: its numbers fit the digits.
        digits: the hand's digit names.
        where: the file's name, for the message.

    Raises:
        ConfigError: a move has too little time.
    """
    spans: dict[str, Span] = dict.fromkeys(digits, (np.zeros(1), np.zeros(1)))  # it arms with open digits
    for i, phase in enumerate(task.phase):
        for digit, span in spans.items():
            if (goal := _goal(phase, digit)) is None:
                continue
            least, most = span
            if isinstance(phase, Move):
                way = float(np.maximum(np.abs(goal - least), np.abs(most - goal)).max())
                time = math.ceil(100.0 * duration_for(way, FOLLOW_SPEED_DEG_S, 0.0)) / 100.0
                if phase.duration_s < time:
                    right = f"at least {time:g} s: {digit} may have {way:g} deg to go, at {FOLLOW_SPEED_DEG_S:g} deg/s"
                    raise ConfigError(f"{phase.duration_s:g}", f"{where}: phase[{i}].duration_s", right)
            touches = isinstance(phase, Close)  # on the way, perhaps
            spans[digit] = (np.minimum(least, goal), np.maximum(most, goal)) if touches else (goal, goal)


def _goal(phase: Phase, digit: str) -> Vector | None:
    """Where a phase takes a digit [deg], if it moves it."""
    if isinstance(phase, Follow):
        return np.array(phase.angle_deg[digit][-1:]) if digit in phase.angle_deg else None
    if not isinstance(phase, (Move, Close)):
        return None
    given = for_digit(phase.angle_deg, digit)
    return None if given is None else np.atleast_1d(np.array(given, dtype=float))
