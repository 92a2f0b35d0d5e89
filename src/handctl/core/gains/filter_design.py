"""Discrete model and steady-state Kalman gains of the tension filter, designed once before arming.

The state of a tendon is [x, v, s, w, d, e, o]: tendon travel [m] and speed [m/s] at the spool,
excursion [m] and its rate [m/s], Gauss-Markov disturbance force on the motor [N], load-cell error
[N], stretch offset [m]. The inputs are the motor force at the tendon [N], and the planned rate of
change of a moving digit's tension [N/s]. The measurements are the encoder travel [m], the load cell
[N], and the excursion from joint encoders [m].

The model does not contain the equation of motion of the digit. The mass of the digit is a twentieth
of the mass of the rotor. A stiff tendon connects the digit to the rotor. The friction at the
pulleys of the digit is up to a third of the tension. The direction of the pulley friction depends
on the sign of the tendon speed at the pulleys, which is only micrometres per second. In a filter
with the digit's equation of motion, the sign of the friction would change all the time, and the
tension error would be 9 N instead of 0.5 N. Two assumptions replace the digit's equation of motion:
a free digit follows its tendon with slowly changing tension, and a held digit is at rest. Source:
linearised tendon plant, van Loan (1978) for the discretisation. The function that solves the
Riccati equation comes from the package ``control``.
"""

import math

import numpy as np

from handctl.core.deferred_imports import DeferredModule
from handctl.core.estimation.filter_types import (
    INPUT_COUNT,
    MEASUREMENT_COUNT,
    STATE_COUNT,
    D,
    E,
    FilterBlock,
    FilterDesign,
    Matrix,
    O,
    S,
    TendonRegime,
    V,
    W,
    X,
)
from handctl.core.gains.gains import FilterGains
from handctl.core.gains.riccati import solve_covariance
from handctl.core.gains.solver_errors import require_finite_solution, solver_failures_as_errors
from handctl.core.tendon_constants import TendonConstants

linalg = DeferredModule("scipy.linalg")

HELD_STATE_DECAY_TIME_S = 1e4
"""Time constant with which stretch offset and excursion of a held digit decay to 0 in the model [s].

Without any decay the Riccati equation has no solution. A faster decay changes the estimated
tension: if an offset of one millimetre decays in a minute, the tension changes by 1.7 N per second.
"""

# The constants below describe process noise that is added while the model of a tendon does not fit
# the measurements of the tendon, see ``kalman``.
DISTURBANCE_FACTOR_WITH_ADDED_NOISE = 5.0
"""Factor on the motor disturbance of a free tendon while noise is added to its filter.

The added noise covers motor friction that differs from the hand file.
"""
HELD_DISTURBANCE_FACTOR_WITH_ADDED_NOISE = 2.0
"""Factor on the motor disturbance of a held tendon while noise is added to its filter."""
ADDED_TENSION_RANDOM_WALK = 8.0
"""Random walk [N/s^0.5] that is added to the tension of a free tendon.

The random walk covers joint friction that differs from the hand file.
"""
HELD_TENSION_RANDOM_WALK = 3.0
"""Random walk [N/s^0.5] that is added to the tension of a held tendon."""
PLANNED_CHANGE_FRACTION_WITH_ADDED_NOISE = 0.25
"""Fraction of the planned change of tension that the filter expects while process noise is added."""
FRICTION_SIGMA_WITHOUT_CELL = 0.6
"""Standard deviation of a motor's friction as a fraction of the Coulomb friction, for tendons without load cell.

The friction can have any value between the friction values of the two directions of motion. A
uniform distribution between -1 and 1 has the standard deviation 1 / sqrt(3).
"""
FRICTION_TIME_WITHOUT_CELL_S = 0.3
"""Correlation time of a motor's friction, for tendons without load cell [s].

The correlation time is about the time between two reversals of the motor.
"""
TAUT_REGIMES = (TendonRegime.FREE, TendonRegime.HELD)
"""Regimes with a second filter design, which has added noise.

The order of the two regimes is the order of the design indices 3 and 4.
"""


def design_filter(
    tendons: TendonConstants, gains: FilterGains, period_s: float, joint_period: Matrix
) -> FilterDesign:
    """Design the filter of each tendon in each regime.

    Tendons with equal parameters get the same design.

    Args:
        tendons: constants of the hand along the tendons.
        gains: noise that the filter assumes.
        period_s: control period [s].
        joint_period: (N,) time between two readings of the joint encoders of a tendon [s], inf
            without joint encoders.

    Raises:
        ConfigError: no filter can be designed from the gains.
    """
    blocks_by_constants: dict[tuple[float, ...], tuple[FilterBlock, ...]] = {}
    blocks = []
    for i, joints in enumerate(joint_period.tolist()):
        constants = (joints, *tendons.constants_of_tendon(i))
        if constants not in blocks_by_constants:
            with solver_failures_as_errors("filter"):
                nominal_blocks = tuple(
                    _design_filter_block(tendons, i, (regime, False), gains, period_s, joints)
                    for regime in TendonRegime
                )
                noisy_blocks = (
                    _design_filter_block(tendons, i, (regime, True), gains, period_s, joints)
                    for regime in TAUT_REGIMES
                )
                blocks_by_constants[constants] = (
                    *nominal_blocks,
                    *noisy_blocks,
                    nominal_blocks[TendonRegime.SLACK],
                )  # the filter of a slack tendon never gets added noise
        blocks.append(blocks_by_constants[constants])
    return FilterDesign(tuple(blocks))


def _continuous_model(
    tendons: TendonConstants, i: int, regime: TendonRegime, gains: FilterGains
) -> tuple[Matrix, Matrix, Matrix]:
    """Return the continuous model of a tendon: A (7, 7), B (7, 2), and the tension row (7,).

    The tension is the product of the tension row and the states.
    """
    is_taut = regime != TendonRegime.SLACK
    k, c = (tendons.stiffness[i], tendons.damping[i]) if is_taut else (0.0, 0.0)
    tension = np.array([k, c, -k, -c, 0.0, 0.0, -k])
    A = np.zeros((STATE_COUNT, STATE_COUNT))
    B = np.zeros((STATE_COUNT, INPUT_COUNT))
    A[X, V] = A[S, W] = 1.0
    A[V] = -tension / tendons.motor_mass[i]
    A[V, V] -= tendons.motor_damping[i] / tendons.motor_mass[i]
    A[V, D] = B[V, 0] = 1.0 / tendons.motor_mass[i]
    if regime == TendonRegime.FREE:
        # A free digit follows the rotor: it has the same acceleration as the rotor, and its speed
        # slowly becomes equal to the speed of the rotor.
        A[W] = A[V]
        B[W] = B[V]
        A[W, V] += 1.0 / gains.free_time_s
        A[W, W] -= 1.0 / gains.free_time_s
        # When the tension rises, the tendon becomes longer, so the excursion grows less than the
        # travel.
        B[S, 1] = -1.0 / tendons.stiffness[i]
    else:
        A[W, W] = -1.0 / gains.held_time_s
        A[S, S] = -1.0 / HELD_STATE_DECAY_TIME_S
    correlation_time_s = _motor_noise(regime, gains)[1]
    A[D, D] = -1.0 / (
        correlation_time_s
        if tendons.has_cell[i]
        else max(correlation_time_s, FRICTION_TIME_WITHOUT_CELL_S)
    )
    A[E, E] = A[O, O] = -1.0 / HELD_STATE_DECAY_TIME_S
    return A, B, tension


def _motor_noise(regime: TendonRegime, gains: FilterGains) -> tuple[float, float, float]:
    """Return the force noise on the motor: standard deviation [N], correlation time [s], white noise [N]."""
    if regime == TendonRegime.HELD:
        return (
            gains.held_disturbance_N,
            gains.held_disturbance_time_s,
            gains.held_acceleration_noise_N,
        )
    return (
        gains.motor_disturbance_N,
        gains.motor_disturbance_time_s,
        gains.motor_acceleration_noise_N,
    )


def _process_noise(
    tendons: TendonConstants, i: int, regime: TendonRegime, gains: FilterGains
) -> Matrix:
    """Return the process noise (7, 7) of a tendon's continuous model.

    A Gauss-Markov state with the standard deviation sigma and the correlation time tau has the
    noise intensity 2 sigma^2 / tau. The speed v of the tendon also has white noise. While the digit
    is free, the rate w of the excursion has the same white noise as v.
    """
    Q = np.zeros((STATE_COUNT, STATE_COUNT))
    disturbance, correlation_time_s, acceleration_noise = _motor_noise(regime, gains)
    if not tendons.has_cell[i]:
        # Without a load cell, the tension is estimated as motor force minus friction, so an error
        # of the friction is an error of the tension.
        disturbance = math.hypot(
            disturbance, FRICTION_SIGMA_WITHOUT_CELL * tendons.coulomb_friction[i]
        )
        correlation_time_s = max(correlation_time_s, FRICTION_TIME_WITHOUT_CELL_S)
    Q[V, V] = acceleration_noise**2 / tendons.motor_mass[i] ** 2
    if regime == TendonRegime.FREE:
        rate = gains.free_rate_N_per_s / tendons.stiffness[i]
        Q[V, W] = Q[W, V] = Q[V, V]
        Q[W, W] = Q[V, V] + 2.0 * rate**2 / gains.free_time_s
    else:
        Q[W, W] = 2.0 * gains.held_speed_m_s**2 / gains.held_time_s
    Q[D, D] = 2.0 * disturbance**2 / correlation_time_s
    Q[E, E] = gains.cell_drift_N**2 / gains.cell_drift_time_s
    Q[O, O] = 2.0 * gains.offset_m**2 / gains.offset_time_s
    return Q


def _add_process_noise(process_noise: Matrix, stiffness: float, regime: TendonRegime) -> None:
    """Increase the process noise Q (7, 7) of a taut tendon whose model does not fit the measurements.

    Args:
        process_noise: (7, 7) process noise of the continuous model, modified in place.
        stiffness: stiffness of the tendon [N/m].
        regime: regime of the tendon, free or held.
    """
    is_free = regime == TendonRegime.FREE
    process_noise[D, D] *= (
        DISTURBANCE_FACTOR_WITH_ADDED_NOISE if is_free else HELD_DISTURBANCE_FACTOR_WITH_ADDED_NOISE
    ) ** 2
    process_noise[S, S] += (
        (ADDED_TENSION_RANDOM_WALK if is_free else HELD_TENSION_RANDOM_WALK) / stiffness
    ) ** 2


def _discretise_model(
    A: Matrix, B: Matrix, process_noise: Matrix, period_s: float
) -> tuple[Matrix, Matrix, Matrix]:
    """Discretise A and B by a zero-order hold, and return them with the covariance of the process noise per period.

    Source: van Loan (1978).
    """
    n, m = B.shape
    # The inputs are constant within a period: exp([[A, B], [0, 0]] T) = [[F, G], [0, I]].
    zero_order_hold = linalg.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * period_s)
    van_loan_matrix = linalg.expm(
        np.block([[-A, process_noise], [np.zeros((n, n)), A.T]]) * period_s
    )
    F = zero_order_hold[:n, :n]
    noise = van_loan_matrix[n:, n:].T @ van_loan_matrix[:n, n:]
    return F, zero_order_hold[:n, n:], (noise + noise.T) / 2


def _design_filter_block(
    tendons: TendonConstants,
    i: int,
    regime_and_noise: tuple[TendonRegime, bool],
    gains: FilterGains,
    period_s: float,
    joint_period: float,
) -> FilterBlock:
    """Return the filter of a tendon for one kind of design.

    A kind of design consists of the regime, and of a flag that is True if process noise is added.

    For a tendon without a load cell, the filter uses only the motor encoder. The tension of a
    tendon without a load cell is computed from the motor force, and is uncertain because of
    friction.

    The load-cell error is estimated only while a tendon is slack, because the tension is then known
    to be 0. While a tendon is taut, no measurement distinguishes the load-cell error from tension,
    so the estimated load-cell error stays constant. For a taut tendon, the growing variance of the
    load-cell error is added to the variance of the tension. The gains for a taut tendon are
    computed for a filter without the load-cell error among its states. Source: Schmidt (1966),
    consider states.

    The encoder and the load cell determine only the sum of excursion and stretch offset. Joint
    encoders separate the excursion from the stretch offset within ``joint_time_s``. Joint encoders
    correct no other state, so the gains for all other states do not depend on joint encoders.
    """
    regime, has_added_noise = regime_and_noise
    A, B, tension = _continuous_model(tendons, i, regime, gains)
    noise_intensity = _process_noise(tendons, i, regime, gains)
    if has_added_noise:
        _add_process_noise(noise_intensity, float(tendons.stiffness[i]), regime)
        B[:, 1] *= PLANNED_CHANGE_FRACTION_WITH_ADDED_NOISE
    F, held_input_matrix, Q = _discretise_model(A, B, noise_intensity, period_s)
    H = np.zeros((MEASUREMENT_COUNT, STATE_COUNT))
    H[0, X] = 1.0
    H[1] = tension
    H[2, S] = 1.0
    is_cell_error_observable = regime == TendonRegime.SLACK
    H[1, E] = float(is_cell_error_observable)
    noise = np.array(
        [tendons.encoder_step[i] * gains.encoder_noise_counts, tendons.tension_noise[i]]
    )
    # The first two measurements are the encoder and the load cell. Without a load cell, only the
    # encoder is used.
    measurement_count = 2 if tendons.has_cell[i] else 1
    P = _prediction_covariance(F, H[:measurement_count], Q, np.diag(noise[:measurement_count] ** 2))
    innovation = H[:2] @ P @ H[:2].T + np.diag(noise**2)
    K = np.zeros((STATE_COUNT, MEASUREMENT_COUNT))
    K[:, :measurement_count] = np.linalg.solve(
        innovation[:measurement_count, :measurement_count], H[:measurement_count] @ P
    ).T
    # The filter corrects the load-cell error only if a measurement distinguishes it from tension.
    K[E] *= is_cell_error_observable
    H[1, E] = 1.0
    K[S, 2] = (
        1.0 - math.exp(-joint_period / gains.joint_time_s) if math.isfinite(joint_period) else 0.0
    )
    # Travel and tension determine the sum of excursion and stretch offset, so each correction of
    # the excursion requires the opposite correction of the stretch offset.
    K[O, 2] = -K[S, 2]
    drift = (
        0.0
        if is_cell_error_observable or measurement_count == 1
        else gains.cell_drift_N**2 / gains.cell_drift_time_s * gains.cell_tared_s
    )
    variance = float(tension @ P @ tension) + drift  # 0 for a slack tendon
    information = np.zeros((2, 2))
    information[:measurement_count, :measurement_count] = np.linalg.inv(
        innovation[:measurement_count, :measurement_count]
    )
    sigma = math.sqrt(innovation[1, 1])
    require_finite_solution(F, held_input_matrix, K, P, information)
    return FilterBlock(
        F,
        held_input_matrix,
        H,
        K,
        Q,
        noise**2,
        P,
        is_cell_error_observable,
        drift,
        tension,
        variance,
        information,
        sigma,
    )


def _prediction_covariance(F: Matrix, H: Matrix, process_noise: Matrix, R: Matrix) -> Matrix:
    """Return the constant covariance of the filter's prediction.

    The Riccati equation is solved in units in which all states are of the order of 1.
    """
    scale = np.array([1e-5, 1e-2, 1e-5, 1e-2, 1.0, 0.1, 1e-5])
    rows = 1.0 / np.sqrt(np.diag(R))
    P = solve_covariance(
        F * scale / scale[:, None],
        H * scale * rows[:, None],
        process_noise / np.outer(scale, scale),
        np.eye(len(rows)),
    )
    return P * np.outer(scale, scale)
