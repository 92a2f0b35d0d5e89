"""Tension of a digit that follows its rope, where friction lets it: what the filter is told to expect next.

Friction leaves the tension a band about what springs and gravity ask: its upper edge where the rope winds, its lower
one where it pays out. When the direction turns the digit sticks, the motor alone goes on, and the tension runs from one
edge to the other with the rope's stiffness: some ten milliseconds, and not when the plan turns but when the rope does.
At rest the digit creeps until friction has nothing to bear any more.
Source: Prandtl's elastic-plastic element, its slider viscous below ``ROPE_FRICTION_SPEED``.
"""

from typing import NamedTuple

import numpy as np

from handctl.choose import chosen, nothing, only, zeros
from handctl.controller.estimator import Estimate
from handctl.controller.goal_table import Mask
from handctl.controller.model import HandModel
from handctl.controller.types import Vector
from handctl.hand.tendons import ROPE_FRICTION_SPEED

CREEP_SPEED = 1.3 * ROPE_FRICTION_SPEED
"""Speed at which the slider's straight line meets the band's edge, so as to be near the tanh [m/s]."""
LEAST_N = 1e-3
"""Friction that is always assumed [N], so that a rope without any has a band that is narrow and not nothing."""


MOST = 1.0 - 1e-9
"""The same as an efficiency."""


class Ahead(NamedTuple):
    """What is expected of moving digits, (N,) each.

    Attributes:
        planned: tension a period from now [N]; 0 for the others.
        rate: at which it changes until then [N/s]; 0 where nothing was expected before.
        friction_state: how far friction is developed at present, 1 winding, -1 paying out; NaN for the others.
    """

    planned: Vector
    rate: Vector
    friction_state: Vector


def look_ahead(
    model: HandModel,
    before: Vector,
    estimate: Estimate,
    force: Vector,
    load: Vector,
    rate: Vector,
    efficiency: Vector,
    moving: Mask,
) -> Ahead:
    """Expect the tensions a period from now; (N,) each.

    Args:
        model: the hand.
        before: what was expected for the present [N]; 0 where nothing was.
        estimate: of this instant.
        force: that acts on the motors' masses until then, friction taken off [N].
        load: tensions that the digits ask without friction now [N]. rate: planned speed of the cable [m/s].
        efficiency: share of a tension that reaches the joints while the rope winds.
        moving: which tendons move.
    """
    if not moving.any():
        return Ahead(zeros(len(moving)), zeros(len(moving)), nothing(len(moving)))
    half = 0.5 * model.period / model.space.motor_mass
    speed = estimate.speed + half * (force + estimate.motor_disturbance - estimate.tension)
    coming = np.maximum(load + model.period * model.space.load_stiffness * rate, model.floor)
    planned = expected(model, before, estimate.tension, coming, efficiency, model.period * speed)
    known = moving & (before > 0.0)
    beyond = np.log(np.maximum(before, LEAST_N) / np.maximum(load, LEAST_N))
    developed = chosen(known, beyond / -np.log(np.minimum(efficiency, MOST)), nothing(len(load)))
    return Ahead(
        only(moving, planned),
        only(known, (planned - before) / model.period),
        np.minimum(np.maximum(developed, -1.0), 1.0),
    )


def expected(
    model: HandModel, before: Vector, tension: Vector, load: Vector, efficiency: Vector, wound: Vector
) -> Vector:
    """(N,) tensions a period from now [N].

    Args:
        model: the hand.
        before: (N,) what was expected for the present [N]; 0 where nothing was.
        tension: (N,) estimated at present [N], to begin from.
        load: (N,) tensions that the digits ask without friction a period from now [N].
        efficiency: (N,) share of a tension that reaches the joints while the rope winds.
        wound: (N,) rope that the spool takes up in the period [m].
    """
    now = np.where(before > 0.0, before, tension)
    creep = model.space.stiffness * CREEP_SPEED * model.period / (load * (1.0 - efficiency) + LEAST_N)
    stuck = (now + model.space.stiffness * wound + creep * load) / (1.0 + creep)
    return np.minimum(np.maximum(stuck, load * efficiency), load / efficiency)
