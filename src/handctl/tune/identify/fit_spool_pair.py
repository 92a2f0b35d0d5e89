"""Fit of the parameters of a spool pair without load cells, from motor torque, spool angle and joint encoders.

    u(t - d) = J/r w' + b/r w + tau_c/r sgn w + F          motor, windowed as in `fit_motor`
    F = n(load; p, mu)                                     free motion
    g(F; k, p) = x - m s(q) - o                            on a stop, and in free motion

F is the net tension at the spool. The force n of the load is the sum of the inertia, the weight and
the damping of the links, and the friction of both tendons. In free motion, the net tension F equals
the load n. The stretch of the pair is the travel of the spool minus the excursion of the joints.
The characteristic g gives the stretch at a net tension F. Each tendon has the stiffness k. While
both tendons are taut, the stiffness of the pair is 2 k. If the net tension F exceeds twice the
pretension p, one tendon is slack, and the stiffness of the pair is k. At a tension called the knee,
the stiffness of a tendon changes. Beyond the knee, the stiffness in the hand file is multiplied by
the same factor as k.

No sensor of a spool pair measures a force. Therefore all forces are measured in units of the
drive's torque. If a motor makes 10 % less torque than commanded, inertia, friction and tendon
stiffness seem to be 10 % larger.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from handctl.errors import LogError
from handctl.hand.description import Hand
from handctl.hand.digit import Array, DigitModel
from handctl.hand.link_tree import LinkTree
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED_M_S, TendonElasticity
from handctl.tune.identify.fit_load import SignalBins
from handctl.tune.identify.fit_motor import (
    MotorWindows,
    WindowWeights,
    motor_windows,
    speed_from_difference,
)
from handctl.tune.identify.fit_tendon import (
    DEFAULT_PRIOR_DEVIATION,
    MAX_SCALED_PARAMETER,
    MIN_SCALED_PARAMETER,
    PARAMETER_NAMES,
    STRETCH_OFFSET_SCALE_M,
    TendonFit,
    TendonFitProblem,
    add_model_error,
    parameter_scales,
)
from handctl.tune.identify.fit_travel import SENSOR_SKEW_S, tendon_excursions
from handctl.tune.identify.least_squares import (
    MIN_DEGREES_OF_FREEDOM,
    OUTLIER_RESIDUAL,
    FitSolution,
    solve_least_squares,
)
from handctl.tune.identify.tendon_data import TendonData

SPOOL_PAIR_PARAMETERS = (
    "motor_inertia", "motor_viscous", "motor_coulomb", "delay", "tendon_stiffness", "capstan", "moment_arm",
    "joint_damping", "link_mass", "pretension", "stretch_offset",
)  # fmt: skip
"""Names of the parameters in the fit of a spool pair.

In the parameter vector of the fit, two parameters follow after the named parameters: the error of
the model's link inertia, and the time difference of the encoders.
"""
SPOOL_PAIR_PRIOR_DEVIATIONS = {
    "link_mass": 0.5, "joint_damping": 0.4, "pretension": 0.5, "tendon_stiffness": 1.0, "stretch_offset": 100.0,
}  # fmt: skip
"""Prior standard deviation of parameters of a spool pair, divided by the scale of the parameter.

The links were weighed, but in the units of this fit the masses of the links are divided by the
unknown torque gain. The damping of a joint and the viscous friction of its motor have the same
effect. Without a prior for the pretension, a pair with two taut tendons could not be distinguished
from a pair of twice the stiffness with one slack tendon.
"""
SPOOL_PAIR_MODEL_ERROR = {
    "motor_viscous": 0.15, "motor_coulomb": 0.045, "capstan": 0.045, "pretension": 0.03, "tendon_stiffness": 0.02,
}  # fmt: skip
"""Standard deviation of the errors of the model by parameter, as a fraction of the value.

From the data, friction of the motor and friction of the tendons are hard to separate. The values
were chosen in simulations of 60 random hands, with 169 spool pairs.
"""
LOAD_INERTIA_SIGMA = 0.05
"""Standard deviation of the error of the model's link inertia, as a fraction of the inertia of the rotor.

Rotor and links accelerate together. Therefore only the model of the links can separate the inertia
of the rotor from the inertia of the links.
"""
LINK_INERTIA_ERROR = 0.13
"""Standard deviation of the rotor-inertia error that the links cause, as a fraction of the links' inertia.

If the links are heavier than the rotor, a small error of the links is a large error of the rotor.
The model of the fit does not include the error that the links cause. Therefore the confidence
interval of the rotor's inertia is widened after the fit.
"""
INITIAL_NOISE_N = 0.3
"""Assumed standard deviation of the motor equation's residuals in the first fit [N].

The second fit uses the standard deviation that the residuals of the first fit show.
"""
MIN_NOISE_N = 0.02
"""Smallest standard deviation that the fit uses for the residuals of the motor equation [N]."""
PRETENSION_START_FACTORS = (1.0, 1.5, 2.2)
"""Factors by which the pretension in the hand file is multiplied. The fit is started once with each product."""
STRETCH_GRID_POINTS = 65
"""Number of points at which the net tension of a pair is computed, to find the stretch at a net tension."""
MIN_READINGS = 3
"""Smallest number of joint readings in a window whose stretch the fit uses."""


@dataclass(frozen=True, slots=True)
class SpoolPairWindows:
    """Signals of a spool pair, averaged with a time window.

    Each array has one value per window, shape (m,).

    Attributes:
        motor: windows of the motor equation. In the windows of a spool pair, the tension is not
            known.
        is_free: True if the digit moves freely, and False if the pair is stretched while the digit is
            pressed against a stop.
        inertial_tension: net tension that is necessary at the joints because of inertia and weight [N].
        damping_tension: net tension that is necessary at the joints because of joint damping [N].
        wrap_angle: wrap angle of the pair [rad].
        friction_fraction: friction of the tendons with its sign, as a fraction of the friction at
            high speed.
        travel: mean travel of the spool at the times at which the joint encoders were read [m].
        excursion: mean excursion at the times of the joint readings, computed with the moment arms
            of the hand file [m]. If there are too few readings, the excursion is NaN.
        reading_count: effective number of joint-encoder readings in each window.
        link_inertia_kg: inertia of the links as a mass that moves with the tendon, at the rest
            angles [kg].
    """

    motor: MotorWindows
    is_free: NDArray[np.bool_]
    inertial_tension: Array
    damping_tension: Array
    wrap_angle: Array
    friction_fraction: Array
    travel: Array
    excursion: Array
    reading_count: Array
    link_inertia_kg: float

    @staticmethod
    def from_data(
        hand: Hand,
        digit: DigitModel,
        tendon: int,
        data_of_tendons: Sequence[TendonData],
        rest_angles: Array,
    ) -> "SpoolPairWindows":
        """Return the signals of a spool pair, averaged with time windows.

        Args:
            hand: description of the hand.
            digit: model of the digit.
            tendon: index of the pair among the pairs of the digit.
            data_of_tendons: data of all pairs of the digit, in their order.
            rest_angles: (J,) angles of all joints [rad]. The joints of the other digits keep their
                rest angles.

        Raises:
            LogError: the pair hardly moves.
        """
        own_data = data_of_tendons[tendon]
        spool = hand.motor_of_tendon(own_data.tendon).spool_radius_m
        windows = motor_windows(replace(own_data, tension=np.zeros_like(own_data.travel)), spool)
        weights = WindowWeights.from_period(own_data.period)
        rows = (
            np.rint((windows.t - own_data.t[0]) / own_data.period).astype(int)[:, None]
            + weights.samples
        )
        is_on_stop = own_data.stop[rows]
        is_window_usable = np.asarray(is_on_stop.all(axis=1) | ~is_on_stop.any(axis=1))
        mean_derivatives = np.array(
            [weights.derivatives(pair.travel[rows]) for pair in data_of_tendons]
        )
        is_window_usable &= np.isfinite(mean_derivatives).all(axis=(0, 1))
        windows, rows = select_windows(windows, is_window_usable), rows[is_window_usable]
        if len(windows.t) < 20:
            raise LogError(f"{own_data.tendon} hardly moves", "the log", "a run in which it moves")
        q, dq, ddq = _joint_motion(digit, mean_derivatives[:, :, is_window_usable], data_of_tendons)
        tree = LinkTree.from_hand(hand)
        rigid_body_torque = np.array(
            [
                _torque_of_digit(tree, digit, rest_angles, *row)
                for row in zip(q, dq, ddq, strict=True)
            ]
        )
        torque_to_tension = digit.torque_to_tension[tendon]
        mass_matrix = tree.mass_matrix(rest_angles)[digit.joints, digit.joints]
        quick_speed = speed_from_difference(own_data.travel, own_data.period)[rows]
        travel, excursion, readings = _stretch_readings(digit, tendon, own_data, rows, weights)
        return SpoolPairWindows(
            motor=windows,
            is_free=~own_data.stop[rows].any(axis=1),
            inertial_tension=rigid_body_torque @ torque_to_tension,
            damping_tension=(dq * np.array(digit.joint_damping)) @ torque_to_tension,
            wrap_angle=_mean_wrap_angles(digit, tendon, q),
            friction_fraction=np.tanh(quick_speed / CAPSTAN_FRICTION_SPEED_M_S) @ weights.mean,
            travel=travel,
            excursion=excursion,
            reading_count=readings,
            link_inertia_kg=float(torque_to_tension @ mass_matrix @ torque_to_tension),
        )


def _mean_wrap_angles(digit: DigitModel, tendon: int, q: Array) -> Array:
    """Return the mean wrap angle (m,) of a pair over its pulleys, at the joint angles q (m, joints) [rad].

    The wrap angle at a pulley is the wrap angle before the digit, plus the angles of all joints that
    the pair passes up to the pulley. In the mean, the weight of a pulley is the fraction of the net
    tension that acts through this pulley.
    """
    passes_joint = digit.moment_arms[tendon] != 0.0
    wrap_angles = digit.wrap[tendon] + np.cumsum(
        np.where(passes_joint & ~digit.is_prismatic, q, 0.0), axis=1
    )
    weights = digit.moment_arms[tendon] * digit.torque_to_tension[tendon]
    return np.asarray(wrap_angles @ weights / weights.sum())


def select_windows(windows: MotorWindows, selection_mask: NDArray[np.bool_]) -> MotorWindows:
    """Select the windows of a motor for which ``selection_mask`` is True, and return them."""
    field_names = ("t", "tension", "acceleration", "speed", "sign", "commands")
    return replace(
        windows, **{name: getattr(windows, name)[selection_mask] for name in field_names}
    )


def _joint_motion(
    digit: DigitModel,
    mean_derivatives: Array,
    data_of_tendons: Sequence[TendonData],
) -> tuple[Array, Array, Array]:
    """Compute the joint motion of a digit from the motion of its spool pairs, and return three arrays (m, joints).

    The three arrays are the angles, the rates and the accelerations of the joints. The argument
    `mean_derivatives` (n_t, 3, m) contains the travel, the speed and the acceleration of each pair.
    The joint motion is computed without the stretch of the tendons. The joint angles are shifted so
    that their mean equals the mean of the joint readings. Without joint readings, the calibrated
    motor zeros determine the joint angles.
    """
    travel, speed, acceleration = (mean_derivatives[:, i].T for i in range(3))
    joints_from_excursions = digit.excursion_to_joints.T
    angles = np.column_stack([pair.travel for pair in data_of_tendons]) @ joints_from_excursions
    offset = (
        np.nanmean(data_of_tendons[0].joints - angles, axis=0)
        if np.isfinite(data_of_tendons[0].joints).any()
        else 0.0
    )
    return (
        travel @ joints_from_excursions + offset,
        speed @ joints_from_excursions,
        acceleration @ joints_from_excursions,
    )


def _torque_of_digit(
    tree: LinkTree, digit: DigitModel, rest_angles: Array, q: Array, dq: Array, ddq: Array
) -> Array:
    """Return the torques (joints,) that are necessary because of the inertia and the weight of a digit's links [N m].

    The torques include the links of all digits that the given digit carries.
    """
    motion = np.zeros((3, len(rest_angles)))
    motion[0] = rest_angles
    motion[:, digit.joints] = q, dq, ddq
    return np.asarray(tree.inverse_dynamics(*motion)[digit.joints])


def _stretch_readings(
    digit: DigitModel,
    tendon: int,
    data: TendonData,
    window_rows: NDArray[np.intp],
    weights: WindowWeights,
) -> tuple[Array, Array, Array]:
    """Return the travel and the excursion (m,) in windows, at the times at which the joint encoders were read [m].

    The third result is the effective number of joint-encoder readings in each window (m,).

    While a pair is stretched against a stop, its travel changes, but its excursion does not. In a
    window of a stretch, the travel is averaged over all ticks, and not only over the times of the
    joint readings.
    """
    has_reading: NDArray[np.bool_] = np.asarray(np.isfinite(data.joints).all(axis=1))
    excursion = np.where(
        has_reading, tendon_excursions(digit, tendon, np.nan_to_num(data.joints)), 0.0
    )
    weight = weights.mean * has_reading[window_rows]
    weight_sum = np.maximum(weight.sum(axis=1), 1e-12)
    travel = (data.travel[window_rows] * weight).sum(axis=1) / weight_sum
    count = has_reading[window_rows].sum(axis=1)
    is_on_stop = data.stop[window_rows].all(axis=1)
    travel = np.where(is_on_stop, data.travel[window_rows] @ weights.mean, travel)
    known_stretch = np.where(
        count >= MIN_READINGS, (excursion[window_rows] * weight).sum(axis=1) / weight_sum, np.nan
    )
    # The number of readings is an effective number, because the window gives different weights to
    # the readings.
    return travel, known_stretch, weight_sum**2 / np.maximum((weight**2).sum(axis=1), 1e-12)


def spool_pair_tension(net_tension: Array, pretension: float, pulley_ratios: Array) -> Array:
    """Return the net tension at the spool (m,) that is necessary for a given net tension at a joint [N].

    Args:
        net_tension: net tension at the joint (m,) [N].
        pretension: pretension of both tendons [N].
        pulley_ratios: tension of the first tendon behind the pulleys, divided by the tension of this
            tendon at the spool.

    The formula of the tension is the same as in `core.estimation.spool_pair`, but for arrays.
    """
    tension_if_both_taut = (
        2.0
        * (net_tension + pretension * (1.0 / pulley_ratios - pulley_ratios))
        / (pulley_ratios + 1.0 / pulley_ratios)
    )
    single_tension = np.where(
        tension_if_both_taut > 0.0, net_tension / pulley_ratios, net_tension * pulley_ratios
    )
    return np.where(
        np.abs(tension_if_both_taut) < 2.0 * pretension, tension_if_both_taut, single_tension
    )


def spool_pair_stretch(
    net_tension: Array, stiffness: float, pretension: float, elasticity: TendonElasticity
) -> Array:
    """Return the stretch of a spool pair (m,) [m]: the travel of the spool minus the excursion of the joints.

    The stretch lengthens the first tendon and shortens the second tendon, until the second tendon
    is slack. The net tension is the difference between the tensions of the two tendons.

    Args:
        net_tension: net tension of the pair (m,) [N].
        stiffness: stiffness of each tendon up to its knee [N/m].
        pretension: pretension of both tendons [N].
        elasticity: tension of a tendon over its stretch, as the hand file describes it. The
            function keeps the shape, and uses the given stiffness.
    """
    rest_stretch = elasticity.stretch(pretension)
    knee_stretch = elasticity.knee / elasticity.stiffness
    # If the second tendon is slack, the first tendon alone has the net tension.
    largest = max(
        elasticity.stretch(float(np.nanmax(np.abs(net_tension), initial=0.0))), 2.0 * rest_stretch
    )
    # Below the knee, the net tension is linear between these points of the stretch.
    corners = [rest_stretch, abs(knee_stretch - rest_stretch)]
    stretches = np.unique(np.append(np.linspace(0.0, largest, STRETCH_GRID_POINTS), corners))
    net_tensions = _elastic_tensions(elasticity, rest_stretch + stretches) - _elastic_tensions(
        elasticity, rest_stretch - stretches
    )
    nominal_stretch = np.sign(net_tension) * np.interp(np.abs(net_tension), net_tensions, stretches)
    return np.asarray(nominal_stretch * elasticity.stiffness / stiffness)


def _elastic_tensions(elasticity: TendonElasticity, stretches: Array) -> Array:
    """Return the elastic tensions of a tendon (m,) at stretches (m,) [N], see ``TendonElasticity``."""
    return np.array([elasticity.elastic_tension(stretch) for stretch in stretches.tolist()])


@dataclass(frozen=True, slots=True)
class SpoolPairProblem:
    """Input for the fit of a spool pair.

    Attributes:
        windows: signals of the pair, averaged with time windows.
        spool_radius_m: radius of the spool [m].
        elasticity: tension of a tendon over its stretch, as the hand file describes it.
        parameter_scales: (15,) scale of each parameter of `fit.PARAMETER_NAMES`.
        motor_noise: standard deviation of the residuals of the motor equation [N].
        reading_noise: standard deviation of an excursion that is computed from a single
            joint-encoder reading [m].
        start_parameters: scaled parameters at which the fit starts. The start parameters come from
            the hand file.
    """

    windows: SpoolPairWindows
    spool_radius_m: float
    elasticity: TendonElasticity
    parameter_scales: Array
    motor_noise: float
    reading_noise: float
    start_parameters: Array

    def parameter_value(self, z: Array, name: str) -> float:
        """Return the named parameter in SI units, or as a factor for a value of the hand file."""
        return float(
            z[SPOOL_PAIR_PARAMETERS.index(name)]
            * self.parameter_scales[PARAMETER_NAMES.index(name)]
        )

    def measured_tension(self, z: Array) -> Array:
        """Return the net tension (m,) that follows from the motor equation [N]."""
        m = self.windows.motor
        r = self.spool_radius_m
        inertia = self.parameter_value(z, "motor_inertia") * m.acceleration
        viscous = self.parameter_value(z, "motor_viscous") * m.speed
        coulomb = self.parameter_value(z, "motor_coulomb") * m.sign
        return np.asarray(
            m.delayed_command(self.parameter_value(z, "delay"))
            - (inertia + viscous) / r**2
            - coulomb / r
        )

    def tension_in_free_motion(self, z: Array) -> Array:
        """Return the net tension (m,) that links and tendon friction require in free motion [N]."""
        w = self.windows
        load = (
            self.parameter_value(z, "link_mass") * w.inertial_tension
            + self.parameter_value(z, "joint_damping") * w.damping_tension
        )
        rotor = (
            self.parameter_scales[PARAMETER_NAMES.index("motor_inertia")] / self.spool_radius_m**2
        )
        load = load + z[-2] * LOAD_INERTIA_SIGMA * rotor * w.motor.acceleration
        transmitted_ratio = np.exp(
            np.clip(
                -self.parameter_value(z, "capstan") * w.friction_fraction * w.wrap_angle, -3.0, 3.0
            )
        )
        return spool_pair_tension(
            load / self.parameter_value(z, "moment_arm"),
            self.parameter_value(z, "pretension"),
            transmitted_ratio,
        )

    def stretch(self, z: Array) -> Array:
        """Return the length (m,) by which the travel of the spool exceeds the excursion of the joints [m].

        If a window contains too few joint-encoder readings, the length is NaN.
        """
        w = self.windows
        travel_during_skew = np.where(w.is_free, z[-1] * SENSOR_SKEW_S * w.motor.speed, 0.0)
        return np.asarray(
            w.travel
            - self.parameter_value(z, "moment_arm") * w.excursion
            - self.parameter_value(z, "stretch_offset")
            - travel_during_skew
        )

    def residuals(self, z: Array) -> Array:
        """Return the residuals (rows,) in standard deviations, in the order motor, stretch, priors."""
        w = self.windows
        stiffness = self.parameter_value(z, "tendon_stiffness")
        pretension = self.parameter_value(z, "pretension")
        measured_tension = self.measured_tension(z)
        needed_tension = self.tension_in_free_motion(z)
        stretch_from_tension = spool_pair_stretch(
            np.where(w.is_free, needed_tension, measured_tension),
            stiffness,
            pretension,
            self.elasticity,
        )
        motor_residuals = (
            np.where(w.is_free, measured_tension - needed_tension, 0.0) / self.motor_noise
        )
        min_stiffness = (
            self.motor_noise / self.parameter_scales[PARAMETER_NAMES.index("tendon_stiffness")]
        )
        noise = np.hypot(
            self.reading_noise / np.sqrt(w.reading_count), np.where(w.is_free, 0.0, min_stiffness)
        )
        is_measured = np.isfinite(w.excursion)
        stretch_residuals = (
            np.where(is_measured, self.stretch(z) - stretch_from_tension, 0.0) / noise
        )
        prior_deviations = np.array(
            [
                *(
                    SPOOL_PAIR_PRIOR_DEVIATIONS.get(name, DEFAULT_PRIOR_DEVIATION)
                    for name in SPOOL_PAIR_PARAMETERS
                ),
                1.0,
                1.0,
            ]
        )
        return np.concatenate(
            [motor_residuals, stretch_residuals, (z - self.start_parameters) / prior_deviations]
        )

    def parameter_bounds(self) -> tuple[Array, Array]:
        """Return lower and upper bounds of the scaled parameters."""
        is_signed = np.array(
            [name in ("delay", "stretch_offset") for name in SPOOL_PAIR_PARAMETERS] + [True, True]
        )
        return np.where(is_signed, -np.inf, MIN_SCALED_PARAMETER), np.where(
            is_signed, np.inf, MAX_SCALED_PARAMETER
        )

    def with_estimated_noise(self, z: Array) -> "SpoolPairProblem":
        """Return the input of the fit, after a new estimate of the noise of the motor equation.

        The noise is estimated from the median of the absolute residuals.
        """
        w = self.windows
        free_residual = (self.measured_tension(z) - self.tension_in_free_motion(z))[w.is_free]
        size = (
            1.48 * float(np.median(np.abs(free_residual)))
            if len(free_residual)
            else self.motor_noise
        )
        return replace(self, motor_noise=max(size, MIN_NOISE_N))


def fit_spool_pair(
    hand: Hand, digit: DigitModel, tendon: int, pair_data: Sequence[TendonData]
) -> TendonFit:
    """Fit the parameters of a spool pair.

    Args:
        hand: description of the hand.
        digit: model of the digit.
        tendon: index of the pair among the pairs of the digit.
        pair_data: data of all pairs of the digit, in their order.

    Raises:
        LogError: the pair hardly moves.
    """
    own_data = pair_data[tendon]
    rest_angles = np.clip(np.zeros(len(hand.joints)), hand.joint_limits[0], hand.joint_limits[1])
    windows = SpoolPairWindows.from_data(hand, digit, tendon, pair_data, rest_angles)
    reading = hand.sensor_node.joint_noise_rad * float(np.linalg.norm(digit.moment_arms[tendon]))
    motor = hand.motor_of_tendon(own_data.tendon)
    value_scales = parameter_scales(hand, own_data.tendon)
    problem = SpoolPairProblem(
        windows,
        motor.spool_radius_m,
        TendonElasticity.from_tendon(hand.tendon[digit.tendons][tendon]),
        value_scales,
        INITIAL_NOISE_N,
        reading,
        _start_parameters(windows),
    )
    times = np.tile(windows.motor.t, 2)
    solutions = [
        solve_least_squares(problem.residuals, start, problem.parameter_bounds(), times)
        for start in _start_candidates(problem.start_parameters)
    ]
    first_solution = min(
        solutions, key=lambda solution: _robust_cost(problem.residuals(solution.z))
    )
    problem = problem.with_estimated_noise(first_solution.z)
    solution = solve_least_squares(
        problem.residuals, first_solution.z, problem.parameter_bounds(), times
    )
    rotor_inertia = problem.parameter_value(solution.z, "motor_inertia")
    link_inertia = windows.link_inertia_kg * motor.spool_radius_m**2
    inertia_error = {"motor_inertia": LINK_INERTIA_ERROR * link_inertia / rotor_inertia}
    return add_model_error(
        _as_tendon_fit(hand, problem, solution), SPOOL_PAIR_MODEL_ERROR | inertia_error
    )


def _start_parameters(windows: SpoolPairWindows) -> Array:
    """Return the scaled parameters at which the fit starts.

    The start parameters are the values in the hand file and a first estimate of the stretch offset.
    """
    first_parameters = np.ones(len(SPOOL_PAIR_PARAMETERS) + 2)
    is_measured = np.isfinite(windows.excursion)
    offset = (
        float(np.median(windows.travel[is_measured] - windows.excursion[is_measured]))
        if is_measured.any()
        else 0.0
    )
    first_parameters[SPOOL_PAIR_PARAMETERS.index("stretch_offset")] = (
        offset / STRETCH_OFFSET_SCALE_M
    )
    first_parameters[-2:] = 0.0
    return first_parameters


def _start_candidates(first_candidate: Array) -> list[Array]:
    """Return several start points of the fit, with different pretensions.

    If the pretension at the start of the fit is too small, the solver can find a wrong solution
    with one slack tendon and twice the true stiffness. The solver cannot leave the wrong solution
    in small steps.
    """
    start_candidates = []
    for factor in PRETENSION_START_FACTORS:
        start = first_candidate.copy()
        start[SPOOL_PAIR_PARAMETERS.index("pretension")] *= factor
        start_candidates.append(start)
    return start_candidates


def _robust_cost(residual: Array) -> float:
    """Return the cost of residuals by the soft L1 norm.

    With the soft L1 norm, outliers have little weight.
    """
    return float((np.sqrt(1.0 + (residual / OUTLIER_RESIDUAL) ** 2) - 1.0).sum())


def _as_tendon_fit(hand: Hand, problem: SpoolPairProblem, solution: FitSolution) -> TendonFit:
    """Return the result of the fit of a spool pair in the same form as the result of a single tendon."""
    windows = problem.windows
    count = len(PARAMETER_NAMES)
    target = [PARAMETER_NAMES.index(name) for name in SPOOL_PAIR_PARAMETERS]
    parameter_count = len(target)
    z = np.append(np.ones(count), (0.0, 0.0))
    z[target] = solution.z[:parameter_count]
    covariance = np.eye(count + 2) * DEFAULT_PRIOR_DEVIATION**2
    covariance[np.ix_(target, target)] = solution.covariance[:parameter_count, :parameter_count]
    degrees_of_freedom = np.full(count + 2, MIN_DEGREES_OF_FREEDOM)
    degrees_of_freedom[target] = solution.degrees_of_freedom[:parameter_count]
    sensitivity = np.zeros((2 * len(windows.motor.t), count))
    sensitivity[:, target] = solution.jacobian[: len(sensitivity), :parameter_count]
    measured_tension = problem.measured_tension(solution.z)
    empty_array = np.zeros(0)
    empty_bins = SignalBins(empty_array, empty_array, empty_array, empty_array, empty_array, 1)
    is_measured_in_contact = np.isfinite(windows.excursion) & ~windows.is_free
    t = windows.motor.t[is_measured_in_contact]
    rest_tension = np.zeros(len(t))
    stretch = problem.stretch(solution.z)[is_measured_in_contact]
    return TendonFit(
        problem=TendonFitProblem(
            spool_radius_m=problem.spool_radius_m,
            parameter_scales=problem.parameter_scales,
            digit_load=None,
            motor_windows=replace(
                windows.motor,
                tension=np.where(
                    windows.is_free, problem.tension_in_free_motion(solution.z), measured_tension
                ),
            ),
            free_motion_bins=empty_bins,
            open_stop_bins=SignalBins(
                t, stretch, measured_tension[is_measured_in_contact], rest_tension, rest_tension, 1
            ),
            slack_tendon_bins=empty_bins,
            drift_knots=windows.motor.t[[0, -1]],
            cell_noise_N=problem.motor_noise,
            drift_step_N=max(hand.sensor_node.tension_bias_drift_N, 1e-3),
        ),
        z=z,
        covariance=covariance,
        degrees_of_freedom=degrees_of_freedom,
        sensitivity=sensitivity,
        residual=solution.residual,
    )
