"""Programs whose goals come from requests: a live session with `jog` or a client, and a single jog."""

import math
from dataclasses import dataclass, replace

import numpy as np

from handctl.core.estimate import Estimate, Measured
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.law.trajectory import PEAK_SPEED
from handctl.core.model import HandModel
from handctl.core.types import Event
from handctl.programs.program import (
    TIGHTEN_TIMEOUT_S,
    Progress,
    ProgressAndEvents,
    coordinates,
    motion_to,
    slack_tendons,
    tighten,
)
from handctl.programs.requests import HoldTension, MoveDigits
from handctl.programs.task import FOLLOW_SPEED_DEG_S
from handctl.programs.task_checks import ROUNDING_DEG


@dataclass(frozen=True, slots=True)
class LiveProgram:
    """Program that tightens the tendons, then waits for requests until a stop."""

    def initial(self, model: HandModel) -> Progress:
        """Return the progress until the hand is armed: no torque."""
        return Progress.initial(len(model.digits), "start")

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> ProgressAndEvents:
        """Advance by one tick. See `Program`."""
        if progress.phase == "start":
            progress = replace(progress, since=t, phase="tighten", goals=tighten(model))
            return progress, (Event("info", "phase", "", "tighten: taking up slack"),)
        if progress.phase == "tighten" and not slack_tendons(model, estimate):
            return replace(progress, phase="live"), (Event("info", "phase", "", "live: waiting for requests"),)
        if progress.phase == "tighten" and t - progress.since > TIGHTEN_TIMEOUT_S:
            text = f"not taut after {TIGHTEN_TIMEOUT_S:g} s: {', '.join(slack_tendons(model, estimate))}"
            return replace(progress, finished=True, failure=text), (Event("error", "tighten", "", text),)
        return progress, ()


@dataclass(frozen=True, slots=True)
class JogProgram:
    """Program with one goal for a limited time.

    Attributes:
        request: goal.
        duration: time for which the goal is kept [s].
    """

    request: MoveDigits | HoldTension
    duration: float

    def initial(self, model: HandModel) -> Progress:
        """Return the progress until the hand is armed: no torque."""
        return LiveProgram().initial(model)

    def advance(
        self, model: HandModel, progress: Progress, estimate: Estimate, measured: Measured, t: float
    ) -> ProgressAndEvents:
        """Advance by one tick. See `Program`."""
        progress, events = LiveProgram().advance(model, progress, estimate, measured, t)
        if progress.phase == "live":
            goals = progress.goals
            progress, goal_events = apply_goal(model, progress, self.request, estimate, t)
            # A refused request leaves the goals as they are.
            if progress.goals is goals:
                return replace(progress, finished=True, failure=goal_events[-1].text), events + goal_events
            return replace(progress, phase="jog", since=t), events + goal_events
        if progress.phase == "jog" and t - progress.since >= self.duration:
            return replace(progress, finished=True), events
        return progress, events


def apply_goal(
    model: HandModel,
    progress: Progress,
    request: MoveDigits | HoldTension,
    estimate: Estimate,
    t: float,
) -> ProgressAndEvents:
    """Apply the goals of a request.

    A request with an unknown digit, an angle out of range, too high a speed or too much tension
    changes nothing.
    """
    names = model.hand.digit_names
    values = request.angle_deg if isinstance(request, MoveDigits) else request.tension_N
    unknown = sorted(values.keys() - set(names))
    if unknown or progress.phase in ("start", "tighten"):
        reason = (
            f"no digit {unknown[0]!r}, expected one of {', '.join(names)}" if unknown else "the hand is not ready yet"
        )
        return progress, (Event("warn", "request", "", f"refused: {reason}"),)
    goals = list(progress.goals)
    contact = list(progress.contact)
    for name, value in values.items():
        d = names.index(name)
        tendons = model.digit_tendons[d]
        if isinstance(request, MoveDigits):
            if reason := _out_of_reach(model, d, estimate, value, request.duration_s):
                return progress, (Event("warn", "request", name, f"refused: {name} {reason}"),)
            goals[d] = motion_to(model.digits[d], estimate, math.radians(value), request.duration_s, t)
            contact[d] = False
        elif value > float(model.ceiling[tendons].min()):
            limit = float(model.ceiling[tendons].min())
            text = f"refused: {value:g} N on {name}, expected at most {limit:g} N"
            return progress, (Event("warn", "request", name, text),)
        else:
            target = np.full(tendons.stop - tendons.start, value)
            goals[d] = DigitGoal(Kind.TENSION, tension=target, rate=request.rate_N_per_s)
    text = f"{request.do} " + ", ".join(f"{name} {value:g}" for name, value in values.items())
    return replace(progress, goals=tuple(goals), contact=tuple(contact)), (Event("info", "request", "", text),)


def _out_of_reach(model: HandModel, d: int, estimate: Estimate, angle: float, duration: float) -> str:
    """Return why a digit refuses an angle [deg] in a time [s], empty if it accepts."""
    digit = model.digits[d]
    joint_min, joint_max = digit.reach
    # One angle for all coordinates, so the tightest range of any coordinate counts.
    low = math.degrees(joint_min.max())
    high = math.degrees(joint_max.min())
    if not low - ROUNDING_DEG <= angle <= high + ROUNDING_DEG:
        return f"{angle:g} deg, expected from {low:g} to {high:g} deg"
    travel = np.abs(angle - np.degrees(coordinates(digit, estimate))).max()
    peak = PEAK_SPEED * float(travel) / duration
    too_fast = f"at up to {peak:.0f} deg/s, expected at most {FOLLOW_SPEED_DEG_S:g} deg/s: give it more time"
    return "" if peak <= FOLLOW_SPEED_DEG_S else too_fast
