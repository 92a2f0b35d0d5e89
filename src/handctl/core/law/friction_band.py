"""Predicted tension of a moving digit within the friction band, as input of the filter.

Friction leaves a band of tensions around the requirement of springs and gravity: the upper edge
while the tendon winds, the lower while paying out. At a reversal the digit sticks, the motor moves
alone, and the tension runs from an edge to the other with the tendon's stiffness. This takes some
ten milliseconds, and begins at the tendon's reversal, not the plan's. At rest the digit creeps
until friction carries no load.
Source: Prandtl's elastic-plastic element, with a viscous slider below ``CAPSTAN_FRICTION_SPEED``.
"""

import math

from handctl.compiled import inner
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.core.estimation.spool_pair import net_tension_at_spool
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED

MIN_SLIDING_SPEED = 1.3 * CAPSTAN_FRICTION_SPEED
"""Speed at which the slider's straight line meets the band's edge, close to the tanh [m/s]."""
MIN_FRICTION_N = 1e-3
"""Smallest assumed friction [N], for a band of positive width."""
MAX_EFFICIENCY = 1.0 - 1e-9
"""Largest assumed efficiency, for the same reason."""


@inner
def predict_moving_tension(x: Tables, c: ConstantTables, n: int, rate: float, efficiency: float) -> None:
    """Write the tension of a moving tendon a period from now, the rate until then, and the development of friction.

    Args:
        x: state tables, with ``PLANNED`` of the last tick and ``FORCE`` of the present.
        c: constants of the hand.
        n: index of the tendon.
        rate: planned speed of the tendon [m/s].
        efficiency: fraction of a tension at the joints while the tendon winds.
    """
    before = x.tendon[s.PLANNED, n]
    period = c.run[h.PERIOD]
    tension = x.tendon[s.TENSION, n]
    load = x.tendon[s.LOAD, n]
    accelerating = x.tendon[s.FORCE, n] + x.tendon[s.DISTURBANCE, n] - tension
    coming_speed = x.tendon[s.SPEED, n] + 0.5 * period / c.tendon[h.MOTOR_MASS, n] * accelerating
    coming = max(load + period * c.tendon[h.LOAD_STIFFNESS, n] * rate, c.tendon[h.FLOOR, n])
    wound = period * coming_speed
    if c.tendon_int[h.PAIR, n]:
        _predict_pair_tension(x, c, n, coming, efficiency, wound)
        return
    now = before if before > 0.0 else tension
    planned = tension_after_period(now, coming, efficiency, wound, c.tendon[h.STIFFNESS, n], MIN_SLIDING_SPEED * period)
    x.tendon[s.PLANNED, n] = planned
    x.tendon[s.RATE, n] = 0.0
    x.tendon[s.FRICTION_STATE, n] = math.nan
    if before > 0.0:
        x.tendon[s.RATE, n] = (planned - before) / period
        ratio_log = math.log(max(before, MIN_FRICTION_N) / max(load, MIN_FRICTION_N))
        developed = -ratio_log / math.log(min(efficiency, MAX_EFFICIENCY))
        x.tendon[s.FRICTION_STATE, n] = min(max(developed, -1.0), 1.0)


@inner
def tension_after_period(
    now: float, load: float, efficiency: float, wound: float, stiffness: float, crept: float
) -> float:
    """Return the tension of a tendon a period from now [N].

    Args:
        now: present tension [N].
        load: tension required by the digit without friction a period from now [N].
        efficiency: fraction of a tension at the joints while the tendon winds.
        wound: length taken up by the spool in the period [m].
        stiffness: of the tendon [N/m].
        crept: motion of a creeping tendon in the period [m].
    """
    creep = stiffness * crept / (load * (1.0 - efficiency) + MIN_FRICTION_N)
    # Implicit Euler step of the viscous slider: stable for any period.
    sticking = (now + stiffness * wound + creep * load) / (1.0 + creep)
    return min(max(sticking, load * efficiency), load / efficiency)


@inner
def _predict_pair_tension(x: Tables, c: ConstantTables, n: int, coming: float, efficiency: float, wound: float) -> None:
    """Write the same for a spool pair. The edges of the band are where one tendon winds and the other pays out.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the spool pair.
        coming: net tension required by the digit without friction a period from now [N].
        efficiency: fraction of a tension at the joints while the tendon winds.
        wound: length taken up by the spool in the period [m].
    """
    before = x.tendon[s.PLANNED, n]
    pretension = c.tendon[h.PRETENSION, n]
    period = c.run[h.PERIOD]
    upper = net_tension_at_spool(coming, pretension, efficiency)
    lower = net_tension_at_spool(coming, pretension, 1.0 / efficiency)
    now = x.tendon[s.TENSION, n] if before == 0.0 else before  # 0 is what is not known
    stiffness = c.tendon[h.STIFFNESS, n]
    creep = stiffness * MIN_SLIDING_SPEED * period / (0.5 * (upper - lower) + MIN_FRICTION_N)
    sticking = (now + stiffness * wound + creep * coming) / (1.0 + creep)
    planned = min(max(sticking, lower), upper)
    x.tendon[s.PLANNED, n] = planned
    x.tendon[s.RATE, n] = 0.0
    x.tendon[s.FRICTION_STATE, n] = math.nan
    if before != 0.0:
        x.tendon[s.RATE, n] = (planned - before) / period
        developed = (2.0 * before - upper - lower) / (upper - lower + MIN_FRICTION_N)
        x.tendon[s.FRICTION_STATE, n] = min(max(developed, -1.0), 1.0)
