"""Equations of motion of a digit, computed with the compiled algorithms of ``rigid_body``.

tau = M(q) q'' + C(q, q') q' + g(q)    required = tau + K (q + preload) + D q'
"""

from collections.abc import Sequence

import numpy as np

from handctl.hand import rigid_body
from handctl.hand.digit import Array, DigitModel, JointValues

__all__ = [
    "DigitModel",
    "bias_torque",
    "damping_torque",
    "forward_dynamics",
    "gravity_torque",
    "inverse_dynamics",
    "kinetic_energy",
    "mass_matrix",
    "passive_torque",
    "potential_energy",
    "reduced_dynamics",
    "required_torque",
    "spring_energy",
    "spring_torque",
    "static_torque",
]

JointTorques = tuple[float, ...]
NO_GRAVITY = np.zeros(3)
"""Gravity of zero [m/s2]."""


def inverse_dynamics(
    digit: DigitModel, q: JointValues, dq: JointValues, ddq: JointValues
) -> JointTorques:
    """Return the joint torques that a motion requires because of inertia and weight: M q'' + C q' + g.

    The torques of return springs and damping are not included.

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        dq: joint rates (n,) [rad/s].
        ddq: joint accelerations (n,) [rad/s2].

    Returns:
        Joint torque (n,) [N m].
    """
    return _rigid_body_torque(digit, digit.gravity, q, dq, ddq)


def required_torque(
    digit: DigitModel, q: JointValues, dq: JointValues, ddq: JointValues
) -> JointTorques:
    """Return the joint torques (n,) that the tendons must exert for a motion [N m].

    The torque is the sum of inverse dynamics, spring torque and damping torque.
    """
    rigid_body_torque = _rigid_body_torque(digit, digit.gravity, q, dq, ddq)
    passive_parameters = zip(
        digit.spring_stiffness, digit.spring_preload, digit.joint_damping, strict=True
    )
    return tuple(
        [
            tau + stiffness * (angle + preload) + damping * rate
            for tau, angle, rate, (stiffness, preload, damping) in zip(
                rigid_body_torque,
                _as_plain_floats(q),
                _as_plain_floats(dq),
                passive_parameters,
                strict=True,
            )
        ]
    )


def bias_torque(digit: DigitModel, q: JointValues, dq: JointValues) -> JointTorques:
    """Return the joint torques (n,) of Coriolis and centrifugal forces, C q' [N m]."""
    return _rigid_body_torque(digit, NO_GRAVITY, q, dq, np.zeros(digit.joint_count))


def gravity_torque(digit: DigitModel, q: JointValues) -> JointTorques:
    """Return the joint torques (n,) that balance the weight of the links [N m]."""
    return tuple(
        rigid_body.weight_torques(
            digit.table, digit.parent, digit.gravity, _as_float_array(q)
        ).tolist()
    )


def spring_torque(digit: DigitModel, q: JointValues) -> JointTorques:
    """Return the joint torques (n,) that balance the return springs, k (q + preload) [N m]."""
    return tuple(
        stiffness * (angle + preload)
        for stiffness, angle, preload in zip(
            digit.spring_stiffness, _as_plain_floats(q), digit.spring_preload, strict=True
        )
    )


def damping_torque(digit: DigitModel, dq: JointValues) -> JointTorques:
    """Return the joint torques (n,) that balance the viscous damping of the joints [N m]."""
    return tuple(
        damping * rate
        for damping, rate in zip(digit.joint_damping, _as_plain_floats(dq), strict=True)
    )


def passive_torque(digit: DigitModel, q: JointValues, dq: JointValues) -> JointTorques:
    """Return the joint torques (n,) that balance return springs and viscous damping [N m]."""
    return tuple(
        a + b for a, b in zip(spring_torque(digit, q), damping_torque(digit, dq), strict=True)
    )


def static_torque(digit: DigitModel, q: JointValues) -> JointTorques:
    """Return the joint torques (n,) that hold the digit at rest against weight and return springs [N m]."""
    return tuple(
        a + b for a, b in zip(gravity_torque(digit, q), spring_torque(digit, q), strict=True)
    )


def mass_matrix(digit: DigitModel, q: JointValues) -> Array:
    """Return the mass matrix M (n, n) at given joint angles, including the armature of the joints [kg m2]."""
    return rigid_body.inertia_matrix(digit.table, digit.parent, _as_float_array(q))


def forward_dynamics(digit: DigitModel, q: JointValues, dq: JointValues, tau: JointValues) -> Array:
    """Return the joint accelerations (n,) that result from joint torques, inertia and weight [rad/s2].

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        dq: joint rates (n,) [rad/s].
        tau: (n,) joint torque of tendons and contact, minus ``passive_torque`` [N m].
    """
    bias_torque = inverse_dynamics(digit, q, dq, (0.0,) * digit.joint_count)
    return np.asarray(np.linalg.solve(mass_matrix(digit, q), np.subtract(tau, bias_torque)))


def reduced_dynamics(
    digit: DigitModel, theta: JointValues, dtheta: JointValues
) -> tuple[Array, Array]:
    """Return the reduced mass matrix M_r and bias torque h_r of a digit, in the digit's coordinates theta.

    The reduced mass matrix is M_r = B^T M B, and the bias torque is h_r = B^T (C q' + g + springs +
    damping). A motion of the digit requires the torque M_r theta'' + h_r in its coordinates.

    Args:
        digit: model of the digit.
        theta: coordinates (n_c,) of the digit [rad].
        dtheta: rates of the coordinates (n_c,) [rad/s].

    Returns:
        M_r (n_c, n_c) [kg m2] and h_r (n_c,) [N m].
    """
    coupling = digit.coupling
    q = (coupling @ theta).tolist()
    dq = (coupling @ dtheta).tolist()
    bias_torque = required_torque(digit, q, dq, (0.0,) * len(q))
    return coupling.T @ mass_matrix(digit, q) @ coupling, np.array(bias_torque) @ coupling


def kinetic_energy(digit: DigitModel, q: JointValues, dq: JointValues) -> float:
    """Return the kinetic energy of links and armature [J]."""
    rate = np.asarray(dq)
    return float(0.5 * rate @ mass_matrix(digit, q) @ rate)


def potential_energy(digit: DigitModel, q: JointValues) -> float:
    """Return the potential energy of the links' weight [J].

    The energy would be zero if all mass were at the mount of the digit.
    """
    first_link_pose = rigid_body.link_poses(digit.table, digit.parent, _as_float_array(q))[0]
    carried_mass_moment = first_link_pose[
        rigid_body.CARRIED_MOMENT_COLUMN : rigid_body.CARRIED_MOMENT_COLUMN + 3
    ]
    return -float(
        digit.gravity
        @ (
            carried_mass_moment
            - first_link_pose[rigid_body.CARRIED_MASS_COLUMN] * digit.mount_position
        )
    )


def spring_energy(digit: DigitModel, q: JointValues) -> float:
    """Return the energy stored in the return springs [J]."""
    spring_deflection = np.asarray(q) + digit.spring_preload
    return float(0.5 * np.asarray(digit.spring_stiffness) @ spring_deflection**2)


def _rigid_body_torque(
    digit: DigitModel, gravity: Array, q: JointValues, dq: JointValues, ddq: JointValues
) -> JointTorques:
    """Return the joint torque of inertia and weight under the given gravity, (n,) [N m]."""
    torque = rigid_body.rigid_body_torques(
        digit.table,
        digit.parent,
        gravity,
        _as_float_array(q),
        _as_float_array(dq),
        _as_float_array(ddq),
    )
    return tuple(torque.tolist())


def _as_float_array(values: JointValues) -> Array:
    """Return the values as a numpy array, for compiled code."""
    return np.asarray(values, dtype=np.float64)


def _as_plain_floats(values: JointValues) -> Sequence[float]:
    """Return the values as Python floats.

    Python code computes several times faster with Python floats than with numpy's scalars.
    """
    return values.tolist() if isinstance(values, np.ndarray) else values
