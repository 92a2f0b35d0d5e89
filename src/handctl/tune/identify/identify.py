"""Identification of all tendons in a log: fit, identifiability, contacts, and entries for the calibration file."""

import datetime
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.identified_parameters import (
    DIGIT_KEY_BY_PARAMETER,
    PARAMETER_UNITS,
    IdentifiedParameters,
)
from handctl.errors import LogError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.hand.tendons import TendonElasticity
from handctl.log.read.reader import RunLog
from handctl.log.read.timeline import phase_of_each_tick
from handctl.tune.identify.contact_detection import are_joints_moving
from handctl.tune.identify.fit_digit import TorqueBalance, fit_digit, fits_with_digit_solution
from handctl.tune.identify.fit_spool_pair import fit_spool_pair
from handctl.tune.identify.fit_tendon import (
    PARAMETER_NAMES,
    TendonFit,
    TendonFitProblem,
    fit_tendon,
)
from handctl.tune.identify.fit_travel import fit_travel, model_with_arm_factors
from handctl.tune.identify.identifiability import (
    Identifiability,
    assess_identifiability,
    excitation_coherence,
)
from handctl.tune.identify.tendon_data import Array, TendonData, tendon_data

EXCITATION_BAND_HZ = (0.7, 6.0)
"""Frequency band over which the coherence is averaged [Hz].

The frequency of a digit's sinusoidal swing sweeps through the whole band.
"""
MIN_COHERENCE = 0.2
"""Coherence below which the parameters that come from the motion of a rotor are rejected.

The mean coherence of two unrelated random signals, calculated in the same way over 8 to 20 s, is
0.09. In 99 of 100 draws of two random signals, the mean coherence is below 0.2. The excitation of
`handctl identify` reaches 0.55 to 0.85 with packaged hands, and a grasp 0.05 to 0.4.
"""
SWING_PARAMETERS = ("motor_inertia", "motor_viscous", "delay")
"""Parameters that are invalid if the coherence is low.

Acceleration and speed of the rotor, in the frequency band of the coherence, determine the listed
parameters. Forces at rest and slow motions determine the other parameters, such as the torque gain.
"""
LOW_COHERENCE_TEXT = f"coherence is below {MIN_COHERENCE:g}"
"""Reason why a parameter that comes from the motion of a rotor is rejected."""
SWEEP_PARAMETERS = (*DIGIT_KEY_BY_PARAMETER, "capstan")
"""Parameters that are invalid if the digit touched an obstacle during the sweeps.

A contact leaves the parameters of motor and tendon valid, because they do not depend on the torque
balance of the digit.
"""


@dataclass(frozen=True, slots=True)
class TendonResult:
    """Result of the identification of a tendon from a log.

    Attributes:
        data: data of the tendon from the log.
        fit: fit of all parameters.
        identifiability: identifiability of the parameters.
        coherence: mean coherence over the frequency band of the excitation step *swing*.
        spectrum: frequencies [Hz], and the coherence at each frequency.
        balance: data for the fit of the digit, if the digit has several tendons and joint encoders.
            None otherwise.
        blocked_event_text: text of the event in which the controller reported that the digit was
            blocked, or an empty text.
        contact_text: text that describes a contact during the sweeps, or an empty text without a
            contact.
    """

    data: TendonData
    fit: TendonFit
    identifiability: Identifiability
    coherence: float
    spectrum: tuple[Array, Array]
    balance: TorqueBalance | None = None
    blocked_event_text: str = ""
    contact_text: str = ""

    @property
    def identified_names(self) -> tuple[str, ...]:
        """Return the names of the identified parameters that are valid.

        If the digit touched an obstacle, the parameters that the sweeps determine are invalid. If
        the coherence is low, the parameters that the sinusoidal swing determines are invalid. If
        the digit was blocked, no parameter is valid.
        """
        if self.blocked_event_text:
            return ()
        return tuple(
            name
            for name in self.identifiability.names
            if not (self.contact_text and name in SWEEP_PARAMETERS)
            and not (self.is_incoherent and name in SWING_PARAMETERS)
        )

    @property
    def is_incoherent(self) -> bool:
        """Return True if the motor force explains hardly any of the motion.

        Below ``MIN_COHERENCE``, the coherence of motor force and motion is as low as for two
        unrelated signals.
        """
        return self.coherence < MIN_COHERENCE

    @property
    def reason_by_invalid_quantity(self) -> dict[str, str]:
        """Return, for each quantity without a valid value, the reason why the value is not valid.

        In the result, the parameters of the fit come first. Quantities that the fit does not
        determine come last.
        """
        reason_by_parameter = dict(text.split(": ", 1) for text in self.identifiability.missing)
        invalid_reasons = dict.fromkeys(self.identifiability.names, "invalid because of a contact")
        if self.is_incoherent and not self.blocked_event_text:
            invalid_reasons |= dict.fromkeys(SWING_PARAMETERS, LOW_COHERENCE_TEXT)
        reasons = dict.fromkeys(PARAMETER_UNITS, "") | invalid_reasons | reason_by_parameter
        return {
            name: reason
            for name, reason in reasons.items()
            if reason and name not in self.identified_names
        }

    def calibration_entry(self, log: Path, creation_date: str) -> IdentifiedParameters | None:
        """Return the entry of the tendon for the calibration file.

        If no parameter is identified and valid, return None.
        """
        names = self.identified_names
        if not names:
            return None
        at = [PARAMETER_NAMES.index(name) for name in names]
        scale = self.fit.problem.parameter_scales[at]
        # In the fit, parameters are scaled. In the calibration file, parameters are in SI units.
        covariance = self.fit.covariance[np.ix_(at, at)] * np.outer(scale, scale)
        values = self.fit.parameter_values
        half_widths = self.fit.half_widths
        return IdentifiedParameters(
            names=names,
            values=tuple(values[name] for name in names),
            half_widths=tuple(half_widths[name] for name in names),
            covariance=tuple(tuple(row) for row in covariance.tolist()),
            missing=self.identifiability.missing,
            log=(str(log),),
            made=creation_date,
        )

    def as_json(self) -> dict[str, Any]:
        """Return the result as plain values for JSON."""
        values = self.fit.parameter_values
        half_widths = self.fit.half_widths
        nominal = self.fit.problem.parameter_scales
        simultaneous_half_widths = self.fit.simultaneous_half_widths(
            max(1, len(self.identifiability.names))
        )
        rows = {
            name: {
                "value": values[name],
                "half_width_95": half_widths[name],
                "half_width_95_all_at_once": simultaneous_half_widths[name],
                "unit": PARAMETER_UNITS[name],
                "hand_file": 0.0
                if name == "delay"
                else float(nominal[PARAMETER_NAMES.index(name)]),
                "identified": name in self.identified_names,
            }
            for name in PARAMETER_UNITS
        }
        return {
            "digit": self.data.digit,
            "blocked": self.blocked_event_text,
            "met": self.contact_text,
            "ramp": self.fit.ramp._asdict() if self.fit.ramp else None,
            "parameters": rows,
            "load_cell_offset_N": float(self.fit.z[len(PARAMETER_NAMES)]),
            "coherence": self.coherence,
            "coherence_is_low": self.is_incoherent,
            "not_identified": list(self.identifiability.missing),
            "rank": [self.identifiability.rank, self.identifiability.columns],
            "condition": self.identifiability.condition_number,
            "weakest_combination": self.identifiability.weakest_combination,
            "correlated": [list(pair) for pair in self.identifiability.correlated_pairs],
            "residual_rms": float(np.sqrt(np.mean(self.fit.residual**2))),
            "load_cell_noise_N": self.fit.problem.cell_noise_N,
        }


def identify_tendons(
    log: RunLog, hand: Hand, progress: Callable[[str], None] = lambda text: None
) -> dict[str, TendonResult]:
    """Identify every tendon in a log, and return the results by the name of the tendon.

    A tendon that hardly moves is left out of the results.

    Args:
        log: log of any run.
        hand: hand of the run, as the hand file describes it.
        progress: function that is called with a description of each step.

    Raises:
        LogError: no tendon moves in the log.
    """
    data_and_fits = []
    failure = LogError("no tendon of this hand in it", "the log", "a run in which digits move")
    data_of_tendons = tendon_data(log, hand)
    for data in data_of_tendons:
        progress(f"fitting {data.tendon}")
        try:
            data_and_fits.append(
                (
                    data,
                    _fit_single_tendon(
                        hand,
                        data,
                        [
                            other_data
                            for other_data in data_of_tendons
                            if other_data.digit == data.digit
                        ],
                    ),
                )
            )
        except LogError as error:
            failure = error
    if not data_and_fits:
        raise failure
    results: dict[str, TendonResult] = {}
    for name in hand.digit_names:
        digit_data_and_fits = [(data, fit) for data, fit in data_and_fits if data.digit == name]
        balance, fits = _digit_fits(hand, name, digit_data_and_fits)
        results |= {
            data.tendon: _tendon_result(hand, data, fit, balance)
            for (data, _), fit in zip(digit_data_and_fits, fits, strict=True)
        }
    events = blocked_digits(log)
    return {
        name: _result_with_contacts(hand, fit, events.get(fit.data.digit, ""))
        for name, fit in results.items()
    }


def _fit_single_tendon(hand: Hand, data: TendonData, digit_data: list[TendonData]) -> TendonFit:
    """Return the fit of a single tendon or spool pair.

    The fit of a spool pair needs the data of all spool pairs of the digit.

    Raises:
        LogError: the tendon hardly moves.
    """
    digit = DigitModel.from_hand(hand, data.digit)
    tendon_index = digit.tendon_names.index(data.tendon)
    if hand.is_pair[digit.tendons].any():
        return fit_spool_pair(hand, digit, tendon_index, digit_data)
    fit = fit_tendon(TendonFitProblem.from_data(data, hand))
    if any(digit.spring_stiffness):
        return fit
    elasticity = TendonElasticity.from_tendon(hand.tendon[digit.tendons][tendon_index])
    return fit_travel(digit, tendon_index, data, fit, hand.sensor_node.joint_noise_rad, elasticity)


def _result_with_contacts(hand: Hand, result: TendonResult, event: str) -> TendonResult:
    """Add the texts about a contact and about a blocked digit to the result of a tendon.

    A contact makes the parameters from the sweeps invalid. To detect obstacles, the controller uses
    the springs of the hand file. If the real springs are stiffer than the springs in the hand file
    by a third, the controller reports an obstacle, although no obstacle exists. Therefore the
    function ignores the contact event of the controller if the fit explains the whole sweep.
    """
    contact = contact_text(hand, result)
    residual_ramp = result.fit.ramp
    has_no_contact = not contact and residual_ramp is not None and residual_ramp.excludes_contact
    return replace(result, contact_text=contact, blocked_event_text="" if has_no_contact else event)


def contact_text(hand: Hand, result: TendonResult) -> str:
    """Return a text that describes a contact during the sweeps, or an empty text if there was no contact."""
    residual_ramp = result.fit.ramp
    if residual_ramp is not None and residual_ramp.is_contact:
        has_several_tendons = len(hand.tendon[hand.digit_tendons[result.data.digit]]) > 1
        size = (
            f"{1e3 * abs(residual_ramp.rise):.1f} mN m at a joint"
            if has_several_tendons
            else f"{abs(residual_ramp.rise):.1f} N"
        )
        kind = "higher" if residual_ramp.rise > 0.0 else "lower"
        start, end = np.degrees([residual_ramp.begin, residual_ramp.end])
        return (
            f"from {start:.0f} deg on the load is {kind} than the springs explain, by {size} at {end:.0f} deg "
            f"({abs(residual_ramp.score):.1f} standard deviations)"
        )
    return _blocked_joint_text(hand, result)


def _blocked_joint_text(hand: Hand, result: TendonResult) -> str:
    """Return a text that describes a blocked joint in a digit with one tendon.

    If all joints of the digit move, the returned text is empty.
    """
    load = result.fit.problem.digit_load
    data = result.data
    values = result.fit.parameter_values
    if load is None or "spring_preload" not in result.identifiability.names:
        return ""
    stretch = data.tension / values["tendon_stiffness"] + values["stretch_offset"]
    travel = float(np.nanmax(np.where(data.torque_mask, data.travel - stretch, np.nan)))
    closed_angles = np.radians(hand.digit_named(data.digit).joint_max_deg)
    full_excursion = float(abs(load.arms) @ closed_angles)
    if load.varying_arm_digit is not None:
        full_excursion = float(abs(load.varying_arm_digit.excursion_at_angles(closed_angles)[0]))
    preload = values["spring_preload"]
    width = result.fit.half_widths["spring_preload"]
    if are_joints_moving(len(load.arms), preload, width, travel, full_excursion):
        return ""
    return (
        f"a joint does not seem to move: the springs of the digit have {preload:.2f} of the hand file's preload, "
        f"and the digit closes by {1e3 * travel:.1f} mm of {1e3 * full_excursion:.1f} mm"
    )


def blocked_digits(log: RunLog) -> dict[str, str]:
    """Return, for each digit, the first event that reported a blocked digit during the excitation of this digit.

    The keys of the result are the names of the excited digits.

    If the excited digit touches a second digit, the event can name the second digit. Therefore each
    event counts for the digit that was excited at the time of the event, even if the event names a
    second digit.
    """
    events = [
        event_entry
        for event_entry in log.events
        if event_entry.event.name == "blocked" and event_entry.event.text.count("is blocked")
    ]
    if not events:
        return {}
    phases = phase_of_each_tick(log.phases, np.array([event_entry.k for event_entry in events]))
    texts: dict[str, str] = {}
    for event_entry, phase in zip(events, phases, strict=True):
        digit, _, step = str(phase).partition(" ")
        if step:
            texts.setdefault(
                digit, f"{event_entry.event.text} at {event_entry.t_ns / 1e9:.1f} s, in its {step}"
            )
    return texts


def _digit_fits(
    hand: Hand, name: str, data_and_fits: list[tuple[TendonData, TendonFit]]
) -> tuple[TorqueBalance | None, list[TendonFit]]:
    """Return the fits of the tendons of a digit.

    If a digit without spool pairs has several tendons, and all tendons have data, a fit of the
    whole digit identifies springs and friction. The first returned value is the data for the fit of
    the whole digit. If the whole digit is not fitted, the first value is None.
    """
    fits = [fit for _, fit in data_and_fits]
    digit = DigitModel.from_hand(hand, name)
    if (
        hand.is_pair[digit.tendons].any()
        or len(data_and_fits) < 2
        or len(data_and_fits) < len(digit.tendon_names)
    ):
        return None, fits
    if not any(digit.spring_stiffness):
        digit = model_with_arm_factors(
            digit, np.array([fit.parameter_values["moment_arm"] for fit in fits])
        )
    balance = TorqueBalance.from_fits(digit, [data for data, _ in data_and_fits], fits)
    return balance, fits if balance is None else fits_with_digit_solution(
        fits, fit_digit(balance), balance
    )


def _tendon_result(
    hand: Hand, data: TendonData, fit: TendonFit, balance: TorqueBalance | None
) -> TendonResult:
    """Return the result for a tendon, without information about contacts."""
    spectrum = excitation_coherence(data)
    is_in_band = (spectrum[0] >= EXCITATION_BAND_HZ[0]) & (spectrum[0] <= EXCITATION_BAND_HZ[1])
    mean = float(spectrum[1][is_in_band].mean()) if is_in_band.any() else float("nan")
    return TendonResult(
        data,
        fit,
        assess_identifiability(fit, hand, data.digit, data.tendon),
        mean,
        spectrum,
        balance,
    )


def utc_now_text() -> str:
    """Return the present time in UTC as ISO 8601 text."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


COLUMN_WIDTHS = (18, 10, 19, 9, 9)
"""Width of each column of a result table, except the last column [characters]."""


def result_table(result_of_tendon: dict[str, TendonResult], is_verbose: bool = False) -> list[str]:
    """Return the lines of a table of the parameters, for a terminal.

    A line contains the value of a parameter, the confidence interval and the value in the hand
    file. If there is no value, the line contains the reason.

    Args:
        result_of_tendon: results by the name of the tendon.
        is_verbose: True to add lines about combinations of parameters and simultaneous intervals.
    """
    lines = [
        "coherence: fraction of the motion of a tendon that the motor force explains, 0 to 1; "
        f"below {MIN_COHERENCE:g}, values of inertia, viscous friction and delay are not worth using"
    ]
    for name, result in result_of_tendon.items():
        has_cell = bool(np.isfinite(result.data.tension).any())
        noise_source = "load cell" if has_cell else "motor force"
        lines.append(
            f"{name}: coherence {result.coherence:.2f}, "
            f"noise of the {noise_source} {result.fit.problem.cell_noise_N:.2f} N rms"
        )
        lines.append(
            _table_row("parameter", "value", "95 % interval", "unit", "hand file", "why not")
        )
        reasons = result.reason_by_invalid_quantity
        for key in PARAMETER_UNITS:
            if key in result.identified_names:
                lines.append(_identified_row(result, key))
        lines += [_table_row(key, "-", "", "", "", reason) for key, reason in reasons.items()]
        if is_verbose:
            lines += _parameter_summary_lines(result)
    return lines


def _table_row(*cells: str) -> str:
    """Return a row of the table of results, given the text for each cell."""
    fixed_cells = [cell.ljust(width) for cell, width in zip(cells, COLUMN_WIDTHS, strict=False)]
    return "  " + " ".join([*fixed_cells, *cells[len(COLUMN_WIDTHS) :]]).rstrip()


def _identified_row(result: TendonResult, key: str) -> str:
    """Return the table row of an identified parameter. The unit of a pure number is written as "-"."""
    size, unit = (1e3, "ms") if key == "delay" else (1.0, PARAMETER_UNITS[key])
    value = size * result.fit.parameter_values[key]
    width = size * result.fit.half_widths[key]
    nominal = result.fit.problem.parameter_scales[PARAMETER_NAMES.index(key)]
    fraction = "" if key == "delay" else f" ({100 * width / abs(value):.1f} %)"
    return _table_row(
        key,
        f"{value:.4g}",
        f"+- {width:.2g}{fraction}",
        "-" if unit == "1" else unit,
        "-" if key == "delay" else f"{nominal:.4g}",
        "",
    )


def _parameter_summary_lines(result: TendonResult) -> list[str]:
    """Return lines about all parameters of a tendon together: simultaneous intervals, combinations, correlations."""
    names = result.identified_names
    half_widths = result.fit.half_widths
    simultaneous_half_widths = result.fit.simultaneous_half_widths(max(1, len(names)))
    width_ratios = [simultaneous_half_widths[name] / half_widths[name] for name in names]
    lines = []
    if width_ratios:
        lines.append(
            f"  intervals that cover all {len(names)} parameters at once with 95 %: "
            f"{min(width_ratios):.2f} to {max(width_ratios):.2f} times as wide"
        )
    rank = f"{result.identifiability.rank} of {result.identifiability.columns} combinations"
    lines.append(
        f"  the data determine {rank}, with the least information about {result.identifiability.weakest_combination}"
    )
    return lines + [
        f"  {a} and {b} trade off: correlation {r:+.2f}"
        for a, b, r in result.identifiability.correlated_pairs
    ]
