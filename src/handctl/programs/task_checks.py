"""Checks of a task against a hand: speed of the moves, joint ranges, tip forces."""

import math
from collections.abc import Iterable

import numpy as np

from handctl.core.law.trajectory import duration_for
from handctl.core.types import Vector
from handctl.errors import ConfigError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.programs.task import (
    FOLLOW_SPEED_DEG_S,
    Close,
    Follow,
    Hold,
    Move,
    Phase,
    Task,
    for_digit,
)

Span = tuple[Vector, Vector]
"""Lowest and highest value of the coordinates of a digit [deg]."""


def check_speed(task: Task, digits: tuple[str, ...], where: str) -> None:
    """Refuse a move above the largest joint speed, from any possible end of the phases before.

    Args:
        task: task whose numbers fit the digits.
        digits: names of the hand's digits.
        where: name of the file, for messages.

    Raises:
        ConfigError: A move has too little time.
    """
    spans: dict[str, Span] = dict.fromkeys(digits, (np.zeros(1), np.zeros(1)))  # the hand arms with open digits
    for i, phase in enumerate(task.phase):
        for digit, span in spans.items():
            if (goal := _target(phase, digit)) is None:
                continue
            low, high = span
            if isinstance(phase, Move):
                travel = float(np.maximum(np.abs(goal - low), np.abs(high - goal)).max())
                min_duration = math.ceil(100.0 * duration_for(travel, FOLLOW_SPEED_DEG_S, 0.0)) / 100.0
                if phase.duration_s < min_duration:
                    distance = f"{digit} may have {travel:g} deg to go, at {FOLLOW_SPEED_DEG_S:g} deg/s"
                    expected = f"at least {min_duration:g} s: {distance}"
                    raise ConfigError(f"{phase.duration_s:g}", f"{where}: phase[{i}].duration_s", expected)
            touches = isinstance(phase, Close)  # it may stop anywhere on the way
            spans[digit] = (np.minimum(low, goal), np.maximum(high, goal)) if touches else (goal, goal)


def _target(phase: Phase, digit: str) -> Vector | None:
    """Return the angles of a digit after a phase [deg], None without a motion."""
    if isinstance(phase, Follow):
        return np.array(phase.angle_deg[digit][-1:]) if digit in phase.angle_deg else None
    if not isinstance(phase, (Move, Close)):
        return None
    given = for_digit(phase.angle_deg, digit)
    return None if given is None else np.atleast_1d(np.array(given, dtype=float))


ROUNDING_DEG = 1e-6
"""Largest rounding error of a sum of angles [deg]."""


def check_joint_range(task: Task, hand: Hand, where: str) -> None:
    """Check the angles of a task, digit by digit. Beyond the range a joint only presses on the stop.

    Args:
        task: task that suits the hand otherwise.
        hand: hand with the joints.
        where: name of the file, for messages.

    Raises:
        ConfigError: The joints of a digit cannot reach an angle together.
    """
    reaches = {name: np.degrees(DigitModel.of(hand, name).reach) for name in hand.digit_names}
    for i, phase in enumerate(task.phase):
        if not isinstance(phase, Move | Close | Follow):
            continue
        for name, (low, high) in reaches.items():
            for row in _extremes(phase, name):
                for angle, lower, upper in np.broadcast(row, low, high):
                    if not lower - ROUNDING_DEG <= angle <= upper + ROUNDING_DEG:
                        place = f"{where}: phase[{i}].angle_deg"
                        raise ConfigError(f"{angle:g} deg for {name}", place, f"{lower:g} to {upper:g} deg")


def check_tip_force(task: Task, hand: Hand, where: str) -> None:
    """Refuse a tip force of an underactuated digit.

    The tension of a digit with fewer tendons than joints fixes one combination of joint torques,
    not the force at the tip. At a requested 4 N, fingers of `jamia` curled up on a wall and pressed
    with 23 to 56 N.

    Args:
        task: task that suits the hand otherwise.
        hand: hand with the digits.
        where: name of the file, for messages.

    Raises:
        ConfigError: A hold gives `tip_force_N` to a digit with fewer tendons than joints.
    """
    for i, phase in enumerate(task.phase):
        if not isinstance(phase, Hold) or phase.tip_force_N is None:
            continue
        for name in hand.digit_names:
            tendons = hand.digit_tendons[name]
            joints = hand.digit_joints[name]
            joint_count = joints.stop - joints.start
            tendon_count = tendons.stop - tendons.start
            if tendon_count < joint_count and for_digit(phase.tip_force_N, name) is not None:
                tendons_text = f"{tendon_count} tendon{'s' * (tendon_count > 1)}"
                problem = f"{name} has {tendons_text} for {joint_count} joints: no force at its tip can be made"
                raise ConfigError(problem, f"{where}: phase[{i}].tip_force_N", f"tension_N for {name}")


def check_slip_limit(task: Task, hand: Hand, where: str) -> None:
    """Refuse a slip limit below the tension of its hold. Slip could then raise no tension.

    Args:
        task: task that suits the hand otherwise.
        hand: hand with the digits.
        where: name of the file, for messages.

    Raises:
        ConfigError: A hold has a `slip_limit_N` below its `tension_N`.
    """
    for i, phase in enumerate(task.phase):
        if not isinstance(phase, Hold) or phase.slip_limit_N is None or phase.tension_N is None:
            continue
        for name in hand.digit_names:
            limit = for_digit(phase.slip_limit_N, name)
            tension = for_digit(phase.tension_N, name)
            if limit is not None and tension is not None and np.max(limit) < np.max(tension):
                expected = f"at least tension_N of {name}, {np.max(tension):g}"
                raise ConfigError(f"{np.max(limit):g}", f"{where}: phase[{i}].slip_limit_N", expected)


def _extremes(phase: Move | Close | Follow, name: str) -> Iterable[float | tuple[float, ...]]:
    """Return the angles of a phase that a digit must reach: one for all its coordinates, or one for each."""
    if isinstance(phase, Follow):
        angles = phase.angle_deg.get(name)
        return (min(angles), max(angles)) if angles else ()
    angle = for_digit(phase.angle_deg, name)
    return () if angle is None else (angle,)
