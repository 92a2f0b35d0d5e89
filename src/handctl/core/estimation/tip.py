"""Tip-equivalent force: the force normal to the last link, at its tip, that a torque of the digit stands for.

A one-tendon finger does not tell where it is touched; the tip is then a convention, and the name says so.
"""

import math

import numpy as np

from handctl.core.types import Vector
from handctl.hand.dynamics import DigitModel


def joint_lever(digit: DigitModel, q: Vector) -> Vector:
    """Lever of a force normal to the last link at the tip about each joint: J^T n, (n,) [m].

    Args:
        digit: the digit.
        q: (n,) joint angles [rad].
    """
    beyond, reach, lever = 0.0, 0.0, []
    for length, angle in zip(reversed(digit.lengths), reversed(q.tolist()), strict=True):
        reach += length * math.cos(beyond)
        beyond += angle
        lever.append(reach)
    return np.array(lever[::-1])


def tip_lever(digit: DigitModel, q: Vector) -> Vector:
    """The same in the digit's coordinates: B^T J^T n, (n_c,) [m]."""
    return np.asarray(digit.coupling.T @ joint_lever(digit, q))


def tip_force(digit: DigitModel, q: Vector, external: Vector) -> float:
    """Tip-equivalent force [N] of the tension that contact explains.

    Args:
        digit: the digit.
        q: (n,) joint angles [rad].
        external: (n_t,) tension balanced by contact [N].
    """
    lever = tip_lever(digit, q)
    torque = digit.reduced_moment_arms.T @ external
    return float(lever @ torque / (lever @ lever))
