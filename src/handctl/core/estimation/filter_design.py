"""Discrete model and steady-state Kalman gains of the tension filter, once, before arming.

Per tendon the state is [x, v, s, w, d, e, o]: cable travel [m] and speed [m/s] at the spool, excursion [m] and its
rate [m/s], Gauss-Markov disturbance force on the motor [N], load-cell error [N], stretch offset [m]. Inputs: motor
force at the cable [N], rate at which the tension of a moving digit is meant to change [N/s]. Measurements: encoder
travel [m], load cell [N], excursion from joint encoders [m].

The digit itself is not in the model. It is twenty times lighter than the rotor, sits on a stiff rope and rubs on its
pulleys with up to a third of the tension, in a direction that hangs on the sign of a speed of micrometres a second: a
filter that predicts it by its equation of motion chatters between the two signs (9 N instead of 0.5 N). What is known
and enough is that a free digit follows its rope and that the tension then changes slowly, that a held one stays.
Source: linearised tendon plant; van Loan (1978) for the discretisation; the Riccati solution comes from ``control``.
"""

import math
from dataclasses import fields

import numpy as np
from scipy.linalg import expm

from handctl.core.deferred_stats import deferred_stats
from handctl.core.estimation.filter_stack import (
    INPUTS,
    MEASUREMENTS,
    STATES,
    Block,
    D,
    E,
    FilterDesign,
    Matrix,
    O,
    Regime,
    S,
    V,
    W,
    X,
)
from handctl.core.gains.gains import FilterGains
from handctl.core.gains.solvable import check_finite, solvable
from handctl.core.tendon_space import TendonSpace

FORGET_S = 1e4
"""Stretch offset and a held digit's excursion are forgotten this slowly [s]: only so that the Riccati equation has a
solution. What is forgotten within a run pulls the estimate: a millimetre of offset in a minute is 1.7 N a second."""

DOUBTED_DISTURBANCE, DOUBTED_HELD_DISTURBANCE = 5.0, 2.0
"""Factors on the motor's disturbance of a tendon in doubt: friction at the motor is not as the hand file tells."""
DOUBTED_WALK, DOUBTED_HELD_WALK = 8.0, 3.0
"""Random walk of the tension of a tendon in doubt [N/s^0.5]: friction at the joints is not either."""
DOUBTED_PLAN = 0.25
"""Fraction of the planned change of tension that is expected of a tendon in doubt."""
TAUT = (Regime.FREE, Regime.HELD)
"""Regimes of which there is a block in doubt, in their order; slack comes after them."""


def design_filter(space: TendonSpace, gains: FilterGains, period: float, joint_period: Matrix) -> FilterDesign:
    """Design the filter of each tendon in each regime; tendons that are alike share theirs.

    Args:
        space: the hand along its tendons.
        gains: noise intensities assumed.
        period: control period [s].
        joint_period: (N,) from one excursion measured by joint encoders to the next [s]; inf where there are none.

    Raises:
        ConfigError: no filter follows from these gains.
    """
    made: dict[tuple[float, ...], tuple[Block, ...]] = {}
    found = []
    for i, joints in enumerate(joint_period.tolist()):
        kind = (joints, *(float(getattr(space, each.name)[i]) for each in fields(space)))
        if kind not in made:
            with solvable("filter"):
                usual = tuple(_block(space, i, (regime, False), gains, period, joints) for regime in Regime)
                doubted = (_block(space, i, (regime, True), gains, period, joints) for regime in TAUT)
                made[kind] = (*usual, *doubted, usual[Regime.SLACK])  # nothing is in doubt without tension
        found.append(made[kind])
    return FilterDesign(tuple(found))


def _continuous(space: TendonSpace, i: int, regime: Regime, gains: FilterGains) -> tuple[Matrix, Matrix, Matrix]:
    """A (7, 7), B (7, 2) and the tension row (7,) of one tendon."""
    taut = regime != Regime.SLACK
    k, c = (space.stiffness[i], space.damping[i]) if taut else (0.0, 0.0)
    tension = np.array([k, c, -k, -c, 0.0, 0.0, -k])
    A, B = np.zeros((STATES, STATES)), np.zeros((STATES, INPUTS))
    A[X, V] = A[S, W] = 1.0
    A[V] = -tension / space.motor_mass[i]
    A[V, V] -= space.motor_damping[i] / space.motor_mass[i]
    A[V, D] = B[V, 0] = 1.0 / space.motor_mass[i]
    if regime == Regime.FREE:
        A[W], B[W] = A[V], B[V]
        A[W, V] += 1.0 / gains.free_time_s
        A[W, W] -= 1.0 / gains.free_time_s
        B[S, 1] = -1.0 / space.stiffness[i]
    else:
        A[W, W] = -1.0 / gains.held_time_s
        A[S, S] = -1.0 / FORGET_S
    A[D, D] = -1.0 / _motor_noise(regime, gains)[1]
    A[E, E] = A[O, O] = -1.0 / FORGET_S
    return A, B, tension


def _motor_noise(regime: Regime, gains: FilterGains) -> tuple[float, float, float]:
    """What acts on the motor unknown: disturbance [N], its correlation time [s], and noise on its force [N]."""
    if regime == Regime.HELD:
        return gains.held_disturbance_N, gains.held_disturbance_time_s, gains.held_acceleration_noise_N
    return gains.motor_disturbance_N, gains.motor_disturbance_time_s, gains.motor_acceleration_noise_N


def _intensity(space: TendonSpace, i: int, regime: Regime, gains: FilterGains) -> Matrix:
    """Continuous process noise of one tendon, (7, 7): 2 sigma^2 / tau of each Gauss-Markov state, little on speeds."""
    Q = np.zeros((STATES, STATES))
    disturbance, time, jerk = _motor_noise(regime, gains)
    Q[V, V] = jerk**2 / space.motor_mass[i] ** 2
    if regime == Regime.FREE:
        rate = gains.free_rate_N_per_s / space.stiffness[i]
        Q[V, W] = Q[W, V] = Q[V, V]
        Q[W, W] = Q[V, V] + 2.0 * rate**2 / gains.free_time_s
    else:
        Q[W, W] = 2.0 * gains.held_speed_m_s**2 / gains.held_time_s
    Q[D, D] = 2.0 * disturbance**2 / time
    Q[E, E] = gains.cell_drift_N**2 / gains.cell_drift_time_s
    Q[O, O] = 2.0 * gains.offset_m**2 / gains.offset_time_s
    return Q


def _doubt(Q: Matrix, stiffness: float, regime: Regime) -> None:
    """Add to the continuous process noise (7, 7) of a taut tendon what a model in doubt lacks; stiffness in [N/m]."""
    free = regime == Regime.FREE
    Q[D, D] *= (DOUBTED_DISTURBANCE if free else DOUBTED_HELD_DISTURBANCE) ** 2
    Q[S, S] += ((DOUBTED_WALK if free else DOUBTED_HELD_WALK) / stiffness) ** 2


def _discretise(A: Matrix, B: Matrix, Q: Matrix, period: float) -> tuple[Matrix, Matrix, Matrix]:
    """Zero-order hold of A, B and the discrete covariance of continuous noise Q. Source: van Loan (1978)."""
    n, m = B.shape
    held = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * period)
    loan = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * period)
    F = held[:n, :n]
    noise = loan[n:, n:].T @ loan[:n, n:]
    return F, held[:n, n:], (noise + noise.T) / 2


def _block(
    space: TendonSpace, i: int, kind: tuple[Regime, bool], gains: FilterGains, period: float, joint_period: float
) -> Block:
    """One tendon in one regime, in doubt or not.

    The load cell's error is estimated only where tension is known, in slack; elsewhere nothing tells it from tension:
    it is kept as it is, its growth counts in the variance, and the gains are those of a filter that does not know it.
    Source: Schmidt (1966), consider states.

    Encoder and load cell know the sum of excursion and offset only; joint encoders, where there are any, part the two
    at their own pace and touch nothing else, so that the filter is the same with and without them.
    """
    regime, doubted = kind
    A, B, tension = _continuous(space, i, regime, gains)
    intensity = _intensity(space, i, regime, gains)
    if doubted:
        _doubt(intensity, float(space.stiffness[i]), regime)
        B[:, 1] *= DOUBTED_PLAN
    F, held, Q = _discretise(A, B, intensity, period)
    H = np.zeros((MEASUREMENTS, STATES))
    H[0, X] = 1.0
    H[1] = tension
    H[2, S] = 1.0
    known = regime == Regime.SLACK
    H[1, E] = float(known)
    noise = np.array([space.encoder_step[i] * gains.encoder_noise_counts, space.tension_noise[i]])
    P = _riccati(F, H[:2], Q, np.diag(noise**2))
    innovation = H[:2] @ P @ H[:2].T + np.diag(noise**2)
    K = np.zeros((STATES, MEASUREMENTS))
    K[:, :2] = np.linalg.solve(innovation, H[:2] @ P).T
    K[E] *= known
    H[1, E] = 1.0
    K[S, 2] = 1.0 - math.exp(-joint_period / gains.joint_time_s) if math.isfinite(joint_period) else 0.0
    K[O, 2] = -K[S, 2]
    drift = 0.0 if known else gains.cell_drift_N**2 / gains.cell_drift_time_s * gains.cell_tared_s
    variance = float(tension @ P @ tension) + drift  # without tension, in slack, nothing
    information = np.asarray(np.linalg.inv(innovation), dtype=np.float64)
    sigma = math.sqrt(innovation[1, 1])
    check_finite(F, held, K, P, information)
    return Block(F, held, H, K, Q, noise**2, P, known, drift, tension, variance, information, sigma)


def _riccati(F: Matrix, H: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """Covariance of the prediction in steady state, solved in units in which the states are of the order of one."""
    with deferred_stats():
        from control import dlqe

    scale = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1.0, 0.1, 1e-5])
    rows = 1.0 / np.sqrt(np.diag(R))
    _, P, _ = dlqe(
        F * scale / scale[:, None],
        np.eye(STATES),
        H * scale * rows[:, None],
        Q / np.outer(scale, scale),
        np.eye(len(rows)),
        method="scipy",
    )
    return np.asarray(P) * np.outer(scale, scale)
