"""All digits of a hand at once: the formulas of ``hand.dynamics`` and ``tip`` as arrays over its joints.

A tick needs them for every digit, and numpy takes as long for eleven numbers as for three.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from handctl.core.types import Vector
from handctl.hand.dynamics import DigitModel


@dataclass(frozen=True, slots=True, eq=False)
class AllDigits:
    """Constants of J joints, N tendons, C coordinates and D digits, in the hand's order.

    Attributes:
        inward: (J, J), 1 in row i for link i's own joint and those between it and the palm.
        weight_x, weight_y: (J,), first moment of mass that turns with a link times gravity in its plane [N m].
        spring, preload: (J,), return springs [N m/rad], [rad].
        ahead: (J, J), angles from a link to the last one of its digit, from joint angles.
        reach: (J, C), lever that a link along the last one gives a force at the tip about each coordinate [m].
        beyond: (J, J), the same about each joint [m].
        coupling: (J, C), joints of coordinates.
        arms: (N, C), tendons of coordinates [m].
        members: (D, C), 1 where a coordinate is the digit's. ropes: (D, N), 1 where a tendon is.
    """

    inward: Vector
    weight_x: Vector
    weight_y: Vector
    spring: Vector
    preload: Vector
    ahead: Vector
    reach: Vector
    beyond: Vector
    coupling: Vector
    arms: Vector
    members: Vector
    ropes: Vector

    @staticmethod
    def of(digits: tuple[DigitModel, ...]) -> "AllDigits":
        """Stack the digits."""
        moments = [np.array(digit.links[6 : 6 + digit.joint_count]) for digit in digits]
        gravity = [digit.gravity for digit in digits]
        sizes = [digit.joint_count for digit in digits]
        inward, coupling = block_diag(*(np.tri(size) for size in sizes)), block_diag(*(one.coupling for one in digits))
        last, lengths = np.repeat(np.cumsum(sizes) - 1, sizes), np.diag(np.concatenate([one.lengths for one in digits]))
        return AllDigits(
            inward=inward,
            weight_x=np.concatenate([w * gx for w, (gx, _) in zip(moments, gravity, strict=True)]),
            weight_y=np.concatenate([w * gy for w, (_, gy) in zip(moments, gravity, strict=True)]),
            spring=np.concatenate([digit.spring_stiffness for digit in digits]),
            preload=np.concatenate([digit.spring_preload for digit in digits]),
            ahead=inward[last] - inward,
            reach=lengths @ inward @ coupling,
            beyond=lengths @ inward,
            coupling=coupling,
            arms=block_diag(*(digit.reduced_moment_arms for digit in digits)),
            members=block_diag(*(np.ones((1, digit.coupling.shape[1])) for digit in digits)),
            ropes=block_diag(*(np.ones((1, digit.reduced_moment_arms.shape[0])) for digit in digits)),
        )

    def static_torque(self, q: Vector) -> Vector:
        """Joint torques that hold the digits where they are: gravity and springs, (J,) [N m].

        Args:
            q: (J,) [rad].
        """
        angle = self.inward.dot(q)
        weight = self.weight_x * np.sin(angle) - self.weight_y * np.cos(angle)
        return np.asarray(weight.dot(self.inward) + self.spring * (q + self.preload))

    def joint_lever(self, q: Vector) -> Vector:
        """Levers of forces at the tips about the joints, (J,) [m], at angles (J,) [rad]; see ``tip.joint_lever``."""
        return np.asarray(np.cos(self.ahead.dot(q)).dot(self.beyond))

    def of_digit(self, values: Vector) -> Vector:
        """(D,) sums over each digit's tendons of values (N,)."""
        return np.asarray(self.ropes.dot(values))
