"""Tip-equivalent force of a contact.

The tip-equivalent force acts at the tip, normal to the last link, and makes the same torque as the
actual contact. The tension of a finger with one tendon does not depend on the place of contact, so
the tip is used as the place of contact by convention. In a digit with several coordinates, one force
cannot make all their torques, so the tip-equivalent force is the least-squares solution.
"""

import numpy as np

from handctl.core.tick_types import Vector
from handctl.hand import rigid_body
from handctl.hand.digit import DigitModel


def joint_lever(digit: DigitModel, q: Vector) -> Vector:
    """Return the levers (n,) about the joints, for a force at the tip [m].

    The force at the tip acts along the y axis of the last link.

    Args:
        digit: model of the digit.
        q: (n,) joint angles [rad].
    """
    last_joint = digit.joint_count - 1
    return rigid_body.tip_levers(
        digit.table, digit.parent, np.asarray(q), last_joint, digit.lengths[last_joint]
    )


def reduced_tip_lever(digit: DigitModel, q: Vector) -> Vector:
    """Return the levers (n_c,) about the digit's coordinates, for a force at the tip [m].

    The direction of the force at the tip is the same as in ``joint_lever``.
    """
    return np.asarray(digit.coupling.T @ joint_lever(digit, q))


def tip_force(digit: DigitModel, q: Vector, external_tension: Vector) -> float:
    """Return the tip-equivalent force of a contact with a digit [N].

    Args:
        digit: model of the digit.
        q: (n,) joint angles [rad].
        external_tension: (n_t,) tensions that balance the contact force [N].
    """
    lever = reduced_tip_lever(digit, q)
    torque = digit.reduced_moment_arms.T @ external_tension
    return float(lever @ torque / (lever @ lever))
