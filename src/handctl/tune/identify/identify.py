"""From logs to parameters: every tendon fitted, judged, and put into the form that a calibration keeps."""

import datetime
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from handctl.core.identified import DIGIT_KEYS, UNITS, Identified
from handctl.errors import LogError
from handctl.hand.description import Hand
from handctl.hand.digit import DigitModel
from handctl.log.read.moments import phase_of_each
from handctl.log.read.reader import RunLog
from handctl.tune.identify.contact import joints_moving
from handctl.tune.identify.data import Array, TendonData, tendon_data
from handctl.tune.identify.fit import NAMES, Fit, Problem, fit
from handctl.tune.identify.fit_digit import Balance, fit_digit, joined
from handctl.tune.identify.identifiability import Identifiability, excitation_coherence, identifiability

BAND_HZ = (0.7, 6.0)
"""Band over which coherence is averaged: that of the swing."""
OF_THE_SWEEPS = (*DIGIT_KEYS, "capstan")
"""What a contact in the sweeps spoils. Motor and rope are found without the digit's balance."""


@dataclass(frozen=True, slots=True)
class Found:
    """What one log tells of one tendon.

    Attributes:
        data: from the log. fit: of all parameters. judged: what of it counts. coherence: mean over the swing's band.
        spectrum: frequencies [Hz] and coherence. balance: of the digit, if it has several tendons and joint encoders.
        blocked: when and what the digit met while it was excited; empty if nothing, or if it was not excited.
        met: how the sweeps show that something touches the digit; empty if they do not.
    """

    data: TendonData
    fit: Fit
    judged: Identifiability
    coherence: float
    spectrum: tuple[Array, Array]
    balance: Balance | None = None
    blocked: str = ""
    met: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """What the data tell and nothing has spoilt."""
        if self.blocked:
            return ()
        return tuple(name for name in self.judged.names if not (self.met and name in OF_THE_SWEEPS))

    def identified(self, log: Path, made: str) -> Identified | None:
        """For the calibration file; None if the data tell nothing, or are spoilt by what the digit met."""
        names = self.names
        if not names:
            return None
        at = [NAMES.index(name) for name in names]
        scale = self.fit.problem.nominal[at]
        covariance = self.fit.covariance[np.ix_(at, at)] * np.outer(scale, scale)
        values, widths = self.fit.values, self.fit.half_widths
        return Identified(
            names=names,
            values=tuple(values[name] for name in names),
            half_widths=tuple(widths[name] for name in names),
            covariance=tuple(tuple(row) for row in covariance.tolist()),
            missing=self.judged.missing,
            log=(str(log),),
            made=made,
        )

    def told(self) -> dict[str, Any]:
        """For JSON."""
        values, widths, nominal = self.fit.values, self.fit.half_widths, self.fit.problem.nominal
        together = self.fit.half_widths_of(max(1, len(self.judged.names)))
        rows = {
            name: {
                "value": values[name],
                "half_width_95": widths[name],
                "half_width_95_all_at_once": together[name],
                "unit": UNITS[name],
                "hand_file": 0.0 if name == "delay" else float(nominal[NAMES.index(name)]),
                "identified": name in self.names,
            }
            for name in UNITS
        }
        return {
            "digit": self.data.digit,
            "blocked": self.blocked,
            "met": self.met,
            "ramp": self.fit.ramp._asdict() if self.fit.ramp else None,
            "parameters": rows,
            "load_cell_offset_N": float(self.fit.z[len(NAMES)]),
            "coherence": self.coherence,
            "not_identified": list(self.judged.missing),
            "rank": [self.judged.rank, self.judged.columns],
            "condition": self.judged.condition,
            "weakest_combination": self.judged.weakest,
            "correlated": [list(pair) for pair in self.judged.correlated],
            "residual_rms": float(np.sqrt(np.mean(self.fit.residual**2))),
            "load_cell_noise_N": self.fit.problem.sigma,
        }


def identify(log: RunLog, hand: Hand, progress: Callable[[str], None] = lambda text: None) -> dict[str, Found]:
    """Fit every tendon that a log tells of, by name; those that hardly move are left out.

    Args:
        log: of any run.
        hand: that ran, as its file says.
        progress: told what is being done.

    Raises:
        LogError: nothing in the log moves.
    """
    solved, why = [], LogError("no tendon of this hand in it", "the log", "a run in which digits move")
    for data in tendon_data(log, hand):
        progress(f"fitting {data.tendon}")
        try:
            solved.append((data, fit(Problem.of(data, hand))))
        except LogError as error:
            why = error
    if not solved:
        raise why
    found: dict[str, Found] = {}
    for name in hand.digit_names:
        own = [(data, one) for data, one in solved if data.digit == name]
        balance, fits = _of_digit(hand, name, own)
        found |= {data.tendon: _found(hand, data, one, balance) for (data, _), one in zip(own, fits, strict=True)}
    events = blocked(log)
    return {name: _spoilt(hand, one, events.get(one.data.digit, "")) for name, one in found.items()}


def _spoilt(hand: Hand, one: Found, event: str) -> Found:
    """Return what was found with what has spoilt it.

    The controller judges by the hand file's springs, and takes springs that are a third stiffer for an obstacle. So
    its event does not count if the fit explains the whole sweep.
    """
    met, ramp = contact_of(hand, one), one.fit.ramp
    cleared = not met and ramp is not None and ramp.clear
    return replace(one, met=met, blocked="" if cleared else event)


def contact_of(hand: Hand, one: Found) -> str:
    """Return how a fit shows that something touches the digit in its sweeps; empty if it does not."""
    ramp = one.fit.ramp
    if ramp is not None and ramp.met:
        several = len(hand.tendon[hand.digit_tendons[one.data.digit]]) > 1
        size = f"{1e3 * abs(ramp.rise):.1f} mN m at a joint" if several else f"{abs(ramp.rise):.1f} N"
        kind = "more" if ramp.rise > 0.0 else "less"
        begin, end = np.degrees([ramp.begin, ramp.end])
        return (
            f"from {begin:.0f} deg on it takes {kind} than its springs explain, {size} at {end:.0f} deg "
            f"({abs(ramp.score):.1f} standard deviations)"
        )
    return _stands_still(hand, one)


def _stands_still(hand: Hand, one: Found) -> str:
    """Return how a digit with one tendon shows that one of its joints does not move; empty if all move."""
    load, data, values = one.fit.problem.load, one.data, one.fit.values
    if load is None or "spring_preload" not in one.judged.names:
        return ""
    stretch = data.tension / values["rope_stiffness"] + values["stretch_offset"]
    travel = float(np.nanmax(np.where(data.acting, data.travel - stretch, np.nan)))
    full = float(abs(load.arms) @ np.radians(hand.digit_named(data.digit).joint_max_deg))
    preload, width = values["spring_preload"], one.fit.half_widths["spring_preload"]
    if joints_moving(len(load.arms), preload, width, travel, full):
        return ""
    return (
        f"it looks as if a joint stood still: its springs have {preload:.2f} of the hand file's preload, and "
        f"it closes by {1e3 * travel:.1f} mm of {1e3 * full:.1f} mm"
    )


def blocked(log: RunLog) -> dict[str, str]:
    """Return what each excited digit met while it was to move freely, by digit; nothing of those that met nothing.

    The digit that was excited is spoilt, whichever of two that touch each other is found blocked.
    """
    events = [one for one in log.events if one.event.name == "blocked" and one.event.text.count("is blocked")]
    if not events:
        return {}
    phases = phase_of_each(log.phases, np.array([one.k for one in events]))
    found: dict[str, str] = {}
    for one, phase in zip(events, phases, strict=True):
        digit, _, step = str(phase).partition(" ")
        if step:
            found.setdefault(digit, f"{one.event.text} at {one.t_ns / 1e9:.1f} s, in its {step}")
    return found


def _of_digit(hand: Hand, name: str, own: list[tuple[TendonData, Fit]]) -> tuple[Balance | None, list[Fit]]:
    """Fits of a digit's tendons; where there are several, with what only all of them together tell."""
    fits = [one for _, one in own]
    if len(own) < 2 or len(own) < len(hand.tendon[hand.digit_tendons[name]]):
        return None, fits
    balance = Balance.of(DigitModel.of(hand, name), [data for data, _ in own], fits)
    return balance, fits if balance is None else joined(fits, fit_digit(balance), balance)


def _found(hand: Hand, data: TendonData, one: Fit, balance: Balance | None) -> Found:
    spectrum = excitation_coherence(data)
    inside = (spectrum[0] >= BAND_HZ[0]) & (spectrum[0] <= BAND_HZ[1])
    mean = float(spectrum[1][inside].mean()) if inside.any() else float("nan")
    tendon = hand.tendon[hand.tendon_names.index(data.tendon)]
    return Found(data, one, identifiability(one, tendon), mean, spectrum, balance)


def now() -> str:
    """This instant, ISO 8601, UTC."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def table(found: dict[str, Found]) -> list[str]:
    """Lines for a person: every parameter with its interval and what the hand file says."""
    lines = []
    for name, one in found.items():
        lines.append(f"{name}: coherence {one.coherence:.2f}, load cell {one.fit.problem.sigma:.2f} N rms")
        values, widths = one.fit.values, one.fit.half_widths
        for key, unit in UNITS.items():
            nominal = one.fit.problem.nominal[NAMES.index(key)]
            size, shown = (1e3, "ms") if key == "delay" else (1.0, unit)
            value, width = size * values[key], size * widths[key]
            if key not in one.names:
                spoilt = key in one.judged.names
                lines.append(f"  {key:<17} {'spoilt by what the digit met' if spoilt else 'not identified'}")
                continue
            share = "" if key == "delay" else f"{100 * width / abs(value):5.1f} %   hand file {nominal:.4g}"
            lines.append(f"  {key:<17} {value:10.4g} +- {width:<9.2g} {shown:<11} {share}")
        count = max(1, len(one.names))
        wider = [one.fit.half_widths_of(count)[name] / widths[name] for name in one.names]
        if wider:
            lines.append(
                f"  to cover all {count} at once with 95 %: {min(wider):.2f} to {max(wider):.2f} times as wide"
            )
        lines.append(f"  data tell {one.judged.rank} of {one.judged.columns} combinations; least: {one.judged.weakest}")
        lines += [f"  {a} and {b} trade off: correlation {r:+.2f}" for a, b, r in one.judged.correlated]
        lines += [f"  cannot be told: {text}" for text in one.judged.missing]
    return lines
