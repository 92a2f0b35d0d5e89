"""Whether the joints of a hand reach what a task asks for; beyond that a motor only presses on a stop."""

from collections.abc import Iterable

import numpy as np

from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.programs.task import Close, Follow, Hold, Move, Task, for_digit

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


def check_tip_force(task: Task, hand: Hand, where: str) -> None:
    """Refuse a tip force of an underactuated digit.

    The tension of a digit with fewer tendons than joints fixes one combination of joint torques, not the force at the
    tip: asked for 4 N, fingers of `jamia` curled up on a wall and pressed with 23 to 56 N.

    Args:
        task: that suits the hand otherwise.
        hand: whose digits they are.
        where: the file's name, for the message.

    Raises:
        ConfigError: a hold gives ``tip_force_N`` to a digit that has fewer tendons than joints.
    """
    for i, phase in enumerate(task.phase):
        if not isinstance(phase, Hold) or phase.tip_force_N is None:
            continue
        for name in hand.digit_names:
            tendons, joints = hand.digit_tendons[name], hand.digit_joints[name]
            moved, by = joints.stop - joints.start, tendons.stop - tendons.start
            if by < moved and for_digit(phase.tip_force_N, name) is not None:
                what = f"{name} has {by} tendon{'s' * (by > 1)} for {moved} joints: no force at its tip can be made"
                raise ConfigError(what, f"{where}: phase[{i}].tip_force_N", f"tension_N for {name}")


def _rows(phase: Move | Close | Follow, name: str) -> Iterable[float | tuple[float, ...]]:
    """The most that a phase asks of a digit: an angle for all its coordinates, or one for each."""
    if isinstance(phase, Follow):
        angles = phase.angle_deg.get(name)
        return (min(angles), max(angles)) if angles else ()
    asked = for_digit(phase.angle_deg, name)
    return () if asked is None else (asked,)
