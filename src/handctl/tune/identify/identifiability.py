"""Identifiability of the parameters of a fit: which parameters the data do not determine or cannot distinguish.

The analysis uses the Jacobian of the data, scaled by the values of the hand file and by the noise
of the load cell. The solver returns a value for every parameter. But if a parameter or a
combination of parameters does not influence the residuals, the data do not determine the value.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import coherence

from handctl.core.identified_parameters import PARAMETER_UNITS
from handctl.hand.description import Hand
from handctl.tune.identify.fit_tendon import (
    DELAY_SCALE_S,
    MAX_HALF_WIDTH,
    PARAMETER_NAMES,
    TendonFit,
)
from handctl.tune.identify.tendon_data import Array, TendonData

MAX_CORRELATION = 0.95
"""Largest absolute correlation between two estimated parameters that is not reported as a trade-off."""
COHERENCE_SEGMENTS = 6
"""Number of time segments into which the excitation is divided, to average the coherence.

Without a division of the excitation, the coherence would always be 1.
"""
BALANCE_PARAMETERS = ("spring_stiffness", "spring_preload", "capstan", "joint_damping")
"""Parameters that only the balance of torques at the joints determines, if a digit has several tendons."""
MISSING_ENCODERS_REASON = "needs joint encoders"


@dataclass(frozen=True, slots=True)
class Identifiability:
    """Identifiability of a tendon's parameters.

    Attributes:
        names: names of the identified parameters.
        missing: parameters that the fit has not identified, each with the reason.
        rank: number of combinations of parameters that the data determine.
        columns: number of all combinations of parameters, which equals the number of parameters.
        condition_number: largest singular value of the Jacobian, divided by the smallest singular
            value.
        weakest_combination: combination of parameters that the data determine worst, as text.
        correlated_pairs: pairs of identified parameters whose errors are correlated, each with the
            correlation.
    """

    names: tuple[str, ...]
    missing: tuple[str, ...]
    rank: int
    columns: int
    condition_number: float
    weakest_combination: str
    correlated_pairs: tuple[tuple[str, str, float], ...]


def assess_identifiability(fit: TendonFit, hand: Hand, digit: str, tendon: str) -> Identifiability:
    """Return the identifiability of a tendon's parameters, computed from the fit of these parameters.

    Args:
        fit: fit of the tendon's parameters.
        hand: description of the hand.
        digit: name of the digit.
        tendon: name of the tendon.
    """
    unobservable_reasons = unobservable_parameters(hand, digit, tendon)
    jacobian = fit.sensitivity
    # Each right singular vector is a combination of parameters. The singular value of the vector
    # measures how much the data say about the combination.
    _, sizes, directions = np.linalg.svd(jacobian, full_matrices=False)
    half_widths = fit.half_widths
    values = fit.parameter_values
    names = tuple(
        name
        for name in PARAMETER_UNITS
        if name not in unobservable_reasons
        and _is_interval_narrow(name, values[name], half_widths[name])
        and _is_parameter_excited(jacobian, name)
    )
    reasons = {
        name: _reason_not_identified(jacobian, name)
        for name in PARAMETER_UNITS
        if name not in names
    } | unobservable_reasons
    if _lacks_needed_encoders(hand, digit):
        unexcited_names = (
            name for name in BALANCE_PARAMETERS if not _is_parameter_excited(jacobian, name)
        )
        reasons |= dict.fromkeys(unexcited_names, MISSING_ENCODERS_REASON)
    standard_deviations = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(standard_deviations, standard_deviations)
    pairs = [
        (a, b, float(correlation[PARAMETER_NAMES.index(a), PARAMETER_NAMES.index(b)]))
        for a in names
        for b in names
        if a < b
    ]
    return Identifiability(
        names=names,
        missing=(
            *(f"{name}: {reason}" for name, reason in reasons.items() if reason),
            *_unidentifiable_parameters(fit, hand, tendon),
        ),
        # A combination of parameters is counted if its 95 % confidence interval is as narrow as the
        # interval of an identified parameter.
        rank=int((1.96 / np.maximum(sizes, 1e-12) < MAX_HALF_WIDTH).sum()),
        columns=len(PARAMETER_NAMES),
        condition_number=float(sizes[0] / max(sizes[-1], 1e-12)),
        weakest_combination=_parameter_combination_text(directions[-1]),
        correlated_pairs=tuple(pair for pair in pairs if abs(pair[2]) > MAX_CORRELATION),
    )


def _lacks_needed_encoders(hand: Hand, digit: str) -> bool:
    """Return True if a digit has springs and several tendons, but no joint encoders.

    In a digit with several tendons, the tension of a single tendon does not show the load of the
    springs. The load of the springs follows from the torque balance of each joint. The torque
    balance contains the joint angle, which only a joint encoder can measure.
    """
    tendons = hand.digit_tendons[digit]
    has_springs = hand.digit_named(digit).has_springs
    has_several_tendons = tendons.stop - tendons.start > 1
    return (
        has_springs
        and has_several_tendons
        and not bool(np.all(hand.tendons_with_encoders[tendons]))
    )


def _is_interval_narrow(name: str, value: float, half_width: float) -> bool:
    """Return True if the confidence interval is so narrow that the parameter counts as identified.

    Half of the width of the interval is compared with the absolute value of the parameter. For the
    parameter `delay`, half of the width is compared with ``DELAY_SCALE_S``.
    """
    scale = DELAY_SCALE_S if name == "delay" else abs(value)
    return bool(half_width < MAX_HALF_WIDTH * scale)


def _is_parameter_excited(jacobian: Array, name: str) -> bool:
    """Return True if a parameter influences at least one row of the data."""
    return bool(np.linalg.norm(jacobian[:, PARAMETER_NAMES.index(name)]) > 1e-6)


def _reason_not_identified(jacobian: Array, name: str) -> str:
    """Return the reason why a parameter is not identified, as text."""
    if not _is_parameter_excited(jacobian, name):
        return "no data depend on this parameter"
    if name == "delay":
        return f"the 95 % interval is wider than {1e3 * MAX_HALF_WIDTH * DELAY_SCALE_S:g} ms to either side"
    return (
        f"the 95 % interval is wider than {100 * MAX_HALF_WIDTH:.0f} % of the value to either side"
    )


def unobservable_parameters(hand: Hand, digit: str, tendon: str) -> dict[str, str]:
    """Return the parameters that the sensors of a hand cannot identify, each with the reason.

    If the tendon lacks a parameter, the reason for this parameter is an empty text.

    Args:
        hand: description of the hand.
        digit: name of the digit.
        tendon: name of the tendon.
    """
    index = hand.tendon_names.index(tendon)
    is_pair = bool(hand.is_pair[index])
    has_springs = hand.digit_named(digit).has_springs
    reason_by_parameter = {} if is_pair else {"pretension": ""}
    if is_pair:
        reason_by_parameter["torque_gain"] = (
            "without a load cell the torque of the drive is the unit of all forces"
        )
    if not has_springs:
        reason_by_parameter |= dict.fromkeys(
            ("spring_stiffness", "spring_preload"), "the hand file has no springs"
        )
    if has_springs:
        reason_by_parameter["moment_arm"] = (
            "it trades off with springs and stretch, so the moment arms of the hand file are used"
        )
    elif not hand.tendons_with_encoders[index]:
        reason_by_parameter["moment_arm"] = MISSING_ENCODERS_REASON
    return reason_by_parameter


def _unidentifiable_parameters(fit: TendonFit, hand: Hand, name: str) -> list[str]:
    """Return the parameters that the excitation in the log cannot identify, even if the excitation lasts longer.

    Each text contains the name of the parameter and the reason.
    """
    problem = fit.problem
    tendon = hand.tendon[hand.tendon_names.index(name)]
    if tendon.pretension_N is not None:
        return [
            "link masses: taken from the hand file to weigh torques, and fitted only as a factor on the load",
            f"tendon damping: its force is too small for the noise of the motor force, {problem.cell_noise_N:.2f} N",
        ]
    tension = np.concatenate(
        [
            problem.motor_windows.tension,
            problem.open_stop_bins.tension,
            problem.free_motion_bins.tension,
        ]
    )
    reasons = [
        "load-cell gain: torque gain, inertia, friction, tendon and springs all scale with it. "
        "The load cell is taken as the measure of force",
        "link masses: taken from the hand file, within 30 %",
    ]
    if hand.tendons_with_encoders[hand.tendon_names.index(name)]:
        reasons.append("ratios of the moment arms of a tendon: one factor is fitted for all joints")
    if float(tension.max(initial=0.0)) < tendon.knee_N:
        reasons.append(
            f"knee of the tendon: the data end at {tension.max(initial=0.0):.0f} N, the knee is at {tendon.knee_N:g} N"
        )
    if not len(problem.open_stop_bins.t):
        return reasons
    rates = np.abs(problem.open_stop_bins.speed)
    max_speed = float(rates.max(initial=0.0))
    damping_force = tendon.damping_N_s_per_m * max_speed
    reasons.append(
        f"tendon damping: on the stop its force is at most {damping_force:.3f} N, "
        f"the load-cell noise is {problem.cell_noise_N:.2f} N"
    )
    return reasons


def _parameter_combination_text(direction: Array) -> str:
    """Return the largest components of a combination of parameters, as text."""
    order = np.argsort(-np.abs(direction))[:3]
    return ", ".join(
        f"{direction[i]:+.2f} {PARAMETER_NAMES[i]}" for i in order if abs(direction[i]) > 0.1
    )


def excitation_coherence(data: TendonData) -> tuple[Array, Array]:
    """Return frequencies [Hz], and the coherence of motor force and tendon speed at each frequency.

    The coherence is from 0 to 1. At a coherence of 1, the motor force determines the tendon speed
    through a linear system. Noise, friction, and other causes of the motion reduce the coherence.
    """
    is_used = data.torque_mask & np.isfinite(data.travel)
    force = data.command[is_used]
    travel = data.travel[is_used]
    if len(force) < 64:
        return np.zeros(0), np.zeros(0)
    speed = np.gradient(travel, data.period)
    f, c = coherence(
        force, speed, fs=1.0 / data.period, nperseg=max(64, len(force) // COHERENCE_SEGMENTS)
    )
    return np.asarray(f), np.asarray(c)
