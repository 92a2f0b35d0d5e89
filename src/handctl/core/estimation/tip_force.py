"""Tip-equivalent force: a force on the last link, at the tip, with the same torque as the actual contact.

The tension of a finger with one tendon does not show the place of the contact. The tip is therefore
assumed as the place of the contact.
"""

import numpy as np

from handctl.core.tick_types import Vector
from handctl.hand import rigid_body
from handctl.hand.digit import DigitModel


def joint_lever(digit: DigitModel, q: Vector) -> Vector:
    """Return the levers J^T n of a force at the tip about the joints, (n,) [m].

    The force at the tip acts along the y axis of the last link.

    Args:
        digit: model of the digit.
        q: (n,) joint angles [rad].
    """
    last = digit.joint_count - 1
    return rigid_body.tip_levers(
        digit.table, digit.parent, np.asarray(q), last, digit.lengths[last]
    )


def reduced_tip_lever(digit: DigitModel, q: Vector) -> Vector:
    """Return the levers B^T J^T n of a force at the tip about the digit's coordinates, (n_c,) [m].

    The direction of the force is the same as in ``joint_lever``.
    """
    return np.asarray(digit.coupling.T @ joint_lever(digit, q))


def tip_force(digit: DigitModel, q: Vector, external: Vector) -> float:
    """Return the force at the tip that makes the same torque as a contact of the digit [N].

    Args:
        digit: model of the digit.
        q: (n,) joint angles [rad].
        external: (n_t,) tensions that balance the contact force [N].
    """
    lever = reduced_tip_lever(digit, q)
    torque = digit.reduced_moment_arms.T @ external
    return float(lever @ torque / (lever @ lever))
