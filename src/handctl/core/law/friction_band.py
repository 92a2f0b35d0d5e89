"""Tension of a digit that follows its rope, where friction lets it: what the filter is told to expect next.

Friction leaves the tension a band about what springs and gravity ask: its upper edge where the rope winds, its lower
one where it pays out. When the direction turns the digit sticks, the motor alone goes on, and the tension runs from one
edge to the other with the rope's stiffness: some ten milliseconds, and not when the plan turns but when the rope does.
At rest the digit creeps until friction has nothing to bear any more.
Source: Prandtl's elastic-plastic element, its slider viscous below ``ROPE_FRICTION_SPEED``.
"""

import math
from typing import NamedTuple

import numpy as np

from handctl.choose import nothing, zeros
from handctl.compiled import inner, kernel
from handctl.core.estimation.estimator import Estimate
from handctl.core.law.goal_table import Mask
from handctl.core.model import HandModel
from handctl.core.types import Vector
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
    space = model.space
    return Ahead(
        *_look_ahead(
            before, estimate.tension, estimate.speed, estimate.motor_disturbance, force, load, rate, efficiency, moving,
            model.floor, space.motor_mass, space.stiffness, space.load_stiffness, model.period,
            CREEP_SPEED * model.period,
        )
    )  # fmt: skip


@kernel(*["vector"] * 8, "flags", *["vector"] * 4, "real", "real")
def _look_ahead(
    before: Vector,
    tension: Vector,
    speed: Vector,
    disturbance: Vector,
    force: Vector,
    load: Vector,
    rate: Vector,
    efficiency: Vector,
    moving: Mask,
    floor: Vector,
    motor_mass: Vector,
    stiffness: Vector,
    load_stiffness: Vector,
    period: float,
    crept: float,
) -> tuple[Vector, Vector, Vector]:
    """Expect the tensions a period from now; see ``look_ahead`` and ``Ahead``.

    Args:
        before, force, load, rate, efficiency, moving: as there.
        tension, speed, disturbance: estimated at present [N], [m/s], [N].
        floor, motor_mass, stiffness, load_stiffness: of the tendons [N], [kg], [N/m], [N/m]. period: [s].
        crept: way of a rope that creeps in a period [m].
    """
    count = len(before)
    planned, change, developed = np.zeros(count), np.zeros(count), np.full(count, math.nan)
    for n in range(count):
        if not moving[n]:
            continue
        coming_speed = speed[n] + 0.5 * period / motor_mass[n] * (force[n] + disturbance[n] - tension[n])
        coming = max(load[n] + period * load_stiffness[n] * rate[n], floor[n])
        now = before[n] if before[n] > 0.0 else tension[n]
        planned[n] = expected(now, coming, efficiency[n], period * coming_speed, stiffness[n], crept)
        if before[n] > 0.0:
            change[n] = (planned[n] - before[n]) / period
            beyond = math.log(max(before[n], LEAST_N) / max(load[n], LEAST_N))
            developed[n] = min(max(-beyond / math.log(min(efficiency[n], MOST)), -1.0), 1.0)
    return planned, change, developed


@inner
def expected(now: float, load: float, efficiency: float, wound: float, stiffness: float, crept: float) -> float:
    """Return the tension of a tendon a period from now [N].

    Args:
        now: tension at present [N].
        load: tension that the digit asks without friction a period from now [N].
        efficiency: share of a tension that reaches the joints while the rope winds.
        wound: rope that the spool takes up in the period [m].
        stiffness: of the rope [N/m]. crept: way of a rope that creeps in the period [m].
    """
    creep = stiffness * crept / (load * (1.0 - efficiency) + LEAST_N)
    sticking = (now + stiffness * wound + creep * load) / (1.0 + creep)
    return min(max(sticking, load * efficiency), load / efficiency)
