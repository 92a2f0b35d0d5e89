"""Fit of the springs and the friction of a digit with several tendons, from load cells and joint encoders.

    sum_j R_ji f_j exp(-mu_j sgn(w_j) (phi_j + q_1 + .. + q_i)) = S k_i (q_i + P p_i) + b_i q_i' + m (M q'' + g)_i

The equation above is the torque balance of joint i in free motion. The exponent contains a sum of
angles: the wrap angle phi_j of tendon j, and the angles of the joints from joint 1 to joint i.
Prismatic joints, and joints that tendon j does not cross, are left out of the sum. The drift of the
load cells is known from the fits of single tendons. Each row of the fit is the torque balance of a
joint, divided by the noise that the load cells cause in the torque balance. The fit neglects errors
of the joint encoders, because their effect is a tenth of the effect of load-cell errors. Source: as
in `fit_load`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handctl.hand.digit import DigitModel
from handctl.hand.dynamics import inverse_dynamics
from handctl.tune.identify.contact_detection import ResidualRamp, most_significant_ramp
from handctl.tune.identify.fit_load import MAX_FRICTION_EXPONENT
from handctl.tune.identify.fit_tendon import (
    DEFAULT_PRIOR_DEVIATION,
    MAX_SCALED_PARAMETER,
    MIN_SCALED_PARAMETER,
    PARAMETER_NAMES,
    PRIOR_DEVIATIONS,
    TendonFit,
    merge_solution,
)
from handctl.tune.identify.least_squares import FitSolution, solve_least_squares
from handctl.tune.identify.tendon_data import Array, TendonData, average_samples

SHARED_PARAMETERS = ("spring_stiffness", "spring_preload", "joint_damping", "link_mass")
"""Names of the parameters that all tendons of a digit share.

The shared parameters are factors that multiply values of the hand file.

In the parameter vector of the fit, the capstan coefficients of the tendons follow after the shared
parameters.
"""
HALF_WINDOW_S = 0.01
"""Time before and after a joint reading over which signals are averaged [s]."""
MIN_SPEED_M_S = 2.5e-3
"""Smallest speed that all tendons of the digit must have in a sample that the fit uses [m/s].

At lower speeds, the direction of friction is not known at every pulley.
"""
DIFFERENCE_STEP_S = 1e-4
"""Time step of the numerical derivative of the moment arms along the motion of the joints [s]."""
MIN_DATA_ROWS = 20
"""Smallest number of sample times for a fit."""


@dataclass(frozen=True, slots=True)
class TorqueBalance:
    """Torque balance of a digit at the sample times of the fit.

    The fit uses only sample times at which the digit moves freely and all its joint encoders have a
    reading.

    Attributes:
        digit: model of the digit.
        t: (m,) time [s].
        q: (m, joints) joint angles [rad].
        dq: (m, joints) joint rates [rad/s].
        rigid_body_torque: (m, joints) torque of inertia and weight [N m].
        tension: (m, tendons) tension at the load cells, corrected for the drift [N].
        speed_sign: (m, tendons) sign of the speed of each tendon.
        noise: (tendons,) noise of the averaged load-cell readings [N].
        drift_sigma: (tendons,) standard deviation of the load-cell drift that remains after the
            correction [N].
    """

    digit: DigitModel
    t: Array
    q: Array
    dq: Array
    rigid_body_torque: Array
    tension: Array
    speed_sign: Array
    noise: Array
    drift_sigma: Array

    @staticmethod
    def from_fits(
        digit: DigitModel, data: Sequence[TendonData], fits: Sequence[TendonFit]
    ) -> "TorqueBalance | None":
        """Return the data for the fit of a digit, made from the data and the fits of the digit's tendons.

        If too few sample times can be used, return None.

        Args:
            digit: model of the digit.
            data: data of the tendons of the digit, in their order.
            fits: fits of the same tendons.
        """
        first_tendon = data[0]
        half_window = max(1, round(HALF_WINDOW_S / data[0].period))
        is_free_motion = np.all(
            [
                average_samples(tendon.free_motion_mask.astype(float), half_window) > 0.999
                for tendon in data
            ],
            axis=0,
        )
        cells = [
            average_samples(tendon.tension - _cell_drift(tendon, fit), half_window)
            for tendon, fit in zip(data, fits, strict=True)
        ]
        tension = np.column_stack(cells)
        speed, acceleration = (
            np.column_stack(values)
            for values in zip(*(_tendon_rates(tendon, half_window) for tendon in data), strict=True)
        )
        is_fast = (np.abs(speed) > MIN_SPEED_M_S).all(axis=1)
        is_complete = np.isfinite(np.hstack([first_tendon.joints, tension, speed])).all(axis=1)
        selected_indices = _spaced_indices(
            np.flatnonzero(is_free_motion & is_fast & is_complete), 2 * half_window
        )

        if len(selected_indices) < MIN_DATA_ROWS:
            return None
        q = first_tendon.joints[selected_indices]
        dq, ddq = _joint_rates(digit, q, speed[selected_indices], acceleration[selected_indices])
        rigid_body_torque = [
            inverse_dynamics(digit, *row)
            for row in zip(q.tolist(), dq.tolist(), ddq.tolist(), strict=True)
        ]
        return TorqueBalance(
            digit=digit,
            t=first_tendon.t[selected_indices],
            q=q,
            dq=dq,
            rigid_body_torque=np.array(rigid_body_torque),
            tension=tension[selected_indices],
            speed_sign=np.sign(speed[selected_indices]),
            noise=np.array([f.problem.cell_noise_N for f in fits]) / (2 * half_window + 1) ** 0.5,
            drift_sigma=np.array(
                [_drift_deviation(f, first_tendon.t[selected_indices]) for f in fits]
            ),
        )

    def tendon_torque(self, friction: Array, offset: Array) -> Array:
        """Return the torques of the tendons at the joints (m, joints) [N m].

        Args:
            friction: (tendons,) capstan coefficients.
            offset: (tendons,) offsets of the load cells [N].
        """
        torque = np.zeros_like(self.q)
        present_moment_arms = self.digit.moment_arms_at(self.q)
        for j, arms in enumerate(self.digit.moment_arms):
            angle = np.full(len(self.t), self.digit.wrap[j])
            for i, mean_moment_arm in enumerate(arms.tolist()):
                arm = present_moment_arms[..., j, i]
                # A prismatic joint, and a joint that the tendon does not cross, add no wrap angle.
                has_pulley = mean_moment_arm != 0.0 and not self.digit.is_prismatic[i]
                angle = angle + self.q[:, i] * has_pulley
                # The direction of the friction depends on the direction in which the tendon moves.
                friction_loss = np.clip(
                    -friction[j] * self.speed_sign[:, j] * angle,
                    -MAX_FRICTION_EXPONENT,
                    MAX_FRICTION_EXPONENT,
                )
                torque[:, i] += arm * (self.tension[:, j] - offset[j]) * np.exp(friction_loss)
        return torque

    @property
    def whitening_matrix(self) -> Array:
        """Return the whitening matrix (joints, joints) for the joint torques.

        The whitened torques of one sample time are independent, and have a standard deviation of 1.
        """
        arms = self.digit.moment_arms
        return np.asarray(
            np.linalg.inv(np.linalg.cholesky(arms.T @ np.diag(self.noise**2) @ arms)).T
        )

    def required_torque(self, spring: float, preload: float, damping: float, mass: float) -> Array:
        """Return the torques (m, joints) that are necessary because of springs, damping, inertia and weight [N m].

        The arguments are factors by which the values in the hand file are multiplied.
        """
        digit = self.digit
        springs = (
            spring
            * np.array(digit.spring_stiffness)
            * (self.q + preload * np.array(digit.spring_preload))
        )
        return np.asarray(
            springs
            + damping * np.array(digit.joint_damping) * self.dq
            + mass * self.rigid_body_torque
        )


def _joint_rates(
    digit: DigitModel, q: Array, speed: Array, acceleration: Array
) -> tuple[Array, Array]:
    """Convert speeds and accelerations of tendons (m, tendons) to rates and accelerations of joints (m, joints).

    The joint rates are in rad/s, and the joint accelerations in rad/s^2. If the moment arms R
    depend on the joint angles, the acceleration of a tendon contains the additional term R' q'^2.
    """
    if not digit.has_varying_arm:
        excursion_to_joints = digit.excursion_to_joints.T
        return speed @ excursion_to_joints, acceleration @ excursion_to_joints
    excursions_to_joints_by_row = np.array(
        [digit.with_moment_arms_at(row).excursion_to_joints for row in q]
    )
    dq = np.einsum("mjn,mn->mj", excursions_to_joints_by_row, speed)
    arm_derivative_term = np.einsum(
        "mnj,mj->mn",
        digit.moment_arms_at(q + DIFFERENCE_STEP_S * dq)
        - digit.moment_arms_at(q - DIFFERENCE_STEP_S * dq),
        dq,
    )
    return dq, np.einsum(
        "mjn,mn->mj",
        excursions_to_joints_by_row,
        acceleration - arm_derivative_term / (2.0 * DIFFERENCE_STEP_S),
    )


def fit_digit(balance: TorqueBalance) -> FitSolution:
    """Fit the torque balance of a digit.

    The fitted parameters are the factors that all tendons of the digit share, and the capstan
    coefficient and the offset of each tendon. Factors and coefficients are relative to the values
    in the hand file.
    """
    n = len(SHARED_PARAMETERS)
    tendons = len(balance.noise)
    arms = balance.digit.moment_arms
    whitening_matrix = balance.whitening_matrix
    prior_deviations = np.array(
        [
            *(PRIOR_DEVIATIONS.get(name, DEFAULT_PRIOR_DEVIATION) for name in SHARED_PARAMETERS),
            *[DEFAULT_PRIOR_DEVIATION] * tendons,
        ]
    )
    friction = _friction_scales(balance.digit)

    def residuals(z: Array) -> Array:
        offset = z[n + tendons :]
        torque_imbalance = balance.tendon_torque(
            z[n : n + tendons] * friction, offset
        ) - balance.required_torque(*z[:n].tolist())
        return np.concatenate(
            [
                (torque_imbalance @ whitening_matrix).ravel(),
                (z[: n + tendons] - 1.0) / prior_deviations,
                offset / balance.drift_sigma,
            ]
        )

    start = np.append(np.ones(n + tendons), np.zeros(tendons))
    low = np.append(np.full(n + tendons, MIN_SCALED_PARAMETER), np.full(tendons, -np.inf))
    high = np.append(np.full(n + tendons, MAX_SCALED_PARAMETER), np.full(tendons, np.inf))
    return solve_least_squares(residuals, start, (low, high), np.repeat(balance.t, arms.shape[1]))


def fits_with_digit_solution(
    tendon_fits: Sequence[TendonFit], solution: FitSolution, balance: TorqueBalance
) -> list[TendonFit]:
    """Add the parameters from the fit of a digit to the fits of its tendons, and return the fits of the tendons.

    The fit of each tendon gets the capstan coefficient of this tendon. The factors that all tendons
    of the digit share are added only to the fit of the first tendon.
    """
    rows = len(balance.t) * balance.q.shape[1]
    tendon_fits = [replace(fit, ramp=_unexplained_ramp(solution, balance)) for fit in tendon_fits]
    merged_fits = []
    for j, fit in enumerate(tendon_fits):
        shared_parameters = SHARED_PARAMETERS if j == 0 else ()
        parameter_indices = [len(SHARED_PARAMETERS) + j, *range(len(shared_parameters))]
        merged_fits.append(
            merge_solution(fit, solution, rows, ("capstan", *shared_parameters), parameter_indices)
        )
    return merged_fits


def _unexplained_ramp(solution: FitSolution, balance: TorqueBalance) -> ResidualRamp | None:
    """Search for a contact in the residuals of the sweeps.

    Return the most significant torque ramp. A ramp acts on a single joint.
    """
    unit_vectors = [np.tile(row, len(balance.t)) for row in balance.whitening_matrix]
    return most_significant_ramp(
        solution.jacobian, solution.residual, 0, np.asarray(balance.q.mean(axis=1)), unit_vectors
    )


def _friction_scales(digit: DigitModel) -> Array:
    """Return the scale of each tendon's capstan coefficient (tendons,).

    The scale of a capstan coefficient is the same as in the fits of the single tendons.
    """
    return np.where(digit.friction > 0.0, digit.friction, 1e-3)


def _spaced_indices(indices: NDArray[np.intp], min_spacing: int) -> NDArray[np.intp]:
    """Select indices that are at least `min_spacing` apart.

    With the distance `min_spacing`, the averages at two selected indices have no readings in
    common.
    """
    selected_indices: list[int] = []
    for index in indices.tolist():
        if not selected_indices or index - selected_indices[-1] >= min_spacing:
            selected_indices.append(index)
    return np.array(selected_indices, dtype=np.intp)


def _tendon_rates(data: TendonData, half_window: int) -> tuple[Array, Array]:
    """Return the speed [m/s] and the acceleration [m/s^2] of a tendon.

    At the start and the end of the data, the speed and the acceleration are NaN.

    Speed and acceleration are computed from differences. The time step of the differences is twice
    the time over which signals are averaged.
    """
    x = data.travel
    step_samples = 2 * half_window
    speed = np.full(len(x), np.nan)
    acceleration = np.full(len(x), np.nan)
    values_after = x[2 * step_samples :]
    values_before = x[: -2 * step_samples]
    centre = x[step_samples:-step_samples]
    speed[step_samples:-step_samples] = (values_after - values_before) / (
        2 * step_samples * data.period
    )
    acceleration[step_samples:-step_samples] = (values_after - 2.0 * centre + values_before) / (
        step_samples * data.period
    ) ** 2
    return speed, acceleration


def _cell_drift(data: TendonData, fit: TendonFit) -> Array:
    """Return the drift of the load cell of a tendon at each sample [N]."""
    return np.asarray(np.interp(data.t, fit.problem.drift_knots, fit.z[len(PARAMETER_NAMES) :]))


def _drift_deviation(fit: TendonFit, t: Array) -> float:
    """Return the standard deviation of the drift of a load cell over the times `t` [N]."""
    knots = fit.problem.drift_knots
    used_knots = np.flatnonzero((knots >= t.min() - 1.0) & (knots <= t.max() + 1.0)) + len(
        PARAMETER_NAMES
    )
    return max(float(np.sqrt(np.diag(fit.covariance)[used_knots].mean())), 1e-3)
