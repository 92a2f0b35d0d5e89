"""Contact found while a digit closes: the tension that nothing known explains, as a force at its tip.

Each digit's tendons are weighed as a unit force at the tip would load them, so that a proximal tendon, which feels the
tip most and friction least, counts most. The force is smoothed over a few milliseconds: what the contact of a closing
digit adds stays, what a chattering rope adds comes and goes.
"""

import math

from handctl.controller.estimator import Estimate
from handctl.controller.model import HandModel
from handctl.controller.tip import joint_lever
from handctl.controller.types import Vector
from handctl.hand.dynamics import DigitModel

SMOOTH_S = 10e-3
"""Time constant: half of the time in which a contact is to be found."""


def felt(digit: DigitModel, q: Vector, external: Vector) -> float:
    """Force at the tip [N] that fits unexplained tensions best, in the sense of least squares of tension.

    Args:
        digit: the digit.
        q: (n,) joint angles [rad].
        external: (n_t,) unexplained tensions [N].
    """
    response = digit.torque_to_tension @ joint_lever(digit, q)
    return float(response @ external / (response @ response))


def feel(model: HandModel, before: tuple[float, ...], estimate: Estimate, closing: list[bool]) -> tuple[float, ...]:
    """Smoothed force at the tip of each digit that closes [N]; 0 for the others.

    Args:
        model: the hand.
        before: from the last tick; empty at the beginning.
        estimate: of this instant.
        closing: per digit, whether it is asked.
    """
    share = -math.expm1(-model.period / SMOOTH_S)
    forces = []
    for d, (digit, tendons) in enumerate(zip(model.digits, model.digit_tendons, strict=True)):
        old = before[d] if before else 0.0
        now = felt(digit, estimate.q[digit.joints], estimate.external[tendons]) if closing[d] else 0.0
        forces.append(old + share * (now - old) if closing[d] else 0.0)
    return tuple(forces)
