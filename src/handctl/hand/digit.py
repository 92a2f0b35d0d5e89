"""Model of one digit: all numbers for its kinematics, dynamics and statics, built from the description of the hand."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from handctl.hand import rigid_body as body
from handctl.hand.description import Hand
from handctl.hand.file.display_units import DisplayUnits
from handctl.hand.file.section_models import Digit
from handctl.hand.link_geometry import (
    centre_of_mass,
    joint_axes,
    link_inertia,
    link_placement,
    rotation_of_rpy,
)
from handctl.hand.moment_arms import joint_excursions, moment_arms_at

Array = NDArray[np.float64]
JointValues = Sequence[float] | Array
"""Sequence with one number per joint. Calculations are fastest with lists and tuples."""
SIDEWAYS_ANGLE_DEG = 45.0
"""Largest angle between the axis of a joint and the axis of the last joint at which the joint counts as flexing [deg].

A joint whose axis has a larger angle moves the digit sideways.
"""
NEWTON_STEPS = 20
"""Largest number of Newton steps from an excursion to joint angles. Usually about five Newton steps are sufficient."""
NEWTON_TOLERANCE_RAD = 1e-10
"""Change of a coordinate below which the Newton iteration ends [rad]."""
SIDEWAYS_RANGE_RATIO = 0.5
"""Threshold for the opening range of a coordinate divided by its closing range.

In a digit with parallel axes, a coordinate with a larger ratio moves the digit sideways.
"""


@dataclass(frozen=True, slots=True, eq=False)
class DigitModel:
    """Digit with n joints, n_t tendons, and n_c reduced coordinates theta.

    The joint angles of the digit are q = B theta. All arrays of the model are read-only. A
    prismatic joint has a position [m] instead of an angle [rad], and a force [N] instead of a
    torque [N m]. Instead of a moment arm [m], a prismatic joint has an excursion per position
    [m/m].

    Attributes:
        name: name of the digit.
        joint_names: names of the joints, in order.
        tendon_names: names of the tendons, in order.
        joints: slice of the hand's joints that contains the joints of this digit.
        tendons: slice of the hand's tendons that contains the tendons of this digit.
        lengths: (n,) length of each link [m].
        centres_of_mass: (n, 3) centre of mass of each link, in the frame of the link [m].
        masses: (n,) mass of each link [kg].
        inertias: (n, 3, 3) inertia of each link about its centre of mass, in the frame of the link
            [kg m2].
        axes: (n, 3) unit vector of each joint in the link's frame.
        is_prismatic: (n,) True for each prismatic joint.
        radius: radius of the links [m].
        joint_min: (n,) smallest joint angles [rad].
        joint_max: (n,) largest joint angles [rad].
        joint_damping: (n,) viscous damping of each joint [N m s/rad].
        armature: (n,) inertia of the moving parts of each joint, without the link [kg m2].
        spring_stiffness: (n,) stiffness of each return spring [N m/rad].
        spring_preload: (n,) preload of each return spring [rad].
        mount_rotation: (3, 3) rotation that converts vectors from the frame of the digit to the
            palm frame.
        mount_position: (3,) position of the first joint in the palm frame [m].
        gravity: (3,) gravitational acceleration in the palm frame [m/s2]. If another digit carries
            the digit, the attributes of the mount refer to the frame of the carrying link instead
            of the palm frame.
        table: (rigid_body.LINK_TABLE_ROW_COUNT, n) frames and inertial properties of the links, for
            ``rigid_body``.
        parent: (n,) column in ``table`` of the link before each link, -1 for the palm.
        moment_arms: moment arms R (n_t, n) [m]. If a moment arm depends on the joint angle, R
            contains the mean of the moment arm. The method ``with_moment_arms_at`` returns a digit
            whose R belongs to given angles.
        coupling: B, (n, n_c), the identity matrix for independent joints.
        reduced_moment_arms: matrix R B (n_t, n_c) [m].
        excursion_to_joints: B (R B)^+, (n, n_t) [rad/m], from tendon excursion to joint angles.
        torque_to_tension: (R B)^+^T B^T, (n_t, n) [1/m], from joint torque to the tensions of
            smallest norm.
        joints_to_coordinates: B^+, (n_c, n), from joint angles to reduced coordinates.
        friction: (n_t,) friction coefficient of the pulleys of each tendon.
        wrap: (n_t,) wrap angle of each tendon before its first joint pulley [rad].
        motor_mass: (n_t,) inertia of the rotor as a mass that moves with the tendon, J_m / r_a^2
            [kg].
        arm_polynomials: (n_t, n, quantity_types.POLYNOMIAL_COEFFICIENTS) moment arms as polynomials of
            the joint angle.
        has_varying_arm: True if at least one moment arm depends on the joint angle.
        joint_units: (n,) units in which a user sees the positions of the joints.
        coordinate_units: (n_c,) units in which a user sees the coordinates.
    """

    name: str
    joint_names: tuple[str, ...]
    tendon_names: tuple[str, ...]
    joints: slice
    tendons: slice
    lengths: tuple[float, ...]
    centres_of_mass: Array
    masses: tuple[float, ...]
    inertias: Array
    axes: Array
    is_prismatic: NDArray[np.bool_]
    radius: float
    joint_min: Array
    joint_max: Array
    joint_damping: tuple[float, ...]
    armature: tuple[float, ...]
    spring_stiffness: tuple[float, ...]
    spring_preload: tuple[float, ...]
    mount_rotation: Array
    mount_position: Array
    gravity: Array
    table: Array
    parent: NDArray[np.int64]
    moment_arms: Array
    coupling: Array
    reduced_moment_arms: Array
    excursion_to_joints: Array
    torque_to_tension: Array
    joints_to_coordinates: Array
    friction: Array
    wrap: Array
    motor_mass: Array
    arm_polynomials: Array
    has_varying_arm: bool
    joint_units: DisplayUnits
    coordinate_units: DisplayUnits

    @property
    def coordinate_limits(self) -> tuple[Array, Array]:
        """Return the smallest and the largest reduced coordinates (n_c,) within the joint limits [rad]."""
        # If an entry of B^+ is negative, the lower joint limit gives the upper coordinate limit.
        # The code compares the products of the entry with both joint limits.
        low = self.joints_to_coordinates * self.joint_min
        high = self.joints_to_coordinates * self.joint_max
        return np.minimum(low, high).sum(axis=1), np.maximum(low, high).sum(axis=1)

    @property
    def sideways_coordinates(self) -> NDArray[np.bool_]:
        """Return True for each coordinate (n_c,) that moves the digit sideways, such as abduction.

        A joint moves the links sideways if the angle between its axis and the axis of the last
        joint exceeds ``SIDEWAYS_ANGLE_DEG``. In a digit with parallel axes, a coordinate moves
        sideways if its range below zero (opening) is more than half of its range above zero
        (closing).
        """
        turned_axes = np.eye(3)
        axes = []
        for i in range(self.joint_count):
            # At joint angle zero, the rotation of a link is the sum of only two of the three
            # matrices in Rodrigues' formula.
            step = (
                self.table[body.FIXED_ROTATION_ROW : body.FIXED_ROTATION_ROW + 9, i]
                + self.table[body.COSINE_ROTATION_ROW : body.COSINE_ROTATION_ROW + 9, i]
            )
            turned_axes = turned_axes @ step.reshape(3, 3)
            axis = self.axes[i]
            if self.is_prismatic[i]:
                # A prismatic joint moves a link like a hinge that is far away from the link and has
                # the computed axis.
                axis = np.cross((1.0, 0.0, 0.0), axis)
            axes.append(turned_axes @ axis)
        if np.linalg.norm(axes[-1]) < 0.5:
            axes[-1] = turned_axes[:, 2]  # the last link slides along its own axis
        is_sideways = np.abs(np.array(axes) @ axes[-1]) < math.cos(math.radians(SIDEWAYS_ANGLE_DEG))
        if is_sideways.any():
            # A coordinate flexes the digit if it moves at least one joint that does not move links
            # sideways.
            return np.asarray(~(self.coupling[~is_sideways] != 0.0).any(axis=0))
        low, high = self.coordinate_limits
        return np.asarray(-low > SIDEWAYS_RANGE_RATIO * high)

    @staticmethod
    def from_hand(hand: Hand, name: str) -> "DigitModel":
        """Build the model of the digit with the given name."""
        digit = hand.digit_named(name)
        joints = hand.digit_joints[name]
        tendons = hand.digit_tendons[name]
        motors = [hand.motor_of_tendon(tendon.name) for tendon in hand.tendon[tendons]]
        links = range(len(digit.joints))
        arms = hand.moment_arms[:, joints][tendons]
        coupling = np.eye(len(digit.joints)) if digit.coupling is None else np.array(digit.coupling)
        # By least squares, the pseudo-inverse of R B converts an excursion to coordinates. The
        # transpose of this pseudo-inverse converts a torque to the tensions of smallest norm.
        excursion_to_coordinates = np.linalg.pinv(arms @ coupling)
        return DigitModel(
            name=name,
            joint_names=digit.joints,
            tendon_names=hand.tendon_names[tendons],
            joints=joints,
            tendons=tendons,
            lengths=digit.link_length_m,
            centres_of_mass=_read_only_copy([centre_of_mass(digit, i) for i in links]),
            masses=digit.link_mass_kg,
            inertias=_read_only_copy([link_inertia(digit, i) for i in links]),
            axes=_read_only_copy(joint_axes(digit)),
            is_prismatic=np.array(digit.is_prismatic),
            radius=digit.link_radius_m,
            joint_min=_read_only_copy(digit.joint_limits[0]),
            joint_max=_read_only_copy(digit.joint_limits[1]),
            joint_damping=digit.joint_values("joint_damping_N_m_s_per_rad"),
            armature=digit.joint_values("joint_armature_kg_m2"),
            spring_stiffness=digit.joint_values("spring_stiffness_N_m_per_rad"),
            spring_preload=digit.joint_values("spring_preload_rad"),
            mount_rotation=_read_only_copy(rotation_of_rpy(*np.radians(digit.mount_rpy_deg))),
            mount_position=_read_only_copy(digit.mount_position_m),
            gravity=_read_only_copy(base_rotation(hand, digit).T @ hand.mount.gravity_m_s2),
            table=_read_only_copy(link_table(digit)),
            parent=np.arange(-1, len(links) - 1),
            moment_arms=_read_only_copy(arms),
            coupling=_read_only_copy(coupling),
            reduced_moment_arms=_read_only_copy(arms @ coupling),
            excursion_to_joints=_read_only_copy(coupling @ excursion_to_coordinates),
            torque_to_tension=_read_only_copy(excursion_to_coordinates.T @ coupling.T),
            joints_to_coordinates=_read_only_copy(np.linalg.pinv(coupling)),
            friction=_read_only_copy(
                [tendon.friction_coefficient for tendon in hand.tendon[tendons]]
            ),
            wrap=_read_only_copy([tendon.wrap_angle_rad for tendon in hand.tendon[tendons]]),
            motor_mass=_read_only_copy(
                [motor.inertia_kg_m2 / motor.spool_radius_m**2 for motor in motors]
            ),
            arm_polynomials=_read_only_copy(hand.arm_polynomials[tendons, joints]),
            has_varying_arm=bool(hand.has_varying_arm[tendons].any()),
            joint_units=digit.display_units,
            coordinate_units=DisplayUnits.of(
                (coupling[np.array(digit.is_prismatic)] != 0.0).any(axis=0)
            ),
        )

    @staticmethod
    def digit_models_of_hand(hand: Hand) -> "tuple[DigitModel, ...]":
        """Build the models of all digits of a hand, in the order of the hand file."""
        return tuple(DigitModel.from_hand(hand, name) for name in hand.digit_names)

    @property
    def joint_limits(self) -> Array:
        """Return the smallest and the largest angle of each joint (2, n) [rad]."""
        return np.stack((self.joint_min, self.joint_max))

    def moment_arms_at(self, q: ArrayLike) -> Array:
        """Return the moment arms R, (..., n_t, n) [m], at joint angles (..., n) [rad]."""
        if not self.has_varying_arm:
            return self.moment_arms
        return moment_arms_at(self.arm_polynomials, self.joint_limits, q)

    def excursion_at_angles(self, q: ArrayLike) -> Array:
        """Return the excursion of each tendon, (n_t,) [m], at joint angles (n,) [rad]."""
        if not self.has_varying_arm:
            return np.asarray(self.moment_arms @ np.asarray(q))
        return np.asarray(joint_excursions(self.arm_polynomials, self.joint_limits, q).sum(axis=-1))

    def with_moment_arms_at(self, q: ArrayLike) -> "DigitModel":
        """Return a copy of the digit with the moment arms at the joint angles (n,) [rad].

        If all moment arms are constant, return the digit itself.
        """
        if not self.has_varying_arm:
            return self
        arms = self.moment_arms_at(q)
        excursion_to_coordinates = np.linalg.pinv(arms @ self.coupling)
        return replace(
            self,
            moment_arms=arms,
            reduced_moment_arms=arms @ self.coupling,
            excursion_to_joints=self.coupling @ excursion_to_coordinates,
            torque_to_tension=excursion_to_coordinates.T @ self.coupling.T,
        )

    def coordinates_of_excursion(self, excursion: Array) -> Array:
        """Return the coordinates (n_c,) [rad] that belong to excursions (n_t,) [m] of the tendons, by least squares.

        If moment arms depend on the joint angle, Gauss-Newton steps find the coordinates. The first
        Gauss-Newton step begins in the middle of the range of each joint.
        """
        if not self.has_varying_arm:
            return np.asarray(self.joints_to_coordinates @ self.excursion_to_joints @ excursion)
        theta = self.joints_to_coordinates @ self.joint_limits.mean(axis=0)
        for _ in range(NEWTON_STEPS):
            q = self.coupling @ theta
            step = np.linalg.pinv(self.moment_arms_at(q) @ self.coupling) @ (
                excursion - self.excursion_at_angles(q)
            )
            theta = theta + step
            if np.abs(step).max() < NEWTON_TOLERANCE_RAD:
                break
        return np.asarray(theta)

    @property
    def joint_count(self) -> int:
        """Return n, the number of joints."""
        return len(self.lengths)

    def with_joint_angles(
        self, angle_of_joint: Mapping[int, float], present_angles: JointValues
    ) -> Array:
        """Return coordinates (n_c,) at which the given joints have their goal angles.

        If several coordinate vectors are possible, the result is the vector nearest to the present
        coordinates.

        The returned coordinates have the same unit as the arguments.

        If coupled joints cannot have all goal angles at the same time, the returned coordinates are
        a least-squares solution.

        Args:
            angle_of_joint: goal angles, by the index of the joint.
            present_angles: (n_c,) present coordinates. The change from the present to the returned
                coordinates has the smallest possible norm.
        """
        rows = self.coupling[list(angle_of_joint)]
        return np.asarray(
            present_angles
            + np.linalg.pinv(rows)
            @ (np.array(list(angle_of_joint.values())) - rows @ np.asarray(present_angles))
        )

    def with_gravity(self, gravity: JointValues) -> "DigitModel":
        """Return a copy of the digit with another gravitational acceleration, (3,) in the palm frame [m/s2]."""
        return replace(self, gravity=_read_only_copy(gravity))


def coordinate_range(coupling: Array, joint_limits: Array) -> Array:
    """Return the range of each coordinate (2, n_c).

    While a coordinate is within its range and all other coordinates are zero, all joints stay
    within their limits. A coordinate is limited only by the joints that it moves.

    Args:
        coupling: matrix B (n, n_c), see ``DigitModel``.
        joint_limits: (2, n) smallest and largest joint angles, in the unit of the returned ranges.
    """
    ranges = []
    for column in coupling.T:
        moves_joint = column != 0.0
        coordinate_limits = joint_limits[:, moves_joint] / column[moves_joint]
        # If an entry of B is negative, the lower limit of the joint gives the upper limit of the
        # coordinate.
        ranges.append(
            (
                coordinate_limits.min(axis=0).max(initial=-np.inf),
                coordinate_limits.max(axis=0).min(initial=np.inf),
            )
        )
    return np.array(ranges).T


def link_table(digit: Digit) -> Array:
    """Return the table (rigid_body.LINK_TABLE_ROW_COUNT, n) of a digit's links for ``rigid_body``."""
    table = np.zeros((body.LINK_TABLE_ROW_COUNT, len(digit.joints)))
    table[body.IS_PRISMATIC_ROW] = digit.is_prismatic
    armature = digit.joint_values("joint_armature_kg_m2")
    for i, axis in enumerate(joint_axes(digit)):
        position, rotation = link_placement(digit, i)
        axis_projection = np.outer(axis, axis)
        x, y, z = axis.tolist()
        cross_matrix = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        # Rodrigues' formula gives the rotation by an angle q about an axis a: a a^T + cos q (1 - a
        # a^T) + sin q [a]x. A prismatic joint does not rotate the link that it moves.
        link_matrices = (axis_projection, np.eye(3) - axis_projection, cross_matrix)
        if digit.is_prismatic[i]:
            link_matrices = (np.eye(3), np.zeros((3, 3)), np.zeros((3, 3)))
        rows = (body.FIXED_ROTATION_ROW, body.COSINE_ROTATION_ROW, body.SINE_ROTATION_ROW)
        for row, link_matrix in zip(rows, link_matrices, strict=True):
            table[row : row + 9, i] = (rotation @ link_matrix).ravel()
        mass = digit.link_mass_kg[i]
        com = centre_of_mass(digit, i)
        # Steiner's theorem converts the inertia from the centre of mass to the joint.
        moments = link_inertia(digit, i) + mass * (
            float(com @ com) * np.eye(3) - np.outer(com, com)
        )
        table[body.JOINT_ORIGIN_ROW : body.JOINT_ORIGIN_ROW + 3, i] = position
        table[body.JOINT_AXIS_ROW : body.JOINT_AXIS_ROW + 3, i] = axis
        table[body.LINK_MASS_ROW, i] = mass
        table[body.LINK_FIRST_MOMENT_ROW : body.LINK_FIRST_MOMENT_ROW + 3, i] = mass * com
        table[body.LINK_INERTIA_ROW : body.LINK_INERTIA_ROW + 6, i] = moments[
            (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
        ]
        table[body.JOINT_ARMATURE_ROW, i] = armature[i]
        table[body.LINK_LENGTH_ROW, i] = digit.link_length_m[i]
    return table


def base_rotation(hand: Hand, digit: Digit) -> Array:
    """Return the rotation (3, 3) from the frame of the link that carries a digit to the palm frame.

    The rotation is valid while all joints of the carrying digits are at zero.
    """
    if digit.mount_on is None:
        return np.eye(3)
    carrier = hand.digit_named(digit.mount_on)
    rotation = base_rotation(hand, carrier)
    for i in range(len(carrier.joints)):
        rotation = rotation @ link_placement(carrier, i)[1]
    return rotation


def _read_only_copy(values: ArrayLike) -> Array:
    """Return a read-only copy of an array."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array
