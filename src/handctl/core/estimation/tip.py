"""Tip-equivalent force: the force normal to the last link, at its tip, that a torque of the digit stands for.

A one-tendon finger does not tell where it is touched; the tip is then a convention, and the name says so.
"""

import math

import numpy as np

from handctl.compiled import inner, kernel, square
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


@kernel("vector", "vector", "vector", "vector", "matrix", "matrix", "matrix", "matrix", "real", "real")
def tip_forces(
    q: Vector,
    q_sigma: Vector,
    external: Vector,
    tension_sigma: Vector,
    ahead: Vector,
    reach: Vector,
    members: Vector,
    arms: Vector,
    model_error_N: float,
    model_error: float,
) -> tuple[Vector, Vector]:
    """Tip-equivalent forces of all digits, and their standard deviations by those of angles and tensions.

    Args:
        q, q_sigma: (J,) joint angles and their standard deviations [rad].
        external: (N,) tension balanced by contact [N]. tension_sigma: (N,) standard deviation of the tensions [N].
        ahead, reach, members, arms: see ``AllDigits``.
        model_error_N, model_error: tension that the model errs by [N], and that as a fraction of the unexplained.

    Returns:
        (D,) forces and (D,) standard deviations [N].
    """
    digits, coordinates = members.shape
    torque, variance = np.zeros(coordinates), np.zeros(digits)
    for c in range(coordinates):
        for n in range(len(external)):
            torque[c] += external[n] * arms[n, c]
    lever, tried = _levers(q, ahead, reach), q.copy()
    size = _pressed(lever, lever, members)
    force = _pressed(lever, torque, members) / size
    for j in range(len(q)):
        tried[j] = q[j] + q_sigma[j]
        turned = _levers(tried, ahead, reach)
        change = _pressed(turned, torque, members) / _pressed(turned, turned, members) - force
        variance += change * change
        tried[j] = q[j]
    for n in range(len(external)):
        error = math.sqrt(square(tension_sigma[n]) + square(model_error_N) + square(model_error * external[n]))
        change = _pressed(lever, arms[n], members) * error / size
        variance += change * change
    return force, np.sqrt(variance)


@inner
def _levers(q: Vector, ahead: Vector, reach: Vector) -> Vector:
    """Levers of forces normal to the last links at the tips, about each coordinate, (C,) [m], at angles (J,) [rad]."""
    levers = np.zeros(reach.shape[1])
    for j in range(len(q)):
        angle = 0.0
        for other in range(len(q)):
            angle += ahead[j, other] * q[other]
        for c in range(len(levers)):
            levers[c] += math.cos(angle) * reach[j, c]
    return levers


@inner
def _pressed(lever: Vector, torque: Vector, members: Vector) -> Vector:
    """Return the sums of lever times torque (C,) over each digit's coordinates, (D,)."""
    sums = np.zeros(len(members))
    for d in range(len(members)):
        for c in range(len(lever)):
            sums[d] += members[d, c] * lever[c] * torque[c]
    return sums
