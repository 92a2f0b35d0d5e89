"""Model of one digit: all numbers of kinematics, dynamics and statics, built from the description."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.hand.description import Hand
from handctl.hand.file.sections import Digit
from handctl.hand.link_bodies import centre_of_mass, inertia, rotation_rpy

Array = NDArray[np.float64]
Values = Sequence[float] | Array
"""One number per joint. Lists and tuples are fastest."""


class LinkConstants(NamedTuple):
    """Constants of the equations of motion of three links in a row, 0 for absent links.

    Attributes:
        j1: diagonal of the mass matrix in absolute angles, link 1 [kg m2].
        j2: diagonal, link 2 [kg m2].
        j3: diagonal, link 3 [kg m2].
        a: coupling of links 1 and 2 [kg m2].
        b: coupling of links 1 and 3 [kg m2].
        e: coupling of links 2 and 3 [kg m2].
        w1: first moment of the mass that turns with link 1 [kg m].
        w2: first moment, link 2 [kg m].
        w3: first moment, link 3 [kg m].
        r1: armature of joint 1 [kg m2].
        r2: armature of joint 2 [kg m2].
        r3: armature of joint 3 [kg m2].
    """

    j1: float
    j2: float
    j3: float
    a: float
    b: float
    e: float
    w1: float
    w2: float
    w3: float
    r1: float
    r2: float
    r3: float


@dataclass(frozen=True, slots=True, eq=False)
class DigitModel:
    """Digit with n joints, n_t tendons, and n_c reduced coordinates theta (q = B theta). Arrays are read-only.

    Attributes:
        name: name of the digit.
        joint_names: names of the joints, in order.
        tendon_names: names of the tendons, in order.
        joints: slice of the digit in the hand's joints.
        tendons: slice of the digit in the hand's tendons.
        lengths: (n,) [m].
        coms: (n,) distance of each link's centre of mass from its joint [m].
        masses: (n,) [kg].
        inertias: (n,) about the centre of mass [kg m2].
        radius: radius of the links [m].
        joint_min: (n,) [rad].
        joint_max: (n,) [rad].
        joint_damping: (n,) [N m s/rad].
        armature: (n,) inertia of the joint alone [kg m2].
        spring_stiffness: (n,) [N m/rad].
        spring_preload: (n,) [rad].
        mount_rotation: (3, 3) digit frame to palm frame.
        mount_position: (3,) [m] in the palm frame.
        gravity: (2,) in the digit's plane [m/s2].
        links: constants of the equations of motion.
        padding: zeros to extend n values to three.
        moment_arms: R, (n_t, n) [m].
        coupling: B, (n, n_c), the identity for independent joints.
        reduced_moment_arms: R B, (n_t, n_c) [m].
        excursion_to_joints: B (R B)^+, (n, n_t) [rad/m], joint angles of an excursion.
        torque_to_tension: (R B)^+^T B^T, (n_t, n) [1/m], smallest tensions of a torque.
        joints_to_coordinates: B^+, (n_c, n).
        friction: (n_t,) capstan coefficient.
        wrap: (n_t,) wrap angle before the first joint pulley [rad].
        motor_mass: (n_t,) rotor inertia as a mass at the tendon, J_m / r_a^2 [kg].
    """

    name: str
    joint_names: tuple[str, ...]
    tendon_names: tuple[str, ...]
    joints: slice
    tendons: slice
    lengths: tuple[float, ...]
    coms: tuple[float, ...]
    masses: tuple[float, ...]
    inertias: tuple[float, ...]
    radius: float
    joint_min: Array
    joint_max: Array
    joint_damping: tuple[float, ...]
    armature: tuple[float, ...]
    spring_stiffness: tuple[float, ...]
    spring_preload: tuple[float, ...]
    mount_rotation: Array
    mount_position: Array
    gravity: tuple[float, float]
    links: LinkConstants
    padding: tuple[float, ...]
    moment_arms: Array
    coupling: Array
    reduced_moment_arms: Array
    excursion_to_joints: Array
    torque_to_tension: Array
    joints_to_coordinates: Array
    friction: Array
    wrap: Array
    motor_mass: Array

    @property
    def reach(self) -> tuple[Array, Array]:
        """Return the smallest and the largest coordinates (n_c,) within the joint limits [rad]."""
        # A negative entry of B^+ swaps the limits: take the smaller and the larger product per entry.
        low = self.joints_to_coordinates * self.joint_min
        high = self.joints_to_coordinates * self.joint_max
        return np.minimum(low, high).sum(axis=1), np.maximum(low, high).sum(axis=1)

    @staticmethod
    def of(hand: Hand, name: str) -> "DigitModel":
        """Build the model of one digit of a hand, by the digit's name."""
        digit = hand.digit_named(name)
        joints = hand.digit_joints[name]
        tendons = hand.digit_tendons[name]
        motors = [hand.motor_of(tendon.name) for tendon in hand.tendon[tendons]]
        rotation = rotation_rpy(*np.radians(digit.mount_rpy_deg))
        arms = hand.moment_arms[:, joints][tendons]
        coupling = np.eye(len(digit.joints)) if digit.coupling is None else np.array(digit.coupling)
        # Pseudo-inverse: least squares for angles, its transpose the least-norm tensions.
        to_coordinates = np.linalg.pinv(arms @ coupling)
        return DigitModel(
            name=name,
            joint_names=digit.joints,
            tendon_names=hand.tendon_names[tendons],
            joints=joints,
            tendons=tendons,
            lengths=digit.link_length_m,
            coms=tuple(float(centre_of_mass(digit, i)[0]) for i in range(len(digit.joints))),
            masses=digit.link_mass_kg,
            inertias=tuple(float(inertia(digit, i)[2, 2]) for i in range(len(digit.joints))),
            radius=digit.link_radius_m,
            joint_min=_constant(np.radians(digit.joint_min_deg)),
            joint_max=_constant(np.radians(digit.joint_max_deg)),
            joint_damping=digit.joint_damping_N_m_s_per_rad,
            armature=digit.joint_armature_kg_m2,
            spring_stiffness=digit.spring_stiffness_N_m_per_rad,
            spring_preload=digit.spring_preload_rad,
            mount_rotation=_constant(rotation),
            mount_position=_constant(digit.mount_position_m),
            gravity=_in_plane(rotation, hand.mount.gravity_m_s2),
            links=link_constants(digit),
            padding=(0.0,) * (3 - len(digit.joints)),
            moment_arms=_constant(arms),
            coupling=_constant(coupling),
            reduced_moment_arms=_constant(arms @ coupling),
            excursion_to_joints=_constant(coupling @ to_coordinates),
            torque_to_tension=_constant(to_coordinates.T @ coupling.T),
            joints_to_coordinates=_constant(np.linalg.pinv(coupling)),
            friction=_constant([tendon.friction_coefficient for tendon in hand.tendon[tendons]]),
            wrap=_constant([tendon.wrap_angle_rad for tendon in hand.tendon[tendons]]),
            motor_mass=_constant([motor.inertia_kg_m2 / motor.spool_radius_m**2 for motor in motors]),
        )

    @property
    def joint_count(self) -> int:
        """Return n, the number of joints."""
        return len(self.lengths)

    def with_gravity(self, gravity: Values) -> "DigitModel":
        """Return the digit under another gravity, (3,) in the palm frame [m/s2]."""
        return replace(self, gravity=_in_plane(self.mount_rotation, gravity))


def link_constants(digit: Digit) -> LinkConstants:
    """Compute the constants of the equations of motion.

    An absent link has no mass and no length. Source: Hussain & Suhaib, closed form of section 7,
    corrected.
    """
    absent = (0.0,) * (3 - len(digit.link_length_m))
    l1, l2, _ = (*digit.link_length_m, *absent)
    d1, d2, d3 = (*(float(centre_of_mass(digit, i)[0]) for i in range(len(digit.joints))), *absent)
    m1, m2, m3 = (*digit.link_mass_kg, *absent)
    i1, i2, i3 = (*(float(inertia(digit, i)[2, 2]) for i in range(len(digit.joints))), *absent)
    r1, r2, r3 = (*digit.joint_armature_kg_m2, *absent)
    return LinkConstants(
        j1=i1 + m1 * d1**2 + (m2 + m3) * l1**2,
        j2=i2 + m2 * d2**2 + m3 * l2**2,
        j3=i3 + m3 * d3**2,
        a=(m2 * d2 + m3 * l2) * l1,
        b=m3 * l1 * d3,
        e=m3 * l2 * d3,
        w1=m1 * d1 + (m2 + m3) * l1,
        w2=m2 * d2 + m3 * l2,
        w3=m3 * d3,
        r1=r1,
        r2=r2,
        r3=r3,
    )


def _in_plane(rotation: Array, gravity: Values) -> tuple[float, float]:
    """Project gravity of the palm frame on the digit's plane."""
    x, y, _ = (rotation.T @ np.asarray(gravity, dtype=float)).tolist()
    return x, y


def _constant(values: Values) -> Array:
    """Return a read-only copy."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array
