"""Load model of a tendon: the tension that the load cell should measure at a given motor position.

The model applies to a digit that is at its open stop or moves freely.

At the open stop of a digit, the joints rest and only the tendon stretches. With the stiffness k,
the tension is then f = k (x - o), for a spool travel x with the offset o. In free motion, the
torques at each joint are in balance:

    S k_i (q_i + P p_i) + b_i q_i' + m (a_i q'' + g_i) = r_i f exp(-mu sgn(w) (phi_0 + q_1 + .. + q_i)),

The excursions of the joints and the stretch of the tendon add up to the travel: sum r_i q_i + f / k
= x - o. If a moment arm depends on the joint angle, the integral of the moment arm replaces r_i
q_i. The equations are solved for the tension f, because the noise of the encoder is negligible
compared with the noise of the load cell. Here, f is the tension, k is the stiffness of the tendon,
x is the travel of the spool, and o is an offset of the travel. S, P and m are factors that multiply
the springs, the preloads and the masses in the hand file. Source: capstan equation, virtual work,
equations of motion of `hand.dynamics`.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from handctl.hand.digit import DigitModel
from handctl.hand.dynamics import gravity_torque, mass_matrix
from handctl.hand.moment_arms import joint_excursions, moment_arms_at
from handctl.tune.identify.tendon_data import Array, Mask, TendonData

BIN_DURATION_S = 0.01
"""Duration of a bin of samples [s].

The digit moves little during a bin. A fit of bins has a fifth of the rows that a fit of single
samples would have.
"""
MIN_SPEED_M_S = 4e-3
"""Smallest speed that the tendon must have in a sample of free motion that the fit uses [m/s].

At lower speeds of the tendon, the direction of friction is not known at every pulley.
"""
TABLE_ANGLES_RAD = np.radians(np.linspace(0.0, 110.0, 23))
"""Joint angles of the table of inertia and weight. In each row of the table, all joints have the same angle [rad]."""
NEWTON_STEPS = 14
"""Number of Newton steps with which the tension is calculated."""
DIFFERENCE_STEP_RAD = 1e-4
"""Step of the numerical derivative of a moment arm [rad]."""
MIN_STIFFNESS_FRACTION = 0.2
"""Smallest effective stiffness of a joint, as a fraction of its spring's stiffness.

A moment arm that increases with the joint angle reduces the effective stiffness.
"""
MAX_FRICTION_EXPONENT = 3.0
"""Largest absolute exponent in the capstan equation.

The exponent of the capstan equation can reach this bound only in the first steps of a solver.
"""


class LoadParameters(NamedTuple):
    """Parameters of the load model, in SI units or as factors for values of the hand file.

    Attributes:
        stiffness: stiffness of the tendon [N/m].
        spring: factor for the stiffness of the springs.
        preload: factor for the preload of the springs.
        friction: capstan coefficient of the tendon.
        damping: factor for the damping of the joints.
        mass: factor for the masses of the links.
        offset: stretch offset [m].
    """

    stiffness: float
    spring: float
    preload: float
    friction: float
    damping: float
    mass: float
    offset: float


@dataclass(frozen=True, slots=True)
class SignalBins:
    """Averages of the signals of a tendon over short times, called bins.

    Each array has the shape (m,).

    Attributes:
        t: mean time of each bin [s].
        travel: travel of the tendon [m].
        tension: load-cell tension [N].
        speed: speed of the tendon [m/s].
        acceleration: acceleration of the tendon [m/s^2].
        count: number of readings in each bin.
    """

    t: Array
    travel: Array
    tension: Array
    speed: Array
    acceleration: Array
    count: int


def average_in_bins(
    data: TendonData, sample_mask: Mask, is_moving: bool, bin_s: float = BIN_DURATION_S
) -> SignalBins:
    """Return averages of those readings that a mask selects, over bins of equal duration.

    A bin is used if the mask is True for all readings in the bin, and if no reading is missing. If
    `is_moving` is True, the tendon must also move in a single direction during the bin.
    """
    count = max(1, round(bin_s / data.period))
    n = len(data.t) // count
    ticks_per_bin = max(2, round(BIN_DURATION_S / data.period))
    speed, acceleration = _central_rates(data.travel, data.period, ticks_per_bin)

    def values_in_bins(values: Array) -> Array:
        return values[: n * count].reshape(n, count)

    is_complete = values_in_bins(sample_mask.astype(float)).all(axis=1) & np.isfinite(
        values_in_bins(data.tension + data.travel)
    ).all(axis=1)
    if is_moving:
        speeds = values_in_bins(speed)
        is_complete &= np.abs(speeds).min(axis=1) > MIN_SPEED_M_S
        # All signs in a bin are equal if the absolute value of their sum is the number of readings.
        is_complete &= np.abs(np.sign(speeds).sum(axis=1)) == count

    def mean_of_bins(values: Array) -> Array:
        return np.asarray(values_in_bins(values).mean(axis=1)[is_complete])

    return SignalBins(
        mean_of_bins(data.t),
        mean_of_bins(data.travel),
        mean_of_bins(data.tension),
        mean_of_bins(speed),
        mean_of_bins(acceleration),
        count,
    )


def _central_rates(travel: Array, period: float, half_window: int) -> tuple[Array, Array]:
    """Compute the speed and the acceleration of a tendon from its travel by central differences, and return both.

    The difference at a sample uses the samples `half_window` control periods before and after this
    sample. At the two ends of the data, speed and acceleration are zero.
    """
    speed = np.zeros_like(travel)
    acceleration = np.zeros_like(travel)
    travel_after = travel[2 * half_window :]
    travel_before = travel[: -2 * half_window]
    centre = travel[half_window:-half_window]
    speed[half_window:-half_window] = (travel_after - travel_before) / (2 * half_window * period)
    acceleration[half_window:-half_window] = (travel_after - 2.0 * centre + travel_before) / (
        half_window * period
    ) ** 2
    return np.nan_to_num(speed), np.nan_to_num(acceleration)


@dataclass(frozen=True, slots=True)
class DigitLoad:
    """Constants of the load model for a digit with one tendon and n joints.

    Attributes:
        arms: moment arm of the tendon at each joint [m]. If a moment arm depends on the joint
            angle, the value is the mean moment arm over the angles.
        spring: spring stiffness [N m/rad].
        preload: preload of the springs [rad].
        damping: joint damping [N m s/rad].
        wrap_angle: wrap angle of the tendon before the first pulley [rad].
        inertia: (grid, n) torque at each joint, divided by the common acceleration of all joints,
            at the angles of the table.
        weight: (grid, n) torque of the weight at each joint, at the angles of the table [N m].
        varying_arm_digit: model of the digit if its moment arms depend on the joint angles, or None
            otherwise.
    """

    arms: Array
    spring: Array
    preload: Array
    damping: Array
    wrap_angle: float
    inertia: Array
    weight: Array
    varying_arm_digit: DigitModel | None = None

    @staticmethod
    def from_digit(digit: DigitModel) -> "DigitLoad":
        """Return the constants of a digit for the load model."""
        n = digit.joint_count
        return DigitLoad(
            arms=np.asarray(digit.moment_arms[0]),
            spring=np.array(digit.spring_stiffness),
            preload=np.array(digit.spring_preload),
            damping=np.array(digit.joint_damping),
            wrap_angle=float(digit.wrap[0]),
            inertia=np.array(
                [mass_matrix(digit, [q] * n).sum(axis=1) for q in TABLE_ANGLES_RAD.tolist()]
            ),
            weight=np.array([gravity_torque(digit, [q] * n) for q in TABLE_ANGLES_RAD.tolist()]),
            varying_arm_digit=digit if digit.has_varying_arm else None,
        )

    def mean_angle(self, excursion: Array) -> Array:
        """Return the angle (m,) of each joint at an excursion (m,) of the tendon, if all joints turn equally [rad]."""
        if self.varying_arm_digit is None:
            return np.asarray(excursion / self.arms.sum())
        grid = [
            float(self.varying_arm_digit.excursion_at_angles(np.full(len(self.arms), angle))[0])
            for angle in TABLE_ANGLES_RAD.tolist()
        ]
        return np.interp(excursion, grid, TABLE_ANGLES_RAD)

    def _arm_slope_and_excursion(
        self, i: int, q: Array
    ) -> tuple[Array | float, Array | float, Array]:
        """Return the moment arm [m], its derivative [m/rad] and the excursion [m] of joint i at angles (m,) [rad]."""
        if self.varying_arm_digit is None:
            arm = float(self.arms[i])
            return arm, 0.0, arm * q
        polynomial = self.varying_arm_digit.arm_polynomials[:1, i : i + 1]
        limits = self.varying_arm_digit.joint_limits[:, i : i + 1]
        angle = q[:, None]
        arms_at_angle = moment_arms_at(polynomial, limits, angle)[:, 0, 0]
        arm_after_step = moment_arms_at(polynomial, limits, angle + DIFFERENCE_STEP_RAD)[:, 0, 0]
        return (
            arms_at_angle,
            (arm_after_step - arms_at_angle) / DIFFERENCE_STEP_RAD,
            joint_excursions(polynomial, limits, angle)[:, 0, 0],
        )

    def expected_tension(self, p: LoadParameters, mean_samples: SignalBins) -> Array:
        """Return the tension that the load cell should measure while the digit moves freely (m,) [N]."""
        total = self.arms.sum()
        mean = np.clip(self.mean_angle(mean_samples.travel - p.offset), 0.0, TABLE_ANGLES_RAD[-1])
        rate = mean_samples.speed / total
        acceleration = mean_samples.acceleration / total
        load_torques = [
            p.damping * self.damping[i] * rate
            + p.mass
            * (
                np.interp(mean, TABLE_ANGLES_RAD, self.inertia[:, i]) * acceleration
                + np.interp(mean, TABLE_ANGLES_RAD, self.weight[:, i])
            )
            for i in range(len(self.arms))
        ]
        friction_exponent = -p.friction * np.sign(mean_samples.speed)
        stiffness = p.spring * self.spring
        q = [mean.copy() for _ in self.arms]
        f = np.full_like(mean, 10.0)
        # Newton's method changes the tension until the model gives the measured travel of the
        # tendon. For a given tension, the joint angles are computed one by one, beginning at the
        # palm.
        for _ in range(NEWTON_STEPS):
            angle = np.full_like(mean, self.wrap_angle)
            excursion = f / p.stiffness
            slope = np.full_like(mean, 1.0 / p.stiffness)
            for i in range(len(self.arms)):
                friction_factor = np.exp(
                    np.clip(
                        friction_exponent * (angle + q[i]),
                        -MAX_FRICTION_EXPONENT,
                        MAX_FRICTION_EXPONENT,
                    )
                )
                arm, arm_derivative, _ = self._arm_slope_and_excursion(i, q[i])
                rest_tension = (
                    (arm - arm_derivative * q[i]) * f * friction_factor
                    - load_torques[i]
                    - stiffness[i] * p.preload * self.preload[i]
                )
                # A moment arm that increases with the joint angle acts against the spring.
                held_tension = np.maximum(
                    stiffness[i] - arm_derivative * f * friction_factor,
                    MIN_STIFFNESS_FRACTION * stiffness[i],
                )
                q[i] = rest_tension / held_tension
                angle = angle + q[i]
                arm, _, taken_up = self._arm_slope_and_excursion(i, q[i])
                excursion = excursion + taken_up
                # `slope` is the derivative of the excursion with respect to the tension.
                slope = slope + arm * arm * friction_factor / held_tension
            f = np.maximum(f + (mean_samples.travel - p.offset - excursion) / slope, 0.1)
        return np.asarray(f)
