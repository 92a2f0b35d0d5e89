"""Fit of stiffness and moment arms of a tendon, from spool travel, load cell and joint encoders.

    x = m s(q) + f_l / k + o(t) + d x'

The travel x of the spool is the sum of the joints' excursion s(q) and the tendon's stretch f_l / k.
At a tension called the knee, the stiffness of a tendon changes. The linear tension f_l is the
tension that a tendon without a knee would have at the same stretch. The factor m multiplies the
moment arms of the hand file. The joint encoders are read a short time d before or after the motor
encoders. At the travel speed x', the travel changes by d x' during this time. The offset o follows
the drift of the load cell. The equation of the travel contains neither joint stops nor return
springs.
"""

from dataclasses import replace

import numpy as np

from handctl.hand.digit import DigitModel
from handctl.hand.tendons import TendonElasticity
from handctl.tune.identify.fit_tendon import (
    DEFAULT_PRIOR_DEVIATION,
    MAX_SCALED_PARAMETER,
    MIN_SCALED_PARAMETER,
    PARAMETER_NAMES,
    STRETCH_OFFSET_SCALE_M,
    TendonFit,
    add_model_error,
    merge_solution,
)
from handctl.tune.identify.least_squares import solve_least_squares
from handctl.tune.identify.tendon_data import MIN_TENSION_N, Array, TendonData, average_samples

TRAVEL_PARAMETERS = ("tendon_stiffness", "moment_arm")
"""Names of the parameters that the fit to the travel identifies.

In the parameter vector of the fit, the time difference of the encoders and the offset follow after
the named parameters.
"""
TRAVEL_MODEL_ERROR = {
    "tendon_stiffness": 0.012, "moment_arm": 0.0003, "torque_gain": 0.006, "motor_inertia": 0.008,
    "motor_coulomb": 0.008, "motor_viscous": 0.03,
}  # fmt: skip
"""Standard deviation of the errors of the model by parameter, as a fraction of the value.

The confidence intervals are calculated from blocks of time that are too short to show the slow
drift of the load cell. The values were chosen in simulations of five hands.
"""
SENSOR_SKEW_S = 1e-3
"""Scale of the time difference between the encoders, and its prior standard deviation [s]."""
AVERAGING_HALF_WINDOW = 1
"""Number of samples before and after a joint reading over which the tension is averaged."""
MIN_DATA_ROWS = 50
"""Smallest number of joint readings for a fit."""


def tendon_excursions(digit: DigitModel, tendon: int, q: Array) -> Array:
    """Return the excursion (m,) of one tendon of a digit at joint angles (m, joints) [m]."""
    if not digit.has_varying_arm:
        return np.asarray(q @ digit.moment_arms[tendon])
    return np.array([digit.excursion_at_angles(row)[tendon] for row in q])


def model_with_arm_factors(digit: DigitModel, arm_factors: Array) -> DigitModel:
    """Return a copy of a digit in which the moment arms of each tendon are multiplied by a factor (n_t,)."""
    arms = digit.moment_arms * arm_factors[:, None]
    to_coordinates = np.linalg.pinv(arms @ digit.coupling)
    return replace(
        digit,
        moment_arms=arms,
        arm_polynomials=digit.arm_polynomials * arm_factors[:, None, None],
        reduced_moment_arms=arms @ digit.coupling,
        excursion_to_joints=digit.coupling @ to_coordinates,
        torque_to_tension=to_coordinates.T @ digit.coupling.T,
    )


def fit_travel(
    digit: DigitModel,
    tendon: int,
    data: TendonData,
    fit: TendonFit,
    joint_noise: float,
    elasticity: TendonElasticity,
) -> TendonFit:
    """Replace the stiffness and the moment arm in the fit of a tendon, and return the new fit.

    The new stiffness and the new moment arm are fitted to the travel of the tendon.

    If there are too few joint-encoder readings, the function returns the given fit unchanged.

    Args:
        digit: model of the digit.
        tendon: index of the tendon among the tendons of the digit.
        data: data of the tendon.
        fit: fit of the tendon, whose stiffness and moment arm are replaced.
        joint_noise: standard deviation of one joint-encoder reading [rad].
        elasticity: tension of the tendon over its stretch, as the hand file describes it. The fit
            keeps its shape, and scales its stiffness.
    """
    problem = fit.problem
    tension = average_samples(data.tension, AVERAGING_HALF_WINDOW)
    speed = np.gradient(data.travel, data.period)
    used_samples = (
        np.isfinite(data.joints).all(axis=1)
        & np.isfinite(tension + data.travel + speed)
        & (tension > MIN_TENSION_N)
    )
    if used_samples.sum() < MIN_DATA_ROWS:
        return fit
    excursion = tendon_excursions(digit, tendon, data.joints[used_samples])
    travel, tension, speed, t = (
        data.travel[used_samples],
        tension[used_samples],
        speed[used_samples],
        data.t[used_samples],
    )
    nominal = problem.parameter_scales[PARAMETER_NAMES.index("tendon_stiffness")]
    noise = np.hypot(
        joint_noise * float(np.linalg.norm(digit.moment_arms[tendon])),
        problem.cell_noise_N / (2 * AVERAGING_HALF_WINDOW + 1) ** 0.5 / nominal,
    )
    linear_tension = elasticity.stiffness * np.array(
        [elasticity.stretch(sample) for sample in tension.tolist()]
    )
    knots = problem.drift_knots
    scalar_count = 3
    offset = float(np.mean(travel - excursion - linear_tension / nominal))

    def residuals(z: Array) -> Array:
        stretch = linear_tension / (z[0] * nominal)
        drift_offset = np.interp(t, knots, z[scalar_count:]) * STRETCH_OFFSET_SCALE_M
        expected = z[1] * excursion + stretch + offset + drift_offset + z[2] * SENSOR_SKEW_S * speed
        # The offset of the travel follows the drift of the load cell, which is a random walk.
        steps = np.diff(z[scalar_count:]) * STRETCH_OFFSET_SCALE_M * nominal / problem.drift_step_N
        prior = np.array(
            [
                (z[0] - 1.0) / DEFAULT_PRIOR_DEVIATION,
                (z[1] - 1.0) / DEFAULT_PRIOR_DEVIATION,
                z[2],
                z[scalar_count] / 10.0,
            ]
        )
        return np.concatenate([(travel - expected) / noise, steps, prior])

    start = np.concatenate([np.ones(2), np.zeros(1 + len(knots))])
    low = np.full(len(start), -np.inf)
    high = np.full(len(start), np.inf)
    low[:2], high[:2] = MIN_SCALED_PARAMETER, MAX_SCALED_PARAMETER
    solution = solve_least_squares(residuals, start, (low, high), t)
    merged_fit = merge_solution(
        fit, solution, len(t), TRAVEL_PARAMETERS, range(len(TRAVEL_PARAMETERS))
    )
    return add_model_error(merged_fit, TRAVEL_MODEL_ERROR)
