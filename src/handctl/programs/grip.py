"""Control of the grip on an object that the digits hold.

The module applies the stiffness of the grip, detects slip, and raises the tension after slip.

A slipping object pushes a digit open. The tension stays constant, but the spool unwinds the tendon.
The excursion of a tendon (travel minus stretch) is known to a few micrometres. The excursion
therefore shows when the object slips by a fraction of a millimetre. A force F parallel to the hinge
axes makes no joint torque (J^T F = 0). If a bar of constant thickness slides parallel to the hinge
axes, neither tendons nor joint encoders show the slip.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from handctl.core.control_law.digit_goal import DigitGoal, GoalKind
from handctl.core.hand_estimate import HandEstimate
from handctl.core.hand_model import HandModel
from handctl.core.tick_types import TickEvent, Vector

SLIP_EXCURSION_M = 20e-6
"""Change of a tendon's excursion that counts as slip [m].

The threshold is six standard deviations of the excursion in a quiet hold (3.5 um each). The
threshold corresponds to a slip of about 0.1 mm/s along the tendon, and of 0.3 to 1 mm/s at the
object.
"""
SLIP_DETECTION_PAUSE_S = 0.4
"""Time after a change of the grip's tension in which slip is not detected [s].

After a change of the tension, the fingers adapt to the object.
"""
TENSION_RAISE_PAUSE_S = 0.1
"""Shortest time between two rises of the grip's tension [s]."""
TENSION_RAISE_FACTOR = 1.2
"""Factor by which the controller raises every tension of the grip after slip."""
TENSION_RAISE_RATE_N_PER_S = 300.0
"""Rate at which the tensions of the grip rise after slip [N/s].

The rate is high, because slip is faster than the closing of a grasp.
"""


class GripState(NamedTuple):
    """State of the grip during a hold.

    Arrays have the shape (N,), with NaN for the tendons of digits that do not hold.

    Attributes:
        tension: tension targets at the beginning of the hold [N].
        reference_excursion: excursion at which the tensions of a stiff grip equal ``tension`` [m],
            NaN until the grip has settled.
        ready: time from which on the controller detects slip [s].
        tension_factor: present factor on the tensions.
        is_limit_reported: True after the event that reports that the tension limit is reached.
    """

    tension: Vector
    reference_excursion: Vector
    ready: float
    tension_factor: float = 1.0
    is_limit_reported: bool = False

    @staticmethod
    def at_start_of_hold(
        model: HandModel, goals: tuple[DigitGoal, ...], estimate: HandEstimate, t: float
    ) -> "GripState":
        """Return the grip at the beginning of a hold, after the goals of the hold have been set."""
        tension = np.full(model.tendon_count, np.nan)
        settling_s = 0.0
        for tendons, goal in zip(model.digit_tendons, goals, strict=True):
            if goal.kind == GoalKind.TENSION and goal.tension is not None:
                tension[tendons] = goal.tension
                settling_s = max(
                    settling_s,
                    float(np.abs(goal.tension - estimate.tension[tendons]).max()) / goal.rate,
                )
        return GripState(
            tension, np.full_like(tension, np.nan), t + settling_s + SLIP_DETECTION_PAUSE_S
        )


@dataclass(frozen=True, slots=True)
class GripPlan:
    """Stiffness and tension limits that a task requires for the grip.

    Attributes:
        stiffness: additional tension per metre that a tendon is pulled out [N/m]. With a stiffness
            of 0, the tensions stay constant.
        limit: (N,) tension up to which the controller is allowed to raise the tension after slip
            [N], or NaN for no increase. If all values are NaN, the controller only reports slip.
    """

    stiffness: float
    limit: Vector


def grip_excursions(model: HandModel, estimate: HandEstimate) -> Vector:
    """Return the excursion (N,) [m] of each tendon, up to a constant offset.

    The result is the wound length minus the stretch of the tendon.
    """
    return np.asarray(estimate.travel - estimate.tension / model.tendon_constants.stiffness)


def advance_grip(
    model: HandModel,
    grip: GripState,
    plan: GripPlan,
    goals: tuple[DigitGoal, ...],
    estimate: HandEstimate,
    t: float,
) -> tuple[GripState, tuple[DigitGoal, ...], tuple[TickEvent, ...]]:
    """Advance a grip by one tick.

    Args:
        model: model of the hand.
        grip: grip after the last tick.
        plan: grip that the task requires.
        goals: present goals of the digits.
        estimate: estimated state of the hand in the present tick.
        t: time [s].

    Returns:
        The new grip, the new goals, and the events of the tick.
    """
    events: tuple[TickEvent, ...] = ()
    is_slip_judged = t >= grip.ready
    is_settled = not math.isnan(grip.reference_excursion[0])
    if is_slip_judged and not is_settled:
        # In the first tick after the grip has settled, the position of a stiff grip is stored.
        grip = grip._replace(reference_excursion=estimate.grip_travel.copy())
    if is_slip_judged:
        tendon, opening = estimate.largest_grip_opening(model.redundancy.closing_sign, grip.tension)
        if opening > SLIP_EXCURSION_M:
            grip, events = _raise_tension_after_slip(model, grip, plan, tendon, opening, t)
    if not (is_slip_judged or is_settled) or not (events or plan.stiffness):
        return grip, goals, events
    return (
        grip,
        _goals_with_grip_tensions(model, grip, plan, goals, grip_excursions(model, estimate)),
        events,
    )


def _raise_tension_after_slip(
    model: HandModel, grip: GripState, plan: GripPlan, tendon: int, opening: float, t: float
) -> tuple[GripState, tuple[TickEvent, ...]]:
    """Raise the tensions of a grip after slip, within the limits of the task.

    Args:
        model: model of the hand.
        grip: grip before the rise.
        plan: grip that the task requires.
        tendon: index of the tendon with the largest opening.
        opening: distance by which the object has pulled out this tendon [m].
        t: time [s].
    """
    digit = next(
        name
        for name, tendons in zip(model.hand.digit_names, model.digit_tendons, strict=True)
        if tendons.start <= tendon < tendons.stop
    )
    grip = grip._replace(ready=t + TENSION_RAISE_PAUSE_S)
    slip_text = f"{digit} is pushed open, {1e6 * opening:.0f} um of tendon"
    # All tensions of the grip are multiplied by the same factor. The tendon that is farthest below
    # its limit determines the largest possible factor.
    is_closing_side = model.redundancy.closing_sign > 0.0
    factor_limits = plan.limit[is_closing_side] / grip.tension[is_closing_side]
    max_tension_factor = float(np.nanmax(np.append(factor_limits, 1.0)))
    if grip.tension_factor < max_tension_factor:
        grip = grip._replace(
            tension_factor=min(grip.tension_factor * TENSION_RAISE_FACTOR, max_tension_factor)
        )
        return grip, (
            TickEvent("warn", "slip", digit, f"{slip_text}: force x {grip.tension_factor:.2f}"),
        )
    refusal_event = TickEvent("warn", "slip", digit, f"{slip_text}; the task allows no more force")
    return grip._replace(is_limit_reported=True), () if grip.is_limit_reported else (refusal_event,)


def _goals_with_grip_tensions(
    model: HandModel,
    grip: GripState,
    plan: GripPlan,
    goals: tuple[DigitGoal, ...],
    excursion: Vector,
) -> tuple[DigitGoal, ...]:
    """Return the goals with new tensions, which depend on the detected slip and on the stiffness of the grip.

    No tension of the goals is below the tension floor.
    """
    limit = np.fmax(plan.limit, grip.tension)
    tension_factors = np.where(model.redundancy.closing_sign > 0.0, grip.tension_factor, 1.0)
    target = np.minimum(tension_factors * grip.tension, limit) + plan.stiffness * (
        grip.reference_excursion - excursion
    )
    # A stiff grip is allowed to exceed the tension limit for slip, but not the tension ceiling of
    # the hand.
    target = np.clip(
        target,
        np.minimum(model.floor, grip.tension),
        limit if plan.stiffness == 0.0 else model.ceiling,
    )
    return tuple(
        goal
        if np.isnan(target[tendons]).any()
        else replace(goal, tension=target[tendons], rate=TENSION_RAISE_RATE_N_PER_S)
        for goal, tendons in zip(goals, model.digit_tendons, strict=True)
    )
