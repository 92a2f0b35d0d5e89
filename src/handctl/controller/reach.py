"""Whether the joints of a hand reach what a task asks for; beyond that a motor only presses on a stop."""

from collections.abc import Iterable

import numpy as np

from handctl.controller.task import Close, Follow, Move, Task, for_digit
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel

ROUNDING_DEG = 1e-6
"""What a sum of angles may be wrong by."""


def check_reach(task: Task, hand: Hand, where: str) -> None:
    """Check the angles of a task, digit by digit.

    Args:
        task: that suits the hand otherwise.
        hand: whose joints they are.
        where: the file's name, for the message.

    Raises:
        ConfigError: an angle that a digit's joints cannot have together.
    """
    reaches = {name: np.degrees(DigitModel.of(hand, name).reach) for name in hand.digit_names}
    for i, phase in enumerate(task.phase):
        if not isinstance(phase, Move | Close | Follow):
            continue
        for name, (low, high) in reaches.items():
            for row in _rows(phase, name):
                for angle, least, most in np.broadcast(row, low, high):
                    if not least - ROUNDING_DEG <= angle <= most + ROUNDING_DEG:
                        place = f"{where}: phase[{i}].angle_deg"
                        raise ConfigError(f"{angle:g} deg for {name}", place, f"{least:g} to {most:g} deg")


def _rows(phase: Move | Close | Follow, name: str) -> Iterable[float | tuple[float, ...]]:
    """The most that a phase asks of a digit: an angle for all its coordinates, or one for each."""
    if isinstance(phase, Follow):
        angles = phase.angle_deg.get(name)
        return (min(angles), max(angles)) if angles else ()
    asked = for_digit(phase.angle_deg, name)
    return () if asked is None else (asked,)
