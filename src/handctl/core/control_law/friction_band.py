"""Prediction of the tension of a moving digit, which depends on friction.

The tension filter uses the predicted tension as an input.

Because of friction, the tension of a moving digit is in a band around the tension that springs and
gravity require. The tension is at the upper edge of the band while the tendon is wound, and at the
lower edge while it is paid out. At a reversal, the digit sticks while the motor moves. The motor
stretches or releases the tendon, and the tension changes from one edge to the other in about ten
milliseconds. This change starts with the reversal of the tendon. The trajectory may reverse earlier
or later than the tendon. At rest, the digit creeps until friction carries no load. Source:
Prandtl's elastic-plastic element, with a viscous slider below ``CAPSTAN_FRICTION_SPEED_M_S``.
"""

import math

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.spool_pair import net_tension_at_spool
from handctl.core.state_block import StateTables
from handctl.hand.tendons import CAPSTAN_FRICTION_SPEED_M_S

MIN_SLIDING_SPEED_M_S = 1.3 * CAPSTAN_FRICTION_SPEED_M_S
"""Speed from which the viscous slider has full friction [m/s].

Below this speed, friction rises linearly. The line approximates the tanh of the friction model.
"""
MIN_FRICTION_N = 1e-3
"""Smallest assumed friction [N], so that the friction band has a positive width."""
MAX_EFFICIENCY = 1.0 - 1e-9
"""Largest assumed efficiency of the pulleys, so that the friction band has a positive width."""


@kernel_helper
def predict_moving_tension(
    x: StateTables, c: ConstantTables, n: int, rate: float, efficiency: float
) -> None:
    """Predict for the next tick the tension of a moving tendon, the rate of the tension, and the friction.

    The friction is a number from 1 for a tendon that is wound to -1 for a tendon that is paid out.

    Args:
        x: state tables, with ``PLANNED_TENSION`` of the last tick and ``FILTER_FORCE`` of the
            present tick.
        c: constants of the hand.
        n: index of the tendon.
        rate: planned speed of the tendon [m/s].
        efficiency: tension at the joints, divided by the tension at the load cell, while the tendon
            is wound.
    """
    before = x.tendon[s.PLANNED_TENSION, n]
    period = c.run[h.PERIOD]
    tension = x.tendon[s.TENSION, n]
    load = x.tendon[s.REQUIRED_TENSION, n]
    accelerating = x.tendon[s.FILTER_FORCE, n] + x.tendon[s.DISTURBANCE, n] - tension
    coming_speed = x.tendon[s.SPEED, n] + 0.5 * period / c.tendon[h.MOTOR_MASS, n] * accelerating
    coming = max(load + period * c.tendon[h.LOAD_STIFFNESS, n] * rate, c.tendon[h.TENSION_FLOOR, n])
    wound = period * coming_speed
    if c.tendon_int[h.IS_SPOOL_PAIR, n]:
        _predict_pair_tension(x, c, n, coming, efficiency, wound)
        return
    now = before if before > 0.0 else tension
    planned = tension_after_period(
        now,
        coming,
        efficiency,
        wound,
        c.tendon[h.TENDON_STIFFNESS, n],
        MIN_SLIDING_SPEED_M_S * period,
    )
    x.tendon[s.PLANNED_TENSION, n] = planned
    x.tendon[s.PLANNED_TENSION_RATE, n] = 0.0
    x.tendon[s.FRICTION_STATE, n] = math.nan
    if before > 0.0:
        x.tendon[s.PLANNED_TENSION_RATE, n] = (planned - before) / period
        ratio_log = math.log(max(before, MIN_FRICTION_N) / max(load, MIN_FRICTION_N))
        developed = -ratio_log / math.log(min(efficiency, MAX_EFFICIENCY))
        x.tendon[s.FRICTION_STATE, n] = min(max(developed, -1.0), 1.0)


@kernel_helper
def tension_after_period(
    present_tension: float,
    load: float,
    efficiency: float,
    wound_length: float,
    stiffness: float,
    crept_length: float,
) -> float:
    """Predict the tension of a tendon at the next tick [N].

    Args:
        present_tension: present tension [N].
        load: tension that the digit would need at the next tick without friction [N].
        efficiency: tension at the joints, divided by the tension at the load cell, while the tendon
            is wound.
        wound_length: tendon length that the spool winds in the period [m].
        stiffness: stiffness of the tendon [N/m].
        crept_length: largest length by which the tendon can creep in the period [m].
    """
    creep = stiffness * crept_length / (load * (1.0 - efficiency) + MIN_FRICTION_N)
    # The motion of the viscous slider is computed by an implicit Euler step, which is stable for
    # any period.
    sticking = (present_tension + stiffness * wound_length + creep * load) / (1.0 + creep)
    return min(max(sticking, load * efficiency), load / efficiency)


@kernel_helper
def _predict_pair_tension(
    x: StateTables,
    c: ConstantTables,
    n: int,
    coming_tension: float,
    efficiency: float,
    wound_length: float,
) -> None:
    """Write the results of ``predict_moving_tension`` for a spool pair.

    Whenever the pair moves, one of its tendons is wound and the other is paid out.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the spool pair.
        coming_tension: net tension that the digit would require at the next tick without friction
            [N].
        efficiency: tension at the joints as a fraction of the tension at the load cell, while a
            tendon is wound.
        wound_length: tendon length that the spool winds in the period [m].
    """
    before = x.tendon[s.PLANNED_TENSION, n]
    pretension = c.tendon[h.PRETENSION, n]
    period = c.run[h.PERIOD]
    upper = net_tension_at_spool(coming_tension, pretension, efficiency)
    lower = net_tension_at_spool(coming_tension, pretension, 1.0 / efficiency)
    # 0 means that the tension of the last tick is unknown.
    now = x.tendon[s.TENSION, n] if before == 0.0 else before
    stiffness = c.tendon[h.TENDON_STIFFNESS, n]
    creep = stiffness * MIN_SLIDING_SPEED_M_S * period / (0.5 * (upper - lower) + MIN_FRICTION_N)
    sticking = (now + stiffness * wound_length + creep * coming_tension) / (1.0 + creep)
    planned = min(max(sticking, lower), upper)
    x.tendon[s.PLANNED_TENSION, n] = planned
    x.tendon[s.PLANNED_TENSION_RATE, n] = 0.0
    x.tendon[s.FRICTION_STATE, n] = math.nan
    if before != 0.0:
        x.tendon[s.PLANNED_TENSION_RATE, n] = (planned - before) / period
        developed = (2.0 * before - upper - lower) / (upper - lower + MIN_FRICTION_N)
        x.tendon[s.FRICTION_STATE, n] = min(max(developed, -1.0), 1.0)
