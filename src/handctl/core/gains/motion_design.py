"""Feedback gains of the motion loop and the tension loop, designed by LQR on the discrete model.

The gains are designed before arming, and again when the gains change during a run. The prediction
of the tension filter includes the delay of the bus. Both loops use the prediction, so they have no
state for the delay. Errors of the prediction grow with the prediction horizon, and reduce the phase
margin. To keep the phase margin at control rates below 500 Hz, the force weights are reduced.
Source: Bryson's rule for the weights. The function that solves the Riccati equation comes from the
package ``control``.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handctl.core.deferred_imports import DeferredModule
from handctl.core.gains.gain_bounds import check_tendon_names
from handctl.core.gains.gains import Gains
from handctl.core.gains.riccati import solve_lqr
from handctl.core.gains.solver_errors import require_finite_solution, solver_failures_as_errors
from handctl.core.tendon_constants import TendonConstants
from handctl.core.tick_types import Vector

linalg = DeferredModule("scipy.linalg")


@dataclass(frozen=True, slots=True)
class MotionDesign:
    """Feedback gains of the motion loop and the tension loop of the N tendons, with shape (N,).

    Attributes:
        stiffness: acceleration per excursion error in the motion loop [1/s^2].
        damping: acceleration per speed error in the motion loop [1/s].
        tension: motor force per newton of tension error in the tension loop [1].
        tension_speed: motor force per m/s of tendon speed in the tension loop [N s/m].
    """

    stiffness: Vector
    damping: Vector
    tension: Vector
    tension_speed: Vector


FULL_FORCE_WEIGHT_PERIOD_S = 2e-3
"""Longest control period at which the force weights are not reduced [s]."""


def force_weight_at_period(force: float, period_s: float) -> float:
    """Return the force weight for a control period [N].

    For control periods above ``FULL_FORCE_WEIGHT_PERIOD_S``, the force weight is reduced. The
    stiffness of a control loop is proportional to its force weight. The bandwidth of a control loop
    is proportional to the square root of its force weight.
    """
    return force * min(1.0, math.sqrt(FULL_FORCE_WEIGHT_PERIOD_S / period_s))


def design_motion(tendons: TendonConstants, gains: Gains, period_s: float) -> MotionDesign:
    """Design the motion loop and the tension loop of every tendon by LQR.

    Args:
        tendons: constants of the hand along the tendons.
        gains: gains with the weights.
        period_s: control period [s].

    Raises:
        ConfigError: no feedback gains follow from the weights, or the weights name a tendon that
            the hand does not have.
    """
    check_tendon_names(gains, tendons.names)
    return combine_loop_designs(
        tendons,
        [
            design_control_loop(tendons, gains, period_s, loop_index)
            for loop_index in range(control_loop_count(tendons))
        ],
    )


def control_loop_count(tendons: TendonConstants) -> int:
    """Return the number of control loops to design.

    While the controller runs, it has time to design only one loop per tick.
    """
    return 2 * len(tendons.spool_radius)


def design_control_loop(
    tendons: TendonConstants, gains: Gains, period_s: float, loop_index: int
) -> Vector:
    """Return the feedback gains (2,) of one control loop.

    Loops 0 to N - 1 are motion loops, and loops N to 2 N - 1 are tension loops.

    Raises:
        ConfigError: no feedback gains follow from the weights.
    """
    n = len(tendons.spool_radius)
    if loop_index < n:
        with solver_failures_as_errors("motion"):
            return _design_motion_loop(tendons, loop_index, gains, period_s)
    with solver_failures_as_errors("tension"):
        return _design_tension_loop(tendons, loop_index - n, gains, period_s)


def combine_loop_designs(tendons: TendonConstants, feedback_gains: list[Vector]) -> MotionDesign:
    """Combine the feedback gains of all loops into the design of all tendons."""
    n = len(tendons.spool_radius)
    mass = tendons.motor_mass + tendons.load_mass
    motion = feedback_gains[:n]
    tension = feedback_gains[n:]
    return MotionDesign(
        stiffness=np.array([K[0] for K in motion]) / mass,
        damping=np.array([K[1] for K in motion]) / mass,
        tension=np.array([K[0] for K in tension]),
        tension_speed=np.array([K[1] for K in tension]),
    )


def _sampled_lqr_gain(
    A: NDArray[np.float64],
    B: NDArray[np.float64],
    state: list[float],
    force: float,
    period_s: float,
) -> Vector:
    """Return the LQR gain (2,) for the system x' = A x + B u.

    The system is sampled at the control period. The weights follow from Bryson's rule.
    """
    # The inputs are constant within a period: exp([[A, B], [0, 0]] T) = [[F, G], [0, I]].
    transition = linalg.expm(period_s * np.block([[A, B], [np.zeros((1, 3))]]))
    F = transition[:2, :2]
    G = transition[:2, 2:]
    K = solve_lqr(F, G, np.diag([1.0 / x**2 for x in state]), np.array([[1.0 / force**2]]))
    require_finite_solution(K)
    if not np.abs(np.linalg.eigvals(F - G @ K)).max() < 1.0:
        raise ValueError("not stable")
    return np.asarray(K[0], dtype=np.float64)


def _design_motion_loop(tendons: TendonConstants, i: int, gains: Gains, period_s: float) -> Vector:
    """Design the motion loop.

    In the model of the motion loop, motor and digit are one mass, because the tendon is rigid. The
    states of the motion loop are excursion error [m] and speed error [m/s].
    """
    weights = gains.motion
    mass = float(tendons.motor_mass[i] + tendons.load_mass[i])
    A = np.array([[0.0, 1.0], [0.0, 0.0]])
    B = np.array([[0.0], [1.0 / mass]])
    force = force_weight_at_period(gains.force_weights_of_tendon(tendons.names[i])[0], period_s)
    return _sampled_lqr_gain(
        A, B, [weights.position_error_m, weights.speed_error_m_s], force, period_s
    )


def _design_tension_loop(tendons: TendonConstants, i: int, gains: Gains, period_s: float) -> Vector:
    """Design the tension loop.

    In the model of the tension loop, the digit is blocked, and the rotor stretches the tendon. The
    states of the tension loop are tension error [N] and tendon speed [m/s].
    """
    weights = gains.tension
    mass = tendons.motor_mass[i]
    k = tendons.stiffness[i]
    b = tendons.motor_damping[i] + tendons.damping[i]
    A = np.array([[0.0, k], [-1.0 / mass, -b / mass]])
    B = np.array([[0.0], [1.0 / mass]])
    force = force_weight_at_period(gains.force_weights_of_tendon(tendons.names[i])[1], period_s)
    return _sampled_lqr_gain(
        A, B, [weights.tension_error_N, weights.speed_error_m_s], force, period_s
    )
