"""Low-passed residuals of a tendon: tension minus motor torque, inertia and friction, and similar differences.

A rotor at the spool: m a = F - T - b v - c sign(v). A further force in the load cell's reading,
over a fifth of a second, is an error of the cell, the motor or the friction. The thresholds are far
from the noise: no false alarm in ten thousand hours.
"""

import math

import numpy as np

from handctl.compiled import inner, square
from handctl.core import block as s
from handctl.core import constants as h
from handctl.core.block import Tables
from handctl.core.constants import ConstantTables
from handctl.core.estimation.measure import monitored_tension

BALANCE, MADE, ASKED, TENSION, QUICK_FORCE, SLIP, JERK, RUB = range(8)
"""Rows of ``block.RESIDUAL``."""
TIMES_S = (0.2, 0.2, 0.08, 0.02, 0.02, 0.3, 0.1, 5.0)
"""Time constant of each row [s]."""
GAIN_FRACTION = 0.1
"""Tolerance of the torque constant, as a fraction of the motor force. Source: usual tolerance of K_t."""
RUB_SPEED = 5e-3
"""Tendon speed of fully developed friction [m/s]."""


@inner
def update(x: Tables, c: ConstantTables, missed: int, tared: bool) -> None:
    """Filter the residuals of a tick.

    Args:
        x: state tables.
        c: constants of the hand.
        missed: ticks missed before the present tick. The duration of a motion is then unknown.
        tared: True if the load cells' zero is known.
    """
    now = np.empty(8)
    initialized = x.run_int[s.FILTERED] == 1
    x.run_int[s.FILTERED] = 1
    for n in range(x.tendon.shape[1]):
        position = x.tendon[s.MEASURED_POSITION, n] if missed == 0 else math.nan
        speed = x.tendon[s.SPEED, n] if missed == 0 else math.nan
        tension = x.tendon[s.MEASURED_TENSION, n] if tared else math.nan
        force = x.tendon[s.MEASURED_FORCE, n]
        commanded = x.tendon[s.COMMANDED_FORCE, n]
        made = commanded if math.isnan(force) else force
        monitored = monitored_tension(x, c, n, tared)
        if not initialized:
            # What is filtered quickly begins at what is there.
            x.tendon[s.RESIDUAL + TENSION, n] = 0.0 if math.isnan(monitored) else monitored
            x.tendon[s.RESIDUAL + QUICK_FORCE, n] = 0.0 if math.isnan(made) else made
        turned = position - x.tendon[s.LAST_POSITION, n]
        # Friction as tanh(1000 v): full above some millimetres per second, without chatter at rest.
        drag = c.tendon[h.MOTOR_DAMPING, n] * speed + c.tendon[h.COULOMB, n] * math.tanh(speed * 1e3)
        inertia = c.tendon[h.MOTOR_MASS, n] / c.run[h.PERIOD]
        balance = made - tension - inertia * (speed - x.tendon[s.LAST_SPEED, n]) - drag
        now[BALANCE] = balance
        now[MADE] = made
        now[ASKED] = commanded - force
        now[TENSION] = monitored
        now[QUICK_FORCE] = made
        now[SLIP] = x.tendon[s.SLIP, n]
        now[JERK] = square(turned - x.tendon[s.LAST_TURNED, n])
        # Against the motion: what rubs has the sign of the speed.
        now[RUB] = math.copysign(1.0, speed) * balance if abs(speed) > RUB_SPEED else math.nan
        for row in range(8):
            low = x.tendon[s.RESIDUAL + row, n]
            if not math.isnan(now[row] - low):
                x.tendon[s.RESIDUAL + row, n] = low + c.tendon[h.RESIDUAL_FRACTION + row, n] * (now[row] - low)
        x.tendon[s.LAST_SPEED, n] = speed
        x.tendon[s.LAST_POSITION, n] = position
        x.tendon[s.LAST_TURNED, n] = turned


@inner
def unexplained(x: Tables, c: ConstantTables, n: int) -> float:
    """Return the tension beyond friction and the tolerance of the torque constant [N], 0 or more."""
    explained = c.tendon[h.COULOMB, n] + GAIN_FRACTION * abs(x.tendon[s.RESIDUAL + MADE, n])
    return max(abs(x.tendon[s.RESIDUAL + BALANCE, n]) - explained, 0.0)


@inner
def friction(x: Tables, n: int) -> float:
    """Return by how much the friction of a moving rotor exceeds the model [N]."""
    return max(x.tendon[s.RESIDUAL + RUB, n] - GAIN_FRACTION * abs(x.tendon[s.RESIDUAL + MADE, n]), 0.0)
