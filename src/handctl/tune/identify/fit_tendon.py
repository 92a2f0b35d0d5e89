"""Fit of all parameters of a tendon to all equations of its model at once.

The slow drift of the load cell is fitted together with the parameters.

Parameters are divided by their values in the hand file, so that they are of order 1. Residuals are
divided by the standard deviation of the load cell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from handctl.core.tendon_constants import motor_position_step
from handctl.errors import LogError
from handctl.hand.description import Hand
from handctl.hand.dynamics import DigitModel
from handctl.tune.identify.contact_detection import ResidualRamp, most_significant_ramp
from handctl.tune.identify.fit_load import DigitLoad, LoadParameters, SignalBins, average_in_bins
from handctl.tune.identify.fit_motor import MotorWindows, motor_windows
from handctl.tune.identify.least_squares import FitSolution, solve_least_squares
from handctl.tune.identify.tendon_data import Array, Mask, TendonData

PARAMETER_NAMES = (
    "torque_gain", "motor_inertia", "motor_viscous", "motor_coulomb", "delay",
    "tendon_stiffness", "spring_stiffness", "spring_preload", "capstan", "joint_damping", "link_mass",
    "stretch_offset", "stop_softness", "moment_arm", "pretension",
)  # fmt: skip
"""Names of a tendon's parameters in the order of the fit.

In the parameter vector of the fit, the drift of the load cell follows after the named parameters.
"""
LOAD_PARAMETERS = slice(
    PARAMETER_NAMES.index("tendon_stiffness"), PARAMETER_NAMES.index("stretch_offset") + 1
)
"""Indexes of the parameters that `fit_load.LoadParameters` contains."""
DELAY_SCALE_S = 1e-3
"""Scale of the parameter `delay` [s]."""
STRETCH_OFFSET_SCALE_M = 1e-4
"""Scale of the parameter `stretch_offset` [m]."""
PRIOR_DEVIATIONS = {"link_mass": 0.3, "stop_softness": 0.5, "stretch_offset": 100.0}
"""Prior standard deviation of each parameter for which prior knowledge exists, divided by the parameter's scale.

The masses of the links are well known, because the links were weighed. The stretch offset is
practically unknown.
"""
STOP_SOFTNESS = 0.04
"""Compliance of the open stop, as a fraction of the compliance of the tendon in the hand file.

Tendon and stop are springs in series, and no measurement separates them. Therefore the fit assumes
the compliance of the stop, with an uncertainty of half its value. In the packaged simulator the
compliance of the stops at the tendon is 3.8e-7 m/N, which is 0.038 of the tendon's compliance.
"""
DEFAULT_PRIOR_DEVIATION = 3.0
"""Prior standard deviation of all parameters that are not in `PRIOR_DEVIATIONS`, divided by their scale.

The prior keeps a fit finite if the data do not determine a parameter.
"""
TARE_SIGMA_N = 1.0
"""Prior standard deviation of the offset of a tared load cell [N]."""
DRIFT_KNOT_INTERVAL_S = 1.0
"""Time between the knots of the load cell's drift [s]."""
STOP_BIN_DURATIONS_S = (0.05, 0.45)
"""Smallest and largest duration of the bins of data at the open stop [s].

The largest duration is half of the duration in which the tension of a stretch rises.
"""
COUNTS_PER_STOP_BIN = 1.5
"""Number of encoder counts that the travel passes in a bin of data at the open stop.

With fewer counts, the rounding of the travel to counts does not average out, and the fitted
stiffness is too small. With bins of 0.3 counts, the stiffness of the hand t42 was 12 % too small.
"""
MIN_SCALED_PARAMETER = 0.02
"""Lower bound of scaled parameters that must be positive."""
MAX_SCALED_PARAMETER = 20.0
"""Upper bound of scaled parameters that must be positive."""
CONFIDENCE_LEVEL = 0.95
"""Confidence level of all intervals."""
MAX_HALF_WIDTH = 0.5
"""Largest half width of the confidence interval of an identified parameter, as a fraction of the value."""


@dataclass(frozen=True, slots=True)
class TendonFitProblem:
    """Input for the fit of a tendon.

    Attributes:
        spool_radius_m: radius of the spool [m].
        parameter_scales: (15,) scale of each parameter, usually the value in the hand file.
        digit_load: model of the digit, or None if the digit has several tendons or no springs.
        motor_windows: time windows of the motor equation.
        free_motion_bins: averaged data (bins) in which the digit moves freely.
        open_stop_bins: bins of data in which the digit is at the open stop.
        slack_tendon_bins: bins in which the tendon is slack.
        drift_knots: (k,) times of the knots of the drift of the load cell [s].
        cell_noise_N: standard deviation of a load-cell sample [N].
        drift_step_N: standard deviation of the change of the drift between two neighbouring
            ``drift_knots`` [N].
    """

    spool_radius_m: float
    parameter_scales: Array
    digit_load: DigitLoad | None
    motor_windows: MotorWindows
    free_motion_bins: SignalBins
    open_stop_bins: SignalBins
    slack_tendon_bins: SignalBins
    drift_knots: Array
    cell_noise_N: float
    drift_step_N: float

    @staticmethod
    def from_data(data: TendonData, hand: Hand) -> "TendonFitProblem":
        """Return the input of the fit for the data of a tendon.

        Raises:
            LogError: the tendon does not move enough in the log.
        """
        motor = hand.motor_of_tendon(data.tendon)
        digit = DigitModel.from_hand(hand, data.digit)
        spool = motor.spool_radius_m
        if not data.torque_mask.any() or len(data.t) < 2:
            raise LogError(f"{data.tendon} is never driven", "the log", "a run with the hand armed")
        duration_s = float(data.t[-1] - data.t[0])
        windows = motor_windows(data, spool)
        if len(windows.t) < 20:
            raise LogError(f"{data.tendon} hardly moves", "the log", "a run in which it moves")
        has_springs = any(digit.spring_stiffness)
        has_single_tendon = digit.moment_arms.shape[0] == 1
        # In a digit without springs, the joint encoders show how much the tendon is stretched, see
        # `fit_travel`.
        stop = data.stop & has_springs
        open_stop_bin_s = _stop_bin_duration(data, stop, motor_position_step(motor) * spool)
        return TendonFitProblem(
            spool_radius_m=spool,
            parameter_scales=parameter_scales(hand, data.tendon),
            digit_load=DigitLoad.from_digit(digit) if has_single_tendon and has_springs else None,
            motor_windows=windows,
            free_motion_bins=average_in_bins(data, data.free_motion_mask, is_moving=True),
            open_stop_bins=average_in_bins(data, stop, is_moving=False, bin_s=open_stop_bin_s),
            slack_tendon_bins=average_in_bins(
                data, data.slack, is_moving=False, bin_s=STOP_BIN_DURATIONS_S[0]
            ),
            drift_knots=np.linspace(
                data.t[0], data.t[-1], max(2, round(duration_s / DRIFT_KNOT_INTERVAL_S) + 1)
            ),
            cell_noise_N=_load_cell_noise(
                data.tension[data.slack | stop], hand.sensor_node.tension_noise_N
            ),
            # The drift is modelled as a random walk. The standard deviation of the random walk
            # increases with the square root of the time. The hand file contains the standard
            # deviation after 100 s.
            drift_step_N=max(hand.sensor_node.tension_bias_drift_N, 1e-3)
            * (DRIFT_KNOT_INTERVAL_S / 100.0) ** 0.5,
        )

    def start_parameters(self) -> Array:
        """Return the scaled start values of the fit: 15 parameters, and k values of the load-cell drift (15 + k,).

        The first 15 parameters start at the values from `parameter_scales`. The stretch offset is
        an exception, and starts at an estimate from the data. The last k parameters describe the
        drift of the load cell, and start at zero.
        """
        first_parameters = np.ones(len(PARAMETER_NAMES))
        first_parameters[PARAMETER_NAMES.index("delay")] = 1.0
        first_parameters[PARAMETER_NAMES.index("stretch_offset")] = (
            self._initial_stretch_offset() / STRETCH_OFFSET_SCALE_M
        )
        return np.append(first_parameters, np.zeros(len(self.drift_knots)))

    def parameter_bounds(self) -> tuple[Array, Array]:
        """Return the lower and the upper bounds of the scaled parameters.

        Only the delay and the stretch offset are allowed to be negative.
        """
        unbounded = np.full(len(PARAMETER_NAMES) + len(self.drift_knots), np.inf)
        low = -unbounded
        high = unbounded
        positive_indices = [
            i for i, name in enumerate(PARAMETER_NAMES) if name not in ("delay", "stretch_offset")
        ]
        low[positive_indices] = MIN_SCALED_PARAMETER
        high[positive_indices] = MAX_SCALED_PARAMETER
        return low, high

    def _initial_stretch_offset(self) -> float:
        """Return a first estimate of the stretch offset [m].

        If the log contains data at the open stop of the digit, the offset is estimated from these
        data. Without data at the open stop, the estimate is the smallest travel of the tendon in
        free motion.
        """
        stiffness = self.parameter_scales[PARAMETER_NAMES.index("tendon_stiffness")]
        if len(self.open_stop_bins.t):
            return float(
                np.mean(self.open_stop_bins.travel - self.open_stop_bins.tension / stiffness)
            )
        return float(self.free_motion_bins.travel.min()) if len(self.free_motion_bins.t) else 0.0

    def residuals(self, z: Array) -> Array:
        """Return the residuals (rows,) in standard deviations, in the order motor, stop, slack, free, drift, priors."""
        p = z[: len(PARAMETER_NAMES)] * self.parameter_scales
        drift = z[len(PARAMETER_NAMES) :]
        return np.concatenate([*self._data_residuals(p, drift), *self._prior_residuals(z, drift)])

    def _data_residuals(self, p: Array, drift: Array) -> list[Array]:
        """Return the residuals of the measured data in standard deviations, in the order motor, stop, slack, free."""
        gain, inertia, viscous, coulomb, delay, stiffness = p[:6].tolist()
        m = self.motor_windows
        r = self.spool_radius_m
        # In the motor equation, the tension is the driving force minus the forces of inertia and
        # friction.
        motor_torque = gain * m.delayed_command(delay)
        motor_losses = (
            inertia / r * m.acceleration + viscous / r * m.speed
        ) / r + coulomb / r * m.sign
        rows = [
            (motor_torque - motor_losses - (m.tension - self._load_cell_offset(m.t, drift)))
            / (self.cell_noise_N * m.noise_ratio)
        ]
        for bin_means, model in self._expected_tensions(p, stiffness):
            rows.append(
                # The standard deviation of a mean over n readings is the standard deviation of one
                # reading, divided by sqrt(n).
                (bin_means.tension - self._load_cell_offset(bin_means.t, drift) - model)
                / (self.cell_noise_N / bin_means.count**0.5)
            )
        return rows

    def _expected_tensions(self, p: Array, stiffness: float) -> list[tuple[SignalBins, Array]]:
        """Return the data bins of each condition (open stop, slack, free), with the expected tensions [N]."""
        rows = [
            (
                self.open_stop_bins,
                stop_stiffness(
                    stiffness, p[PARAMETER_NAMES.index("stop_softness")], self.parameter_scales
                )
                * (self.open_stop_bins.travel - p[PARAMETER_NAMES.index("stretch_offset")]),
            ),
            (self.slack_tendon_bins, np.zeros_like(self.slack_tendon_bins.t)),
        ]
        if self.digit_load is not None and len(self.free_motion_bins.t):
            rows.append(
                (
                    self.free_motion_bins,
                    self.digit_load.expected_tension(
                        LoadParameters(*p[LOAD_PARAMETERS].tolist()), self.free_motion_bins
                    ),
                )
            )
        return rows

    def _load_cell_offset(self, t: Array, drift: Array) -> Array:
        """Return the offset of the load cell at the given times [N]."""
        return np.asarray(np.interp(t, self.drift_knots, drift))

    def _prior_residuals(self, z: Array, drift: Array) -> list[Array]:
        """Return the residuals of the load-cell drift and of the prior knowledge about the parameters."""
        prior_deviations = np.array(
            [PRIOR_DEVIATIONS.get(name, DEFAULT_PRIOR_DEVIATION) for name in PARAMETER_NAMES]
        )
        return [
            np.diff(drift) / self.drift_step_N,
            drift[:1] / TARE_SIGMA_N,
            (z[: len(PARAMETER_NAMES)] - 1.0) / prior_deviations,
        ]


def parameter_scales(hand: Hand, tendon: str) -> Array:
    """Return the scales of a tendon's parameters (15,).

    The scale of a parameter is usually its value in the hand file.
    """
    tendon_section = hand.tendon[hand.tendon_names.index(tendon)]
    motor = hand.motor_of_tendon(tendon)
    value_scales = np.array([
        1.0, motor.inertia_kg_m2, motor.viscous_N_m_s_per_rad, motor.coulomb_N_m, DELAY_SCALE_S,
        tendon_section.stiffness_N_per_m, 1.0, 1.0, tendon_section.friction_coefficient, 1.0, 1.0,
        STRETCH_OFFSET_SCALE_M, STOP_SOFTNESS, 1.0, tendon_section.pretension_N or 1.0,
    ])  # fmt: skip
    # Even a parameter whose value in the hand file is zero needs a scale that is not zero.
    return np.where(value_scales > 0.0, value_scales, 1e-3)


def stop_stiffness(stiffness: float, relative_compliance: float, nominal_stiffness: Array) -> float:
    """Return the common stiffness of the tendon and the open stop [N/m].

    The tendon and the open stop act like springs in series.
    """
    # The compliance of springs in series is the sum of their compliances.
    return stiffness / (
        1.0
        + relative_compliance
        * stiffness
        / float(nominal_stiffness[PARAMETER_NAMES.index("tendon_stiffness")])
    )


@dataclass(frozen=True, slots=True)
class TendonFit:
    """Result of the fit of a tendon's parameters.

    Attributes:
        problem: input of the fit.
        z: scaled parameters, followed by the drift of the load cell.
        covariance: covariance of the scaled parameters.
        degrees_of_freedom: degrees of freedom of the variance of each parameter.
        sensitivity: (rows, 15) weighted Jacobian of the rows with measured data.
        residual: (rows,) residuals, including the residuals of the priors.
        ramp: ramp of tension in the residuals of the free sweeps, or None without free sweeps.
    """

    problem: TendonFitProblem
    z: Array
    covariance: Array
    degrees_of_freedom: Array
    sensitivity: Array
    residual: Array
    ramp: ResidualRamp | None = None

    @property
    def parameter_values(self) -> dict[str, float]:
        """Return the fitted parameters in SI units, by the name of the parameter.

        A parameter that is a factor for a value of the hand file has no unit.
        """
        return dict(
            zip(
                PARAMETER_NAMES,
                (self.z[: len(PARAMETER_NAMES)] * self.problem.parameter_scales).tolist(),
                strict=True,
            )
        )

    @property
    def half_widths(self) -> dict[str, float]:
        """Return half of the width of the 95 % confidence interval of each parameter.

        Each half width has the unit of its parameter.
        """
        return self.simultaneous_half_widths(1)

    def simultaneous_half_widths(self, parameter_count: int) -> dict[str, float]:
        """Return half of the width of each parameter's simultaneous confidence interval.

        With a probability of 95 %, all of `parameter_count` parameters are in their intervals at
        the same time.

        Source: Sidak (1967). If the parameters are not independent of each other, the simultaneous
        intervals are wider than necessary.
        """
        standard_deviations = (
            np.sqrt(np.diag(self.covariance))[: len(PARAMETER_NAMES)]
            * self.problem.parameter_scales
        )
        student_t_factor = student.ppf(
            0.5 + 0.5 * CONFIDENCE_LEVEL ** (1.0 / parameter_count),
            self.degrees_of_freedom[: len(PARAMETER_NAMES)],
        )
        return dict(
            zip(PARAMETER_NAMES, (student_t_factor * standard_deviations).tolist(), strict=True)
        )


def fit_tendon(problem: TendonFitProblem) -> TendonFit:
    """Fit all parameters of a tendon, and search for a contact in the residuals of the fit."""
    times = _row_times(problem)
    solution = solve_least_squares(
        problem.residuals, problem.start_parameters(), problem.parameter_bounds(), times
    )
    sensitivity = solution.jacobian[: len(times), : len(PARAMETER_NAMES)]
    residual_ramp = _unexplained_ramp(problem, solution)
    return TendonFit(
        problem,
        solution.z,
        solution.covariance,
        solution.degrees_of_freedom,
        sensitivity,
        solution.residual,
        residual_ramp,
    )


def _unexplained_ramp(problem: TendonFitProblem, solution: FitSolution) -> ResidualRamp | None:
    """Return the most significant tension ramp in the residuals of the sweeps in free motion.

    If the digit made no sweeps in free motion, return None.
    """
    free_bins = problem.free_motion_bins
    load = problem.digit_load
    if load is None or not len(free_bins.t):
        return None
    first_residual = (
        len(problem.motor_windows.t)
        + len(problem.open_stop_bins.t)
        + len(problem.slack_tendon_bins.t)
    )
    offset = float(solution.z[PARAMETER_NAMES.index("stretch_offset")]) * STRETCH_OFFSET_SCALE_M
    stiffness = float(
        solution.z[PARAMETER_NAMES.index("tendon_stiffness")]
        * problem.parameter_scales[PARAMETER_NAMES.index("tendon_stiffness")]
    )
    angle = load.mean_angle(free_bins.travel - offset - free_bins.tension / stiffness)
    unit = np.full(len(free_bins.t), free_bins.count**0.5 / problem.cell_noise_N)
    return most_significant_ramp(
        solution.jacobian, solution.residual, first_residual, np.asarray(angle), (unit,)
    )


def _row_times(problem: TendonFitProblem) -> Array:
    """Return the time of every row of measured data, in the order of the residuals."""
    time_arrays = [problem.motor_windows.t, problem.open_stop_bins.t, problem.slack_tendon_bins.t]
    if problem.digit_load is not None and len(problem.free_motion_bins.t):
        time_arrays.append(problem.free_motion_bins.t)
    return np.concatenate(time_arrays)


def _stop_bin_duration(data: TendonData, stop: Mask, count_m: float) -> float:
    """Return the duration of one data bin at the open stop [s].

    Args:
        data: data of the tendon.
        stop: (n,) True if the digit is at the open stop.
        count_m: travel of the tendon for one count of the encoder [m].
    """
    shortest_s, longest_s = STOP_BIN_DURATIONS_S
    lag = round(longest_s / data.period)
    both_ends = stop[lag:] & stop[:-lag]
    travel_changes = np.abs(data.travel[lag:] - data.travel[:-lag])[both_ends]
    # During the rise of a tension, the change of the travel is largest. If the tension first rises
    # and then falls, the travel changes less.
    largest_change = float(np.nanmax(travel_changes, initial=0.0))
    if largest_change <= 0.0:
        return shortest_s
    duration_s = COUNTS_PER_STOP_BIN * count_m / largest_change * longest_s
    return float(np.clip(duration_s, shortest_s, longest_s))


def _load_cell_noise(quiet_readings: Array, nominal_noise: float) -> float:
    """Return the standard deviation of a load-cell reading, estimated from pairs of neighbouring readings [N].

    Args:
        quiet_readings: tensions at rest and during slow stretches, where neighbouring readings differ only
            by noise [N].
        nominal_noise: standard deviation that the hand file states [N]. If there are too few
            readings, the standard deviation of the hand file is returned.
    """
    quiet_readings = quiet_readings[np.isfinite(quiet_readings)]
    return (
        nominal_noise
        if len(quiet_readings) < 200
        else max(float(np.std(np.diff(quiet_readings))) / 2**0.5, 0.1 * nominal_noise, 1e-3)
    )


def merge_solution(
    fit: TendonFit,
    solution: FitSolution,
    row_count: int,
    parameter_names: tuple[str, ...],
    source_rows: Sequence[int],
) -> TendonFit:
    """Return a copy of a fit, in which the results of an independent fit replace the named parameters.

    Args:
        fit: fit of one tendon's parameters.
        solution: result of the independent fit.
        row_count: number of data rows of the independent fit.
        parameter_names: names of the parameters to replace.
        source_rows: indices of the named parameters in ``solution``.
    """
    target = [PARAMETER_NAMES.index(name) for name in parameter_names]
    z = fit.z.copy()
    covariance = fit.covariance.copy()
    degrees_of_freedom = fit.degrees_of_freedom.copy()
    z[target] = solution.z[source_rows]
    degrees_of_freedom[target] = solution.degrees_of_freedom[source_rows]
    # Because the two fits are independent, the covariance between their parameters is zero.
    covariance[target, :] = covariance[:, target] = 0.0
    covariance[np.ix_(target, target)] = solution.covariance[np.ix_(source_rows, source_rows)]
    added_jacobian_rows = np.zeros((row_count, len(PARAMETER_NAMES)))
    added_jacobian_rows[:, target] = solution.jacobian[:row_count, source_rows]
    return replace(
        fit,
        z=z,
        covariance=covariance,
        degrees_of_freedom=degrees_of_freedom,
        sensitivity=np.vstack([fit.sensitivity, added_jacobian_rows]),
    )


def add_model_error(fit: TendonFit, error_of_parameter: Mapping[str, float]) -> TendonFit:
    """Return a fit whose variances also contain the errors of the model.

    Errors of the model cannot be seen in the scatter of the residuals.

    Args:
        fit: fit of a tendon's parameters.
        error_of_parameter: standard deviation of each parameter that is caused by errors of the model, as a
            fraction of the value.
    """
    covariance = fit.covariance.copy()
    for name, error in error_of_parameter.items():
        parameter_index = PARAMETER_NAMES.index(name)
        covariance[parameter_index, parameter_index] += (error * fit.z[parameter_index]) ** 2
    return replace(fit, covariance=covariance)
