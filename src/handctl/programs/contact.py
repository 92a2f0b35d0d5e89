"""Contact found while a digit closes: the tension that nothing known explains, as a force at its tip.

Each digit's tendons are weighed as a unit force at the tip would load them, so that a proximal tendon, which feels the
tip most and friction least, counts most. The force is smoothed over a few milliseconds: what the contact of a closing
digit adds stays, what a chattering rope adds comes and goes. A model that expects too much tension hides a contact
behind a force below zero, which is there for longer than a contact takes to grow: it is taken off. A force above zero
that is there in all of a digit's closing is a load cell's drift, and is taken off, too.
"""

import math

import numpy as np

from handctl.core.estimation.estimator import Estimate
from handctl.core.law.goal import DigitGoal
from handctl.core.model import HandModel
from handctl.core.types import Vector

SMOOTH_S = 5e-3
"""Time constant: a quarter of the time in which a contact is to be found."""
USUAL_S, DRIFT_S = 0.15, 2.0
"""Time constants of what is felt anyway: several times that in which a contact grows, and one in which it is found."""

USUAL_JOINTS = 2
"""Of a digit for which the threshold is said: every joint more adds its own friction to what is felt at the tip, 0.33 N
on fingers of three joints that touch nothing; they find a contact long before 1 N."""
ARRIVED_S, ARRIVED_FACTOR = 0.15, 2.0
"""So long after the end of its way a digit counts as arrived, and needs so much more force: it meets nothing new by
itself, and friction that creeps could be taken for a touch."""


def needed(goal: DigitGoal, joints: int, threshold: float, t: float) -> float:
    """Force at the tip that counts as contact [N].

    Args:
        goal: of the digit. joints: it has. threshold: of one with two joints, on its way [N]. t: time [s].
    """
    threshold *= joints / USUAL_JOINTS
    on_way = goal.trajectory is not None and t - goal.since < goal.trajectory.duration + ARRIVED_S
    return threshold if on_way else ARRIVED_FACTOR * threshold


def felt(model: HandModel, q: Vector, external: Vector) -> Vector:
    """Forces at the tips (D,) [N] that fit unexplained tensions best, in the sense of least squares of tension.

    Args:
        model: the hand.
        q: (J,) joint angles [rad].
        external: (N,) unexplained tensions [N].
    """
    digits = model.all_digits
    response = model.torque_to_tension.dot(digits.joint_lever(q))
    return np.asarray(digits.of_digit(response * external) / digits.of_digit(response * response))


def feel(model: HandModel, before: tuple[float, ...], estimate: Estimate, closing: list[bool]) -> tuple[float, ...]:
    """Smoothed force at the tip of each digit that closes [N]; 0 for the others.

    Args:
        model: the hand.
        before: from the last tick; empty at the beginning.
        estimate: of this instant.
        closing: per digit, whether it is asked.
    """
    if True not in closing:
        return (0.0,) * len(closing)
    free = model.excursion_to_joints.dot(estimate.excursion)  # a closing digit is free until this finds otherwise
    share, now = -math.expm1(-model.period / SMOOTH_S), felt(model, free, estimate.external).tolist()
    rows = zip(before or (0.0,) * len(closing), now, closing, strict=True)
    return tuple([old + share * (new - old) if asked else 0.0 for old, new, asked in rows])


def grown(felt: tuple[float, ...], usual: tuple[float, ...], drift: tuple[float, ...]) -> list[float]:
    """What counts of the forces felt at the tips [N].

    Args:
        felt: per digit, smoothed [N].
        usual, drift: what was felt lately, and in all of its closing [N]; empty at the beginning.
    """
    rows = zip(felt, usual or felt, drift or (0.0,) * len(felt), strict=True)
    return [now - min(lately, 0.0) - max(always, 0.0) for now, lately, always in rows]


def averaged(
    model: HandModel, before: tuple[float, ...], felt: tuple[float, ...], closing: list[bool], time: float
) -> tuple[float, ...]:
    """Mean of what is felt of each digit while it closes [N].

    Args:
        model: the hand. before: from the last tick. felt: of this tick, smoothed [N].
        closing: per digit, whether it does; the others keep theirs.
        time: constant of the mean [s].
    """
    share = -math.expm1(-model.period / time)
    rows = zip(before, felt, closing, strict=True)
    return tuple([old + share * (new - old) if asked else old for old, new, asked in rows])
