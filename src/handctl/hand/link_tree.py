"""Model of a whole hand as a single tree of links.

The model computes poses, mass matrix and static torques of all joints together. A digit can be
mounted on the last link of another digit, as a finger is mounted on a wrist. The functions of
``dynamics`` and ``kinematics`` apply to a single digit whose base is at rest. The tree of links
also includes the motion of digits that carry other digits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handctl.hand import rigid_body
from handctl.hand.description import Hand
from handctl.hand.digit import Array, DigitModel, JointValues
from handctl.hand.kinematics import joint_positions, link_rotations


@dataclass(frozen=True, slots=True, eq=False)
class LinkTree:
    """Tree of all links of a hand, in the order of the joints.

    Attributes:
        digits: models of the digits, in the order of the hand file.
        table: (rigid_body.LINK_TABLE_ROW_COUNT, J) frames and inertial properties of the links, for
            ``rigid_body``.
        parent: (J,) index of the joint before each joint, -1 for the palm.
        gravity: (3,) gravitational acceleration in the palm frame [m/s2].
        spring_stiffness: (J,) stiffness of the return spring of each joint [N m/rad].
        spring_preload: (J,) preload of the return spring of each joint [rad].
    """

    digits: tuple[DigitModel, ...]
    table: Array
    parent: NDArray[np.int64]
    gravity: Array
    spring_stiffness: Array
    spring_preload: Array

    @staticmethod
    def from_hand(hand: Hand, digits: Sequence[DigitModel] = ()) -> "LinkTree":
        """Build the tree of a hand.

        Args:
            hand: description of the hand.
            digits: models of the hand's digits, in the order of the hand file. If the sequence is
                empty, the function builds the models.
        """
        digits = tuple(digits) or DigitModel.digit_models_of_hand(hand)
        parents = [
            np.where(
                digit.parent < 0, hand.base_joints[digit.name], digit.parent + digit.joints.start
            )
            for digit in digits
        ]
        return LinkTree(
            digits=digits,
            table=np.concatenate([digit.table for digit in digits], axis=1),
            parent=np.concatenate(parents),
            gravity=np.array(hand.mount.gravity_m_s2),
            spring_stiffness=np.concatenate([digit.spring_stiffness for digit in digits]),
            spring_preload=np.concatenate([digit.spring_preload for digit in digits]),
        )

    def poses(self, q: JointValues) -> Array:
        """Return the poses of all links (J, rigid_body.POSE_COLUMN_COUNT) at joint angles q (J,) [rad]."""
        return rigid_body.link_poses(self.table, self.parent, np.asarray(q, dtype=np.float64))

    def points(self, q: JointValues) -> tuple[Array, ...]:
        """Return the positions of the joints and the tip of each digit, (n + 1, 3) in the palm frame [m]."""
        poses = self.poses(q)
        result = []
        for digit in self.digits:
            digit_poses = poses[digit.joints]
            tip = (
                joint_positions(digit_poses)[-1]
                + digit.lengths[-1] * link_rotations(digit_poses)[-1, :, 0]
            )
            result.append(np.vstack((joint_positions(digit_poses), tip)))
        return tuple(result)

    def mass_matrix(self, q: JointValues) -> Array:
        """Return the mass matrix (J, J) [kg m2] of all joints, including the armature inertias."""
        return rigid_body.inertia_matrix(self.table, self.parent, np.asarray(q, dtype=np.float64))

    def inverse_dynamics(self, q: JointValues, dq: JointValues, ddq: JointValues) -> Array:
        """Return the joint torques (J,) [N m] that a motion requires because of inertia and weight."""
        rows = (np.asarray(values, dtype=np.float64) for values in (q, dq, ddq))
        return rigid_body.rigid_body_torques(self.table, self.parent, self.gravity, *rows)

    def static_torque(self, q: JointValues) -> Array:
        """Return the joint torques (J,) [N m] that hold the hand at rest against weight and return springs."""
        angles = np.asarray(q, dtype=np.float64)
        gravity_torques = rigid_body.weight_torques(self.table, self.parent, self.gravity, angles)
        return np.asarray(gravity_torques + self.spring_stiffness * (angles + self.spring_preload))
