"""A grasp while it holds: stiffness between its digits, and slip noticed and answered by more force.

What can be noticed: a digit whose tension is kept, but whose tendon pays out, is pushed open: what it holds is moving.
The tendon's excursion, travel less stretch, is known to a few micrometres, so a fraction of a millimetre at the object
is plain. What cannot: a force along the hinges moves no joint (J^T F = 0), so an even bar that slides along the hinges
is not felt by any tendon or joint encoder.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from handctl.core.estimate import Estimate
from handctl.core.law.goal import DigitGoal, Kind
from handctl.core.model import HandModel
from handctl.core.types import Event, Vector

OPENING_M = 20e-6
"""Difference that counts as slip: six standard deviations of the excursion in a quiet hold (3.5 um), about 0.1 mm/s
of tendon, 0.3 to 1 mm/s of object."""
QUIET_S = 0.4
"""Nothing is judged so long after the grip's own tension has stopped changing: fingers conform when it does."""
PAUSE_S = 0.1
"""From one answer to the next."""
STEP = 1.2
"""Factor on every tension of the grip with each answer."""
RATE_N_PER_S = 300.0
"""How fast an answer is given; a slip is faster than the closing of a grasp."""


class Grip(NamedTuple):
    """What a hold carries from tick to tick, (N,) each; NaN for tendons of digits that do not hold.

    Attributes:
        tension: that was asked at the beginning [N].
        anchor: excursion at which a stiff grip pulls exactly that [m]; NaN until the grip has settled.
        ready: from when on slip is judged [s].
        raised: factor on the tensions by now.
        limited: whether it has been said that no more is allowed.
    """

    tension: Vector
    anchor: Vector
    ready: float
    raised: float = 1.0
    limited: bool = False

    @staticmethod
    def of(model: HandModel, goals: tuple[DigitGoal, ...], estimate: Estimate, t: float) -> "Grip":
        """The grip of goals that have just been set."""
        tension, lasts = np.full(model.tendon_count, np.nan), 0.0
        for tendons, goal in zip(model.digit_tendons, goals, strict=True):
            if goal.kind == Kind.TENSION and goal.tension is not None:
                tension[tendons] = goal.tension
                lasts = max(lasts, float(np.abs(goal.tension - estimate.tension[tendons]).max()) / goal.rate)
        return Grip(tension, np.full_like(tension, np.nan), t + lasts + QUIET_S)


@dataclass(frozen=True, slots=True)
class GripPlan:
    """What a task says of a grip.

    Attributes:
        stiffness: tension more per metre a tendon is pulled out [N/m]; 0: tensions are kept.
        limit: (N,) tension that slip may raise to [N]; NaN: as it is. If all are, slip is told, not answered.
    """

    stiffness: float
    limit: Vector


def excursion(model: HandModel, estimate: Estimate) -> Vector:
    """(N,) cable wound at the spool less the rope's stretch, up to a constant [m]."""
    return np.asarray(estimate.travel - estimate.tension / model.space.stiffness)


def hold(
    model: HandModel, grip: Grip, plan: GripPlan, goals: tuple[DigitGoal, ...], estimate: Estimate, t: float
) -> tuple[Grip, tuple[DigitGoal, ...], tuple[Event, ...]]:
    """One tick of a grip.

    Args:
        model: the hand.
        grip: from the last tick.
        plan: what the task says.
        goals: per digit.
        estimate: of this instant.
        t: time [s].

    Returns:
        the grip, the goals, and what is to be told.
    """
    events: tuple[Event, ...] = ()
    judged, settled = t >= grip.ready, not math.isnan(grip.anchor[0])
    if judged and not settled:
        grip = grip._replace(anchor=estimate.grip.copy())
    if judged:
        opening = np.where(np.isnan(grip.tension), 0.0, estimate.opening)
        if opening.max() > OPENING_M:
            grip, events = _answer(model, grip, plan, opening, t)
    if not (judged or settled) or not (events or plan.stiffness):
        return grip, goals, events
    return grip, _goals(model, grip, plan, goals, excursion(model, estimate)), events


def _answer(model: HandModel, grip: Grip, plan: GripPlan, opening: Vector, t: float) -> tuple[Grip, tuple[Event, ...]]:
    """Raise the force, as far as the task allows."""
    worst = int(np.argmax(opening))
    digit = next(
        name
        for name, tendons in zip(model.hand.digit_names, model.digit_tendons, strict=True)
        if tendons.start <= worst < tendons.stop
    )
    grip = grip._replace(ready=t + PAUSE_S)
    moved = f"{digit} is pushed open, {1e6 * opening[worst]:.0f} um of tendon"
    most = float(np.nanmax(np.append(plan.limit / grip.tension, 1.0)))
    if grip.raised < most:
        grip = grip._replace(raised=min(grip.raised * STEP, most))
        return grip, (Event("warn", "slip", digit, f"{moved}: force x {grip.raised:.2f}"),)
    told = Event("warn", "slip", digit, f"{moved}; the task allows no more force")
    return grip._replace(limited=True), () if grip.limited else (told,)


def _goals(
    model: HandModel, grip: Grip, plan: GripPlan, goals: tuple[DigitGoal, ...], here: Vector
) -> tuple[DigitGoal, ...]:
    """The goals with what slip and stiffness ask of the tensions; never below the floor."""
    most = np.fmax(plan.limit, grip.tension)
    wanted = np.minimum(grip.raised * grip.tension, most) + plan.stiffness * (grip.anchor - here)
    wanted = np.clip(wanted, np.minimum(model.floor, grip.tension), most if plan.stiffness == 0.0 else model.ceiling)
    return tuple(
        goal if np.isnan(wanted[tendons]).any() else replace(goal, tension=wanted[tendons], rate=RATE_N_PER_S)
        for goal, tendons in zip(goals, model.digit_tendons, strict=True)
    )
