"""Tension of a digit that follows its rope, where friction lets it: what the filter is told to expect next.

Friction leaves the tension a band about what springs and gravity ask: its upper edge where the rope winds, its lower
one where it pays out. When the direction turns the digit sticks, the motor alone goes on, and the tension runs from one
edge to the other with the rope's stiffness: some ten milliseconds, and not when the plan turns but when the rope does.
At rest the digit creeps until friction has nothing to bear any more.
Source: Prandtl's elastic-plastic element, its slider viscous below ``FRICTION_SPEED``.
"""

import numpy as np

from handctl.controller.model import HandModel
from handctl.controller.types import Vector
from handctl.hand.tendons import FRICTION_SPEED


def expected(model: HandModel, before: Vector, tension: Vector, load: Vector, sliding: Vector, wound: Vector) -> Vector:
    """(N,) tensions a period from now [N].

    Args:
        model: the hand.
        before: (N,) what was expected for the present [N]; 0 where nothing was.
        tension: (N,) estimated at present [N], to begin from.
        load: (N,) tensions that the digits ask without friction a period from now [N].
        sliding: (N,) share of a tension that reaches the joints while the rope winds.
        wound: (N,) rope that the spool takes up in the period [m].
    """
    now = np.where(before > 0.0, before, tension)
    creep = model.space.stiffness * FRICTION_SPEED * model.period / (load * (1.0 - sliding) + LEAST_N)
    stuck = (now + model.space.stiffness * wound + creep * load) / (1.0 + creep)
    return np.minimum(np.maximum(stuck, load * sliding), load / sliding)


LEAST_N = 1e-3
"""Friction that is always assumed [N], so that a rope without any has a band that is narrow and not nothing."""
