"""Tension of a digit that follows its tendon, where friction lets it: what the filter is told to expect next.

Friction leaves the tension a band about what springs and gravity require: its upper edge where the tendon winds, its
lower one where it pays out. When the direction turns the digit sticks, the motor alone goes on, and the tension runs
from one edge to the other with the tendon's stiffness: some ten milliseconds, and not when the plan turns but when the
tendon does. At rest the digit creeps until friction has nothing to bear any more.
Source: Prandtl's elastic-plastic element, its slider viscous below ``ROPE_FRICTION_SPEED``.
"""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.hand.tendons import ROPE_FRICTION_SPEED

CREEP_SPEED = 1.3 * ROPE_FRICTION_SPEED
"""Speed at which the slider's straight line meets the band's edge, so as to be near the tanh [m/s]."""
FRICTION_LEAST_N = 1e-3
"""Friction that is always assumed [N], so that a tendon without any has a band that is narrow and not nothing."""
EFFICIENCY_MOST = 1.0 - 1e-9
"""The same as an efficiency."""


@inner
def look_ahead(x: Tables, c: ConstantTables, n: int, rate: float, efficiency: float) -> None:
    """Write the tension of a moving tendon a period from now, the rate until then, and how far friction is developed.

    Args:
        x: tables, with ``PLANNED`` of the last tick and ``FORCE`` of this one. c: constants. n: index of the tendon.
        rate: planned speed of the tendon [m/s].
        efficiency: fraction of a tension that reaches the joints while the tendon winds.
    """
    before, period, tension = x.tendon[s.PLANNED, n], c.run[h.PERIOD], x.tendon[s.TENSION, n]
    load = x.tendon[s.LOAD, n]
    accelerating = x.tendon[s.FORCE, n] + x.tendon[s.DISTURBANCE, n] - tension
    coming_speed = x.tendon[s.SPEED, n] + 0.5 * period / c.tendon[h.MOTOR_MASS, n] * accelerating
    coming = max(load + period * c.tendon[h.LOAD_STIFFNESS, n] * rate, c.tendon[h.FLOOR, n])
    now = before if before > 0.0 else tension
    planned = expected(now, coming, efficiency, period * coming_speed, c.tendon[h.STIFFNESS, n], CREEP_SPEED * period)
    x.tendon[s.PLANNED, n] = planned
    x.tendon[s.RATE, n], x.tendon[s.FRICTION_STATE, n] = 0.0, math.nan
    if before > 0.0:
        x.tendon[s.RATE, n] = (planned - before) / period
        beyond = math.log(max(before, FRICTION_LEAST_N) / max(load, FRICTION_LEAST_N))
        developed = -beyond / math.log(min(efficiency, EFFICIENCY_MOST))
        x.tendon[s.FRICTION_STATE, n] = min(max(developed, -1.0), 1.0)


@inner
def expected(now: float, load: float, efficiency: float, wound: float, stiffness: float, crept: float) -> float:
    """Return the tension of a tendon a period from now [N].

    Args:
        now: tension at present [N].
        load: tension that the digit requires without friction a period from now [N].
        efficiency: fraction of a tension that reaches the joints while the tendon winds.
        wound: length that the spool takes up in the period [m].
        stiffness: of the tendon [N/m]. crept: way of a tendon that creeps in the period [m].
    """
    creep = stiffness * crept / (load * (1.0 - efficiency) + FRICTION_LEAST_N)
    sticking = (now + stiffness * wound + creep * load) / (1.0 + creep)
    return min(max(sticking, load * efficiency), load / efficiency)
