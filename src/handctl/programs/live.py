"""The program whose goals come from requests, tick after tick: a person with ``jog``, or somebody's Python."""

import math
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.estimate import Estimate, Measured
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import PEAK_SPEED
from handctl.core.model import HandModel
from handctl.core.types import Event
from handctl.programs.program import TIGHTEN_TIMEOUT_S, Progress, coordinates, loose, motion_to, tighten
from handctl.programs.reach import ROUNDING_DEG
from handctl.programs.requests import HoldTension, MoveDigits
from handctl.programs.task import FOLLOW_SPEED_DEG_S


@dataclass(frozen=True, slots=True)
class LiveProgram:
    """Tightens the tendons, then waits for requests until somebody stops it."""

    def begin(self, model: HandModel) -> Progress:
        """Limp until the hand is armed."""
        return Progress.begin(len(model.digits), "start")

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """One tick; see ``Program``."""
        if progress.phase == "start":
            progress = replace(progress, since=t, phase="tighten", goals=tighten(model))
            return progress, (Event("info", "phase", "", "tighten: taking up slack"),)
        if progress.phase == "tighten" and not loose(model, estimate):
            return replace(progress, phase="live"), (Event("info", "phase", "", "live: waiting for requests"),)
        if progress.phase == "tighten" and t - progress.since > TIGHTEN_TIMEOUT_S:
            text = f"not taut after {TIGHTEN_TIMEOUT_S:g} s: {', '.join(loose(model, estimate))}"
            return replace(progress, finished=True, failure=text), (Event("error", "tighten", "", text),)
        return progress, ()


@dataclass(frozen=True, slots=True)
class JogProgram:
    """One goal for a while, as a person at the bench wants it, then the end.

    Attributes:
        request: the goal.
        duration: how long it is kept [s].
    """

    request: MoveDigits | HoldTension
    duration: float

    def begin(self, model: HandModel) -> Progress:
        """Limp until the hand is armed."""
        return LiveProgram().begin(model)

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> tuple[Progress, tuple[Event, ...]]:
        """One tick; see ``Program``."""
        progress, events = LiveProgram().advance(model, progress, estimate, measured, t)
        if progress.phase == "live":
            goals = progress.goals
            progress, told = apply_goal(model, progress, self.request, estimate, t)
            if progress.goals is goals:
                return replace(progress, finished=True, failure=told[-1].text), events + told
            return replace(progress, phase="jog", since=t), events + told
        if progress.phase == "jog" and t - progress.since >= self.duration:
            return replace(progress, finished=True), events
        return progress, events


def apply_goal(
    model: HandModel, progress: Progress, request: MoveDigits | HoldTension, estimate: Estimate, t: float
) -> tuple[Progress, tuple[Event, ...]]:
    """Set goals on a request; a request that names an unknown digit or too much tension changes nothing."""
    names = model.hand.digit_names
    asked = request.angle_deg if isinstance(request, MoveDigits) else request.tension_N
    unknown = sorted(asked.keys() - set(names))
    if unknown or progress.phase in ("start", "tighten"):
        why = f"no digit {unknown[0]!r}, expected one of {', '.join(names)}" if unknown else "the hand is not ready yet"
        return progress, (Event("warn", "request", "", f"refused: {why}"),)
    goals, contact = list(progress.goals), list(progress.contact)
    for name, value in asked.items():
        d = names.index(name)
        tendons = model.digit_tendons[d]
        if isinstance(request, MoveDigits):
            if why := _out_of_reach(model, d, estimate, value, request.duration_s):
                return progress, (Event("warn", "request", name, f"refused: {name} {why}"),)
            goals[d] = motion_to(model.digits[d], estimate, math.radians(value), request.duration_s, t)
            contact[d] = False
        elif value > float(model.ceiling[tendons].min()):
            limit = float(model.ceiling[tendons].min())
            text = f"refused: {value:g} N on {name}, expected at most {limit:g} N"
            return progress, (Event("warn", "request", name, text),)
        else:
            target = np.full(tendons.stop - tendons.start, value)
            goals[d] = DigitGoal(Kind.TENSION, tension=target, rate=request.rate_N_per_s)
    text = f"{request.do} " + ", ".join(f"{name} {value:g}" for name, value in asked.items())
    return replace(progress, goals=tuple(goals), contact=tuple(contact)), (Event("info", "request", "", text),)


def _out_of_reach(model: HandModel, d: int, estimate: Estimate, angle: float, duration: float) -> str:
    """Why a digit does not go to an angle [deg] in a time [s], in a few words; empty if it does."""
    digit = model.digits[d]
    least, most = digit.reach
    low, high = math.degrees(least.max()), math.degrees(most.min())
    if not low - ROUNDING_DEG <= angle <= high + ROUNDING_DEG:
        return f"{angle:g} deg, expected from {low:g} to {high:g} deg"
    way = np.abs(angle - np.degrees(coordinates(digit, estimate))).max()
    peak = PEAK_SPEED * float(way) / duration
    fast = f"at up to {peak:.0f} deg/s, expected at most {FOLLOW_SPEED_DEG_S:g} deg/s: give it more time"
    return "" if peak <= FOLLOW_SPEED_DEG_S else fast
