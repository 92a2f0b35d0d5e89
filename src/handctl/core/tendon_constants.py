"""Constants of a hand along its tendons.

The constants describe each tendon as an elastic connection of a motor mass and a load mass.

The spool has the radius r_a. The motor is a mass J_m / r_a^2 at the travel x = r_a theta_m. The
digit is a mass at the excursion s = R q. The tension between both masses is f = k (x - s - o) + c
(x' - s'), with the stretch offset o. Source: one-tendon finger in reduced coordinates (Tsai,
structure matrix), virtual work.
"""

from dataclasses import dataclass, fields

import numpy as np

from handctl.core.tick_types import Vector
from handctl.drives.protocol_registry import make_drive
from handctl.hand.description import Hand
from handctl.hand.dynamics import DigitModel
from handctl.hand.file.section_models import Motor
from handctl.hand.link_tree import LinkTree


@dataclass(frozen=True, slots=True)
class TendonConstants:
    """Names and constants of the N tendons of a hand, with shape (N,).

    The constants are in SI units along the tendon.

    Attributes:
        names: names of the tendons.
        motor_mass: rotor inertia J_m / r_a^2, converted to a mass at the tendon [kg].
        motor_damping: viscous friction of the motor b_m / r_a^2 [N s/m].
        coulomb_friction: Coulomb friction of the motor tau_c / r_a [N].
        stiffness: stiffness of the tendon [N/m].
        damping: damping of the tendon [N s/m].
        load_mass: mass of the half-closed digit, converted to the tendon [kg].
        load_stiffness: stiffness of the return springs, converted to the tendon [N/m].
        load_damping: damping of the joints, converted to the tendon [N s/m].
        spool_radius: radius of the spool [m].
        encoder_step: smallest measurable change of the motor position, converted to the tendon [m].
        tension_noise: standard deviation of a load-cell reading [N].
        has_cell: 1 for a tendon with a load cell, 0 for a tendon without a load cell.
    """

    names: tuple[str, ...]
    motor_mass: Vector
    motor_damping: Vector
    coulomb_friction: Vector
    stiffness: Vector
    damping: Vector
    load_mass: Vector
    load_stiffness: Vector
    load_damping: Vector
    spool_radius: Vector
    encoder_step: Vector
    tension_noise: Vector
    has_cell: Vector

    def constants_of_tendon(self, i: int) -> tuple[float, ...]:
        """Return all constants of tendon i.

        Tendons with equal constants get the same design of filters and control loops.
        """
        return tuple(
            float(getattr(self, field.name)[i]) for field in fields(self) if field.name != "names"
        )


def collect_tendon_constants(hand: Hand, digits: tuple[DigitModel, ...]) -> TendonConstants:
    """Collect the constants of all tendons of a hand.

    Args:
        hand: description of the hand.
        digits: digit models, in file order.
    """
    motors = {motor.name: motor for motor in hand.motor}
    tendons = hand.tendon
    spool = np.array([motors[tendon.motor].spool_radius_m for tendon in tendons])
    inertia = np.array([motors[tendon.motor].inertia_kg_m2 for tendon in tendons])
    # The mass matrix of the whole hand is used here, because it includes the fingers that a wrist
    # moves.
    mass = LinkTree.from_hand(hand, digits).mass_matrix(np.full(len(hand.joints), np.pi / 4))
    load = np.concatenate(
        [_load_along_tendons(digit, mass[digit.joints, digit.joints]) for digit in digits], axis=1
    )
    return TendonConstants(
        names=hand.tendon_names,
        motor_mass=inertia / spool**2,
        motor_damping=np.array([motors[tendon.motor].viscous_N_m_s_per_rad for tendon in tendons])
        / spool**2,
        coulomb_friction=np.array([motors[tendon.motor].coulomb_N_m for tendon in tendons]) / spool,
        # While both tendons of a spool pair are taut, both tendons resist a stretch.
        stiffness=np.array([tendon.stiffness_N_per_m for tendon in tendons])
        * np.where(hand.is_pair, 2.0, 1.0),
        damping=np.array([tendon.damping_N_s_per_m for tendon in tendons])
        * np.where(hand.is_pair, 2.0, 1.0),
        load_mass=load[0],
        load_stiffness=load[1],
        load_damping=load[2],
        spool_radius=spool,
        encoder_step=np.array([motor_position_step(motors[tendon.motor]) for tendon in tendons])
        * spool,
        tension_noise=np.full(len(tendons), hand.sensor_node.tension_noise_N),
        has_cell=hand.has_cell.astype(np.float64),
    )


def motor_position_step(motor: Motor) -> float:
    """Return the resolution of a motor's reported position [rad].

    The resolution follows from the protocol of the drive. The result is at least 1/65536 of the
    range of the position. A finer resolution would be below the noise of the position.
    """
    return max(2 * motor.position_range_rad / 0xFFFF, make_drive(motor, 0).position_step)


def _load_along_tendons(digit: DigitModel, mass_matrix: Vector) -> Vector:
    """Return the effective mass, stiffness and damping along each tendon of a digit, (3, n_t).

    Args:
        digit: model of the digit.
        mass_matrix: (n, n) mass matrix of the joints, with the digit half closed and with all links that
            it carries [kg m2].
    """
    coupling = digit.coupling
    joint_space = (
        mass_matrix,
        np.diag(digit.spring_stiffness),
        np.diag(digit.joint_damping),
    )
    torque_to_tension = np.linalg.pinv(digit.reduced_moment_arms)
    return np.array(
        [
            np.diag(torque_to_tension.T @ coupling.T @ matrix @ coupling @ torque_to_tension)
            for matrix in joint_space
        ]
    )
