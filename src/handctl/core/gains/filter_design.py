"""Discrete model and steady-state Kalman gains of the tension filter, once, before arming.

Per tendon the state is [x, v, s, w, d, e, o]: tendon travel [m] and speed [m/s] at the spool,
excursion [m] and its rate [m/s], Gauss-Markov disturbance force on the motor [N], load-cell error
[N], stretch offset [m]. Inputs: motor force at the tendon [N], planned rate of change of a moving
digit's tension [N/s]. Measurements: encoder travel [m], load cell [N], excursion from joint
encoders [m].

The model does not contain the digit itself. The digit is twenty times lighter than the rotor, is
held by a stiff tendon, and has friction at the pulleys of up to a third of the tension. The
direction of friction depends on the sign of a speed of micrometres per second. A filter with the
digit's equation of motion chatters between both signs (9 N instead of 0.5 N). The assumptions
suffice: a free digit follows the tendon with slowly changing tension, a held digit stays.
Source: linearised tendon plant, van Loan (1978) for the discretisation. The Riccati solution comes
from ``control``.
"""

import math

import numpy as np

from handctl.core.deferred_imports import deferred_imports
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
from handctl.core.gains.riccati import solve_covariance
from handctl.core.gains.solvable import finite_or_error, solver_failures_as_errors
from handctl.core.tendon_space import TendonSpace

with deferred_imports():
    from scipy.linalg import expm

FORGET_S = 1e4
"""Time constant of forgetting stretch offset and excursion of a held digit, for a solution of the Riccati equation [s].

Faster forgetting pulls the estimate: a millimetre of offset in a minute is 1.7 N per second.
"""

DOUBTED_DISTURBANCE = 5.0
"""Factor on the motor disturbance of a doubted tendon: the motor's friction differs from the hand file."""
DOUBTED_HELD_DISTURBANCE = 2.0
"""Factor on the motor disturbance of a doubted tendon that is held."""
DOUBTED_WALK = 8.0
"""Random walk of the tension of a doubted tendon [N/s^0.5]: the joints' friction differs as well."""
DOUBTED_HELD_WALK = 3.0
"""Random walk of the tension of a doubted tendon that is held [N/s^0.5]."""
DOUBTED_PLAN = 0.25
"""Fraction of the planned change of tension expected of a doubted tendon."""
BLIND_FRICTION = 0.6
"""Standard deviation of a motor's friction as a fraction of the Coulomb friction, for tendons without load cell.

Between the two directions of motion friction may have any value: 1 / sqrt(3) for an equal distribution.
"""
BLIND_TIME_S = 0.3
"""Correlation time of this friction [s]: the motor rests and moves as the digit does."""
TAUT_REGIMES = (Regime.FREE, Regime.HELD)
"""Regimes with a block for doubt, in order. Slack follows after them."""


def design_filter(space: TendonSpace, gains: FilterGains, period: float, joint_period: Matrix) -> FilterDesign:
    """Design the filter of each tendon in each regime. Equal tendons share a design.

    Args:
        space: the hand along the tendons.
        gains: noise intensities assumed.
        period: control period [s].
        joint_period: (N,) time between excursions measured by joint encoders [s], inf without
            encoders.

    Raises:
        ConfigError: if the gains lead to no filter.
    """
    made: dict[tuple[float, ...], tuple[Block, ...]] = {}
    found = []
    for i, joints in enumerate(joint_period.tolist()):
        kind = (joints, *space.numbers_of(i))
        if kind not in made:
            with solver_failures_as_errors("filter"):
                certain = tuple(_design_block(space, i, (regime, False), gains, period, joints) for regime in Regime)
                doubted = (_design_block(space, i, (regime, True), gains, period, joints) for regime in TAUT_REGIMES)
                made[kind] = (*certain, *doubted, certain[Regime.SLACK])  # nothing is in doubt without tension
        found.append(made[kind])
    return FilterDesign(tuple(found))


def _continuous_model(space: TendonSpace, i: int, regime: Regime, gains: FilterGains) -> tuple[Matrix, Matrix, Matrix]:
    """Return A (7, 7), B (7, 2) and the tension row (7,) of a tendon."""
    taut = regime != Regime.SLACK
    k, c = (space.stiffness[i], space.damping[i]) if taut else (0.0, 0.0)
    tension = np.array([k, c, -k, -c, 0.0, 0.0, -k])
    A = np.zeros((STATES, STATES))
    B = np.zeros((STATES, INPUTS))
    A[X, V] = A[S, W] = 1.0
    A[V] = -tension / space.motor_mass[i]
    A[V, V] -= space.motor_damping[i] / space.motor_mass[i]
    A[V, D] = B[V, 0] = 1.0 / space.motor_mass[i]
    if regime == Regime.FREE:
        # A free digit follows the rotor: its rate has the rotor's acceleration, and decays to the rotor's speed.
        A[W] = A[V]
        B[W] = B[V]
        A[W, V] += 1.0 / gains.free_time_s
        A[W, W] -= 1.0 / gains.free_time_s
        # Rising tension stretches the tendon, so the excursion falls behind the travel.
        B[S, 1] = -1.0 / space.stiffness[i]
    else:
        A[W, W] = -1.0 / gains.held_time_s
        A[S, S] = -1.0 / FORGET_S
    time = _motor_noise(regime, gains)[1]
    A[D, D] = -1.0 / (time if space.has_cell[i] else max(time, BLIND_TIME_S))
    A[E, E] = A[O, O] = -1.0 / FORGET_S
    return A, B, tension


def _motor_noise(regime: Regime, gains: FilterGains) -> tuple[float, float, float]:
    """Return the disturbance on the motor [N], the correlation time [s], and the noise of the motor force [N]."""
    if regime == Regime.HELD:
        return gains.held_disturbance_N, gains.held_disturbance_time_s, gains.held_acceleration_noise_N
    return gains.motor_disturbance_N, gains.motor_disturbance_time_s, gains.motor_acceleration_noise_N


def _process_noise(space: TendonSpace, i: int, regime: Regime, gains: FilterGains) -> Matrix:
    """Return the continuous process noise (7, 7) of a tendon.

    The noise is 2 sigma^2 / tau of each Gauss-Markov state, and little on speeds.
    """
    Q = np.zeros((STATES, STATES))
    disturbance, time, jerk = _motor_noise(regime, gains)
    if not space.has_cell[i]:
        # Without load cell the tension is the motor force less friction, so friction is its error.
        disturbance = math.hypot(disturbance, BLIND_FRICTION * space.coulomb[i])
        time = max(time, BLIND_TIME_S)
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


def _add_doubt_noise(Q: Matrix, stiffness: float, regime: Regime) -> None:
    """Add the noise of a doubted model to the continuous process noise (7, 7) of a taut tendon, stiffness in [N/m]."""
    free = regime == Regime.FREE
    Q[D, D] *= (DOUBTED_DISTURBANCE if free else DOUBTED_HELD_DISTURBANCE) ** 2
    Q[S, S] += ((DOUBTED_WALK if free else DOUBTED_HELD_WALK) / stiffness) ** 2


def _discretise(A: Matrix, B: Matrix, Q: Matrix, period: float) -> tuple[Matrix, Matrix, Matrix]:
    """Return zero-order hold of A, B and the discrete covariance of continuous noise Q. Source: van Loan (1978)."""
    n, m = B.shape
    # Zero-order hold: exp([[A, B], [0, 0]] T) = [[F, G], [0, I]].
    held = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * period)
    loan = expm(np.block([[-A, Q], [np.zeros((n, n)), A.T]]) * period)
    F = held[:n, :n]
    noise = loan[n:, n:].T @ loan[:n, n:]
    return F, held[:n, n:], (noise + noise.T) / 2


def _design_block(
    space: TendonSpace, i: int, kind: tuple[Regime, bool], gains: FilterGains, period: float, joint_period: float
) -> Block:
    """Return the filter of a tendon in a regime, with or without doubt.

    A tendon without load cell has the encoder alone. Its tension is then known by the motor force, with
    the wide uncertainty of friction.

    The load-cell error is estimated in slack only, where the tension is known. In other regimes the
    error is not observable: it is kept, the growing variance is included, and the gains are those
    of a filter without the error state.
    Source: Schmidt (1966), consider states.

    Encoder and load cell only observe the sum of excursion and offset. Joint encoders separate both
    at their own rate without influence on other states, so the filter is the same with and without
    joint encoders.
    """
    regime, doubted = kind
    A, B, tension = _continuous_model(space, i, regime, gains)
    intensity = _process_noise(space, i, regime, gains)
    if doubted:
        _add_doubt_noise(intensity, float(space.stiffness[i]), regime)
        B[:, 1] *= DOUBTED_PLAN
    F, held, Q = _discretise(A, B, intensity, period)
    H = np.zeros((MEASUREMENTS, STATES))
    H[0, X] = 1.0
    H[1] = tension
    H[2, S] = 1.0
    known = regime == Regime.SLACK
    H[1, E] = float(known)
    noise = np.array([space.encoder_step[i] * gains.encoder_noise_counts, space.tension_noise[i]])
    # Encoder and load cell, or the encoder alone.
    read = 2 if space.has_cell[i] else 1
    P = _solve_riccati(F, H[:read], Q, np.diag(noise[:read] ** 2))
    innovation = H[:2] @ P @ H[:2].T + np.diag(noise**2)
    K = np.zeros((STATES, MEASUREMENTS))
    K[:, :read] = np.linalg.solve(innovation[:read, :read], H[:read] @ P).T
    # Consider state: no correction of the cell error unless it is observable, see the docstring.
    K[E] *= known
    H[1, E] = 1.0
    K[S, 2] = 1.0 - math.exp(-joint_period / gains.joint_time_s) if math.isfinite(joint_period) else 0.0
    # Travel and tension fix the sum of excursion and offset, so the offset moves the other way.
    K[O, 2] = -K[S, 2]
    drift = 0.0 if known or read == 1 else gains.cell_drift_N**2 / gains.cell_drift_time_s * gains.cell_tared_s
    variance = float(tension @ P @ tension) + drift  # without tension, in slack, nothing
    information = np.zeros((2, 2))
    information[:read, :read] = np.linalg.inv(innovation[:read, :read])
    sigma = math.sqrt(innovation[1, 1])
    finite_or_error(F, held, K, P, information)
    return Block(F, held, H, K, Q, noise**2, P, known, drift, tension, variance, information, sigma)


def _solve_riccati(F: Matrix, H: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """Return the steady-state covariance of the prediction, solved in units with states of the order of one."""
    scale = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1.0, 0.1, 1e-5])
    rows = 1.0 / np.sqrt(np.diag(R))
    P = solve_covariance(
        F * scale / scale[:, None], H * scale * rows[:, None], Q / np.outer(scale, scale), np.eye(len(rows))
    )
    return P * np.outer(scale, scale)
