"""Equations of motion of a digit, in closed form.

The equations use absolute link angles, theta_i = q_1 + .. + q_i, where they are shortest. Virtual
work maps them to joint angles: tau = S^T T with theta = S q, S lower triangular of ones. Joint
armature adds r_i q_i''. With c_ij = cos(theta_i - theta_j), s_ij = sin(theta_i - theta_j):

    T_1 = j_1 th_1'' + a c_12 th_2'' + b c_13 th_3'' + a s_12 th_2'^2 + b s_13 th_3'^2 + gravity
    T_2 = j_2 th_2'' + a c_12 th_1'' + e c_23 th_3'' - a s_12 th_1'^2 + e s_23 th_3'^2 + gravity
    T_3 = j_3 th_3'' + b c_13 th_1'' + e c_23 th_2'' - b s_13 th_1'^2 - e s_23 th_2'^2 + gravity

Source: Hussain & Suhaib, Eq. 7-12, corrected. The functions use plain floats, since a control tick
evaluates them for every digit.
"""

from collections.abc import Sequence
from math import cos, sin

import numpy as np

from handctl.compiled import kernel
from handctl.hand.digit import Array, DigitModel, Values

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

Torque = tuple[float, ...]
NO_GRAVITY = (0.0, 0.0)
"""Gravity of zero in the digit's plane [m/s2]."""


def inverse_dynamics(digit: DigitModel, q: Values, dq: Values, ddq: Values) -> Torque:
    """Return the joint torque of inertia and weight, M q'' + C q' + g, without springs and damping.

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        dq: joint rates (n,) [rad/s].
        ddq: joint accelerations (n,) [rad/s2].

    Returns:
        (n,) [N m].
    """
    return _newton(digit, digit.gravity, _three(digit, q), _three(digit, dq), _three(digit, ddq))


def required_torque(digit: DigitModel, q: Values, dq: Values, ddq: Values) -> Torque:
    """Return the joint torque of tendons for a motion: inverse dynamics, springs, damping, (n,) [N m]."""
    angles = _three(digit, q)
    rates = _three(digit, dq)
    rigid = _newton(digit, digit.gravity, angles, rates, _three(digit, ddq))
    passive = zip(digit.spring_stiffness, digit.spring_preload, digit.joint_damping, strict=True)
    return tuple(
        [
            tau + stiffness * (angle + preload) + damping * rate
            for tau, angle, rate, (stiffness, preload, damping) in zip(rigid, angles, rates, passive, strict=False)
        ]
    )


def bias_torque(digit: DigitModel, q: Values, dq: Values) -> Torque:
    """Return the Coriolis and centrifugal torque C q', (n,) [N m]."""
    return _newton(digit, NO_GRAVITY, _three(digit, q), _three(digit, dq), (0.0, 0.0, 0.0))


def gravity_torque(digit: DigitModel, q: Values) -> Torque:
    """Return the joint torque that balances the weight of the links, (n,) [N m]."""
    w1, w2, w3 = digit.links[6:9]
    gx, gy = digit.gravity
    q1, q2, q3 = _three(digit, q)
    t2 = q1 + q2
    t3 = t2 + q3
    g3 = w3 * (gx * sin(t3) - gy * cos(t3))
    g2 = w2 * (gx * sin(t2) - gy * cos(t2)) + g3
    g1 = w1 * (gx * sin(q1) - gy * cos(q1)) + g2
    return _existing(digit, (g1, g2, g3))


def spring_torque(digit: DigitModel, q: Values) -> Torque:
    """Return the joint torque that balances the return springs, k (q + preload), (n,) [N m]."""
    return tuple(
        stiffness * (angle + preload)
        for stiffness, angle, preload in zip(digit.spring_stiffness, _floats(q), digit.spring_preload, strict=True)
    )


def damping_torque(digit: DigitModel, dq: Values) -> Torque:
    """Return the joint torque that balances viscous damping, (n,) [N m]."""
    return tuple(damping * rate for damping, rate in zip(digit.joint_damping, _floats(dq), strict=True))


def passive_torque(digit: DigitModel, q: Values, dq: Values) -> Torque:
    """Return the joint torque that balances springs and damping, (n,) [N m]."""
    return tuple(a + b for a, b in zip(spring_torque(digit, q), damping_torque(digit, dq), strict=True))


def static_torque(digit: DigitModel, q: Values) -> Torque:
    """Return the joint torque that holds the digit at rest: gravity and springs, (n,) [N m]."""
    return tuple(a + b for a, b in zip(gravity_torque(digit, q), spring_torque(digit, q), strict=True))


def mass_matrix(digit: DigitModel, q: Values) -> Array:
    """Return M in joint angles with armature, (n, n) [kg m2]."""
    j1, j2, j3, a, b, e = digit.links[:6]
    _, q2, q3 = _three(digit, q)
    # S^T M S of the absolute mass matrix, summed from the last link: no matrix product.
    a *= cos(q2)
    b *= cos(q2 + q3)
    e *= cos(q3)
    m33 = j3
    m23 = j3 + e
    m13 = m23 + b
    m22 = j2 + e + m23
    m12 = j2 + a + e + m13
    m11 = j1 + a + b + m12
    n = len(digit.lengths)
    r1, r2, r3 = digit.links[9:]
    return np.array([[m11 + r1, m12, m13], [m12, m22 + r2, m23], [m13, m23, m33 + r3]])[:n, :n]


def forward_dynamics(digit: DigitModel, q: Values, dq: Values, tau: Values) -> Array:
    """Return the acceleration of a joint torque against inertia and weight, (n,) [rad/s2].

    Args:
        digit: model of the digit.
        q: joint angles (n,) [rad].
        dq: joint rates (n,) [rad/s].
        tau: torque of tendons and contact, less ``passive_torque`` (n,) [N m].
    """
    standing = inverse_dynamics(digit, q, dq, (0.0,) * digit.joint_count)
    return np.asarray(np.linalg.solve(mass_matrix(digit, q), np.subtract(tau, standing)))


def reduced_dynamics(digit: DigitModel, theta: Values, dtheta: Values) -> tuple[Array, Array]:
    """Return M_r = B^T M B and h_r = B^T (C q' + g + springs + damping).

    Torque in reduced coordinates is M_r theta'' + h_r.

    Args:
        digit: model of the digit.
        theta: reduced coordinates (n_c,) [rad].
        dtheta: rates (n_c,) [rad/s].

    Returns:
        M_r (n_c, n_c) [kg m2] and h_r (n_c,) [N m].
    """
    coupling = digit.coupling
    q = (coupling @ theta).tolist()
    dq = (coupling @ dtheta).tolist()
    standing = required_torque(digit, q, dq, (0.0,) * len(q))
    return coupling.T @ mass_matrix(digit, q) @ coupling, np.array(standing) @ coupling


def kinetic_energy(digit: DigitModel, q: Values, dq: Values) -> float:
    """Return the kinetic energy of links and armature [J]."""
    rate = np.asarray(dq)
    return float(0.5 * rate @ mass_matrix(digit, q) @ rate)


def potential_energy(digit: DigitModel, q: Values) -> float:
    """Return the potential energy of the links' weight [J].

    Zero is the energy of all mass at the digit's mount.
    """
    gx, gy = digit.gravity
    angles = np.cumsum(q).tolist()
    moments = digit.links[6 : 6 + digit.joint_count]
    return -sum(w * (gx * cos(t) + gy * sin(t)) for w, t in zip(moments, angles, strict=True))


def spring_energy(digit: DigitModel, q: Values) -> float:
    """Return the energy stored in the return springs [J]."""
    stretched = np.asarray(q) + digit.spring_preload
    return float(0.5 * np.asarray(digit.spring_stiffness) @ stretched**2)


Three = tuple[float, float, float]


def _newton(digit: DigitModel, gravity: tuple[float, float], q: Three, dq: Three, ddq: Three) -> Torque:
    """Evaluate the module's equations for a digit. Absent links have zero constants."""
    return _existing(digit, newton(*digit.links, *gravity, *q, *dq, *ddq))


@kernel(*["real"] * 23)
def newton(  # noqa: PLR0913 - flat numbers, so that kernels of the tick call it as well
    j1: float,
    j2: float,
    j3: float,
    a: float,
    b: float,
    e: float,
    w1: float,
    w2: float,
    w3: float,
    r1: float,
    r2: float,
    r3: float,
    gx: float,
    gy: float,
    q1: float,
    q2: float,
    q3: float,
    dq1: float,
    dq2: float,
    dq3: float,
    ddq1: float,
    ddq2: float,
    ddq3: float,
) -> Three:
    """Return the joint torques of three links [N m], see the module's equations.

    Args:
        j1: diagonal of the mass matrix, link 1 [kg m2], 0 for an absent link.
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
        gx: gravity along x of the digit's plane [m/s2].
        gy: gravity along y [m/s2].
        q1: angle of joint 1 [rad].
        q2: angle of joint 2 [rad].
        q3: angle of joint 3 [rad].
        dq1: rate of joint 1 [rad/s].
        dq2: rate of joint 2 [rad/s].
        dq3: rate of joint 3 [rad/s].
        ddq1: acceleration of joint 1 [rad/s2].
        ddq2: acceleration of joint 2 [rad/s2].
        ddq3: acceleration of joint 3 [rad/s2].
    """
    # Absolute angles t, absolute rates v, absolute accelerations a: sums over the joints.
    t2 = q1 + q2
    q23 = q2 + q3
    t3 = t2 + q3
    v2 = dq2 + dq1
    v3 = dq3 + v2
    a2 = ddq1 + ddq2
    a3 = a2 + ddq3
    a_c = a * cos(q2)
    b_c = b * cos(q23)
    e_c = e * cos(q3)
    a_s = a * sin(q2)
    b_s = b * sin(q23)
    e_s = e * sin(q3)
    s1 = dq1 * dq1
    s2 = v2 * v2
    s3 = v3 * v3
    g1 = w1 * (gx * sin(q1) - gy * cos(q1))
    g2 = w2 * (gx * sin(t2) - gy * cos(t2))
    g3 = w3 * (gx * sin(t3) - gy * cos(t3))
    # T_i of the module's equations, summed from the tip: tau_i = T_i + tau_(i+1) is S^T T.
    tau3 = j3 * a3 + b_c * ddq1 + e_c * a2 + b_s * s1 + e_s * s2 + g3
    tau2 = j2 * a2 + a_c * ddq1 + e_c * a3 + a_s * s1 - e_s * s3 + g2 + tau3
    tau1 = j1 * ddq1 + a_c * a2 + b_c * a3 - a_s * s2 - b_s * s3 + g1 + tau2
    return tau1 + r1 * ddq1, tau2 + r2 * ddq2, tau3 + r3 * ddq3


def _three(digit: DigitModel, values: Values) -> Three:
    """Return the values of the digit's joints as floats, 0 for joints missing up to three."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    x, y, z = (*values, *digit.padding) if digit.padding else values
    return x, y, z


def _existing(digit: DigitModel, values: Three) -> Torque:
    """Return the values that belong to joints of the digit."""
    return values[: len(digit.lengths)] if digit.padding else values


def _floats(values: Values) -> Sequence[float]:
    """Return plain floats, several times faster than numpy's scalars."""
    return values.tolist() if isinstance(values, np.ndarray) else values
