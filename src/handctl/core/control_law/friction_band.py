"""Prediction of the tension of a moving digit with friction, and computation of the present friction.

The tension filter uses the predicted tension as an input. The detection of contacts uses the
present friction.

Because of friction, the tension of a moving digit lies in a band around the tension that springs
and gravity require. While the tendon is wound up, the tension is at the upper edge of the friction
band. While the tendon is paid out, the tension is at the lower edge of the friction band. After a
reversal of the tendon, the digit sticks while the motor stretches or releases the tendon. Within
about ten milliseconds after a reversal, the tension changes from one edge of the friction band to
the other. The change of the tension starts at the reversal of the tendon, which can be earlier or
later than the reversal of the trajectory. At rest, the digit creeps until no friction force
remains. Source: Prandtl's elastic-plastic element, with a viscous slider below
``CAPSTAN_FRICTION_SPEED_M_S``.
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
"""Speed at and above which the viscous slider has full friction [m/s].

Below the sliding speed, friction is proportional to the speed. The proportional friction
approximates the tanh of the friction model.
"""
MIN_SLIDING_FRICTION = 1e-3
"""Friction state below which the friction is proportional to the speed."""
MAX_SLIDING_FRICTION = 0.99
"""Largest friction state for which the speed of the slider is computed.

At a friction state of 1, the computed speed of the slider is infinite.
"""
MIN_FRICTION_N = 1e-3
"""Smallest assumed friction [N], so that the friction band has a positive width."""
MAX_EFFICIENCY = 1.0 - 1e-9
"""Largest assumed efficiency of the pulleys, so that the friction band has a positive width."""


@kernel_helper
def predict_tension_of_moving_tendon(
    x: StateTables, c: ConstantTables, n: int, rate: float, efficiency: float
) -> None:
    """Predict the tension of a moving tendon at the next tick, and the rate of change of this tension.

    Args:
        x: state tables, with ``PLANNED_TENSION`` of the last tick and ``FILTER_INPUT_FORCE`` of the
            present tick.
        c: constants of the hand.
        n: index of the tendon.
        rate: planned speed of the tendon [m/s].
        efficiency: tension at the joints, divided by the tension at the load cell, while the tendon
            is wound.
    """
    last_tension = x.tendon[s.PLANNED_TENSION, n]
    period = c.run[h.CONTROL_PERIOD]
    tension = x.tendon[s.TENSION, n]
    load = x.tendon[s.REQUIRED_TENSION, n]
    accelerating_force = (
        x.tendon[s.FILTER_INPUT_FORCE, n] + x.tendon[s.MOTOR_DISTURBANCE, n] - tension
    )
    mean_speed = (
        x.tendon[s.SPOOL_SPEED, n] + 0.5 * period / c.tendon[h.MOTOR_MASS, n] * accelerating_force
    )
    next_load = max(
        load + period * c.tendon[h.LOAD_STIFFNESS, n] * rate, c.tendon[h.TENSION_FLOOR, n]
    )
    wound_length = period * mean_speed
    # A planned tension of 0 means that the tension of the last tick is unknown.
    is_pair = c.tendon_int[h.IS_SPOOL_PAIR, n] == 1
    is_known = last_tension != 0.0 if is_pair else last_tension > 0.0
    tension_now = last_tension if is_known else tension
    planned_tension = _tension_with_friction(
        c, n, tension_now, next_load, efficiency, wound_length, MIN_SLIDING_SPEED_M_S
    )
    x.tendon[s.PLANNED_TENSION, n] = planned_tension
    x.tendon[s.PLANNED_TENSION_RATE, n] = (
        (planned_tension - last_tension) / period if is_known else 0.0
    )


@kernel_helper
def update_friction_state(x: StateTables, c: ConstantTables, n: int, efficiency: float) -> None:
    """Write the friction state of a moving tendon.

    The friction state is 1 at full friction while the tendon is wound up, and -1 at full friction
    while the tendon is paid out. The model of the friction band is a spring in series with a
    slider. The stretch of the spring is the travel of the spool minus the travel of the slider. The
    friction state is not computed from the planned tension. The planned tension is integrated from
    estimated speeds. Each newton of load-cell error makes an estimated speed wrong by 0.1 mm/s.
    With a wrong friction state, the tension filter would expect a force that does not act on the
    motor. When the digit comes to rest, the unexplained tension would resemble a contact.

    Args:
        x: state tables, with ``FRICTION_SLIDER`` of the last tick.
        c: constants of the hand.
        n: index of the tendon.
        efficiency: tension at the joints, divided by the tension at the load cell, while the tendon
            is wound.
    """
    stiffness = c.tendon[h.TENDON_STIFFNESS, n]
    travel = x.tendon[s.SPOOL_TRAVEL, n]
    slider_travel = x.tendon[s.FRICTION_SLIDER, n]
    if math.isnan(slider_travel):
        x.tendon[s.FRICTION_STATE, n] = math.nan
        x.tendon[s.FRICTION_SLIDER, n] = travel - x.tendon[s.TENSION, n] / stiffness
        return
    load = x.tendon[s.REQUIRED_TENSION, n]
    if not c.tendon_int[h.IS_SPOOL_PAIR, n]:
        load = max(load, c.tendon[h.TENSION_FLOOR, n])
    sliding_speed = _sliding_speed(x.tendon[s.FRICTION_STATE, n])
    elastic_tension = stiffness * (travel - slider_travel)
    tension = _tension_with_friction(c, n, elastic_tension, load, efficiency, 0.0, sliding_speed)
    x.tendon[s.FRICTION_SLIDER, n] = travel - tension / stiffness
    if c.tendon_int[h.IS_SPOOL_PAIR, n]:
        lower, upper = _friction_band_of_pair(c, n, load, efficiency)
        friction_state = (2.0 * tension - upper - lower) / (upper - lower + MIN_FRICTION_N)
    else:
        log_tension_ratio = math.log(max(tension, MIN_FRICTION_N) / max(load, MIN_FRICTION_N))
        friction_state = -log_tension_ratio / math.log(min(efficiency, MAX_EFFICIENCY))
    x.tendon[s.FRICTION_STATE, n] = min(max(friction_state, -1.0), 1.0)


@kernel_helper
def _sliding_speed(friction_state: float) -> float:
    """Return the speed at which a linear friction law has full friction [m/s].

    The linear friction law goes through zero and through the present friction. In the friction
    model, friction is proportional to the tanh of the speed. A linear law with full friction at
    ``MIN_SLIDING_SPEED_M_S`` gives too little friction for the slow motion at the end of a
    trajectory. A predicted friction that is too small would resemble a contact.

    Args:
        friction_state: present friction, from 1 to -1, or NaN if it is unknown.
    """
    if math.isnan(friction_state) or abs(friction_state) < MIN_SLIDING_FRICTION:
        return CAPSTAN_FRICTION_SPEED_M_S
    friction = min(abs(friction_state), MAX_SLIDING_FRICTION)
    return CAPSTAN_FRICTION_SPEED_M_S * math.atanh(friction) / friction


@kernel_helper
def _tension_with_friction(
    c: ConstantTables,
    n: int,
    present_tension: float,
    load: float,
    efficiency: float,
    wound_length: float,
    sliding_speed: float,
) -> float:
    """Return the tension of a tendon, or the net tension of a spool pair, at the end of a control period [N].

    Args:
        c: constants of the hand.
        n: index of the tendon.
        present_tension: present tension [N].
        load: tension that the digit would need without friction at the end of the period [N].
        efficiency: tension at the joints, divided by the tension at the load cell, while a tendon
            is wound.
        wound_length: tendon length that the spool winds in the period [m].
        sliding_speed: speed at which the viscous slider would have full friction [m/s].
    """
    stiffness = c.tendon[h.TENDON_STIFFNESS, n]
    creep_length = sliding_speed * c.run[h.CONTROL_PERIOD]
    if not c.tendon_int[h.IS_SPOOL_PAIR, n]:
        return tension_after_period(
            present_tension, load, efficiency, wound_length, stiffness, creep_length
        )
    # Whenever a spool pair moves, one of its tendons is wound and the other is paid out.
    lower, upper = _friction_band_of_pair(c, n, load, efficiency)
    creep_ratio = stiffness * creep_length / (0.5 * (upper - lower) + MIN_FRICTION_N)
    elastic_tension = (present_tension + stiffness * wound_length + creep_ratio * load) / (
        1.0 + creep_ratio
    )
    return min(max(elastic_tension, lower), upper)


@kernel_helper
def tension_after_period(
    present_tension: float,
    load: float,
    efficiency: float,
    wound_length: float,
    stiffness: float,
    creep_length: float,
) -> float:
    """Predict the tension of a tendon at the next tick [N].

    Args:
        present_tension: present tension [N].
        load: tension that the digit would need at the next tick without friction [N].
        efficiency: tension at the joints, divided by the tension at the load cell, while the tendon
            is wound.
        wound_length: tendon length that the spool winds in the period [m].
        stiffness: stiffness of the tendon [N/m].
        creep_length: largest length by which the tendon can creep in the period [m].
    """
    creep_ratio = stiffness * creep_length / (load * (1.0 - efficiency) + MIN_FRICTION_N)
    # The motion of the viscous slider is computed by an implicit Euler step, which is stable for
    # any period.
    elastic_tension = (present_tension + stiffness * wound_length + creep_ratio * load) / (
        1.0 + creep_ratio
    )
    return min(max(elastic_tension, load * efficiency), load / efficiency)


@kernel_helper
def _friction_band_of_pair(
    c: ConstantTables, n: int, load: float, efficiency: float
) -> tuple[float, float]:
    """Return the smallest and the largest net tension of a spool pair with friction [N].

    Args:
        c: constants of the hand.
        n: index of the spool pair.
        load: net tension that the digit would need without friction [N].
        efficiency: tension at the joints, divided by the tension at the load cell, while a tendon
            is wound.
    """
    pretension = c.tendon[h.PRETENSION, n]
    upper = net_tension_at_spool(load, pretension, efficiency)
    lower = net_tension_at_spool(load, pretension, 1.0 / efficiency)
    return lower, upper
