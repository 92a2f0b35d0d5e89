"""Low-passed differences between the measured and the expected force of each tendon.

The main residual is the motor force minus tension, inertial force and friction.

The rotor of a motor obeys the equation m a = F - T - b v - c sign(v). Here m is the mass of the
rotor, a is the acceleration at the spool, and v is the speed at the spool. The force F is the motor
force, and T is the tension. The friction consists of viscous friction with the coefficient b and of
the Coulomb friction c. If the measurements disagree with this equation for 0.2 s, the load cell,
the motor or the friction does not behave as in the model. The thresholds of the residuals are far
above the noise, and cause less than one false alarm in ten thousand hours. In a second, faster
residual, the main residual is low-passed with a time constant of 20 ms. The faster residual shows a
tension that is much larger than the commanded force of the motor.
"""

import math

import numpy as np

from handctl.compiled import kernel_helper, square
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.estimation.measurements import is_cell_saturated, monitored_tension
from handctl.core.state_block import StateTables

(
    BALANCE,
    MOTOR_FORCE,
    COMMAND_DIFFERENCE,
    TENSION,
    QUICK_FORCE,
    SLIP,
    JERK,
    EXCESS_FRICTION,
    QUICK_BALANCE,
) = range(9)
"""Rows of ``state_block.RESIDUAL``."""
RESIDUAL_TIME_CONSTANTS_S = (0.2, 0.2, 0.08, 0.02, 0.02, 0.3, 0.1, 5.0, 0.02)
"""Time constant of the low-pass filter of each row [s]."""
TRUSTED_NOISE_FRACTION = 1.0 / 30.0
"""Fraction of the limit of fault N07 above which the noise of an encoder makes the acceleration useless.

Two ticks of an encoder noise of 0.04 rad reach a seventh of the limit of fault N07. Exchanged power
stages of two drives reach less than a hundredth of the limit of fault N07.
"""
TORQUE_CONSTANT_TOLERANCE = 0.1
"""Relative error of the motor force that the usual tolerance of a motor's torque constant K_t causes."""
FULL_FRICTION_SPEED_M_S = 5e-3
"""Tendon speed above which friction is fully developed [m/s]."""


@kernel_helper
def update_residuals(
    x: StateTables, c: ConstantTables, missed_ticks: int, are_cells_tared: bool
) -> None:
    """Update the low-passed residuals of all tendons.

    Args:
        x: state tables.
        c: constants of the hand.
        missed_ticks: ticks missed before the present tick. In the tick after a missed tick, positions and
            speeds are not used.
        are_cells_tared: True if the zeros of the load cells are known.
    """
    residual_sums = np.empty(len(RESIDUAL_TIME_CONSTANTS_S))
    has_started = x.run_int[s.RESIDUALS_STARTED] == 1
    x.run_int[s.RESIDUALS_STARTED] = 1
    for n in range(x.tendon.shape[1]):
        position = x.tendon[s.MEASURED_POSITION, n] if missed_ticks == 0 else math.nan
        speed = x.tendon[s.SPOOL_SPEED, n] if missed_ticks == 0 else math.nan
        # The reading of a saturated load cell is no tension. Fault T06 reports the saturation.
        is_cell_usable = are_cells_tared and not is_cell_saturated(x, c, n)
        tension = x.tendon[s.MEASURED_TENSION, n] if is_cell_usable else math.nan
        force = x.tendon[s.MEASURED_FORCE, n]
        commanded_force = x.tendon[s.COMMANDED_FORCE, n]
        motor_force = commanded_force if math.isnan(force) else force
        checked_tension = monitored_tension(x, c, n, are_cells_tared)
        if not has_started:
            # The two fast low-pass filters start at the present tension and at the present motor
            # force.
            x.tendon[s.RESIDUAL + TENSION, n] = (
                0.0 if math.isnan(checked_tension) else checked_tension
            )
            x.tendon[s.RESIDUAL + QUICK_FORCE, n] = 0.0 if math.isnan(motor_force) else motor_force
        position_change = position - x.tendon[s.LAST_POSITION, n]
        # The friction is computed as proportional to tanh(1000 v), with the speed v in m/s. Above
        # some millimetres per second, the computed friction has its full value. With tanh, the sign
        # of the computed friction does not change in every tick while the motor is at rest.
        friction_force = c.tendon[h.MOTOR_DAMPING, n] * speed + c.tendon[
            h.MOTOR_COULOMB_FRICTION, n
        ] * math.tanh(speed * 1e3)
        inertia = c.tendon[h.MOTOR_MASS, n] / c.run[h.CONTROL_PERIOD]
        balance = (
            motor_force - tension - inertia * (speed - x.tendon[s.LAST_SPEED, n]) - friction_force
        )
        residual_sums[BALANCE] = residual_sums[QUICK_BALANCE] = balance
        residual_sums[MOTOR_FORCE] = motor_force
        residual_sums[COMMAND_DIFFERENCE] = commanded_force - force
        if c.tendon_int[h.DRIVE_CLOSES_LOOP, n]:
            residual_sums[COMMAND_DIFFERENCE] = x.servo[s.EXPECTED_SERVO_FORCE, n] - force
        residual_sums[TENSION] = checked_tension
        residual_sums[QUICK_FORCE] = motor_force
        residual_sums[SLIP] = x.tendon[s.TENDON_SLIP, n]
        residual_sums[JERK] = square(position_change - x.tendon[s.LAST_POSITION_STEP, n])
        # Friction has the sign of the speed, so the excess friction is the residual of the force
        # balance, multiplied by the sign of the speed.
        residual_sums[EXCESS_FRICTION] = (
            math.copysign(1.0, speed) * balance
            if abs(speed) > FULL_FRICTION_SPEED_M_S
            else math.nan
        )
        for row in range(len(RESIDUAL_TIME_CONSTANTS_S)):
            low = x.tendon[s.RESIDUAL + row, n]
            if not math.isnan(residual_sums[row] - low):
                x.tendon[s.RESIDUAL + row, n] = low + c.tendon[
                    h.RESIDUAL_UPDATE_FRACTION + row, n
                ] * (residual_sums[row] - low)
        x.tendon[s.LAST_SPEED, n] = speed
        x.tendon[s.LAST_POSITION, n] = position
        x.tendon[s.LAST_POSITION_STEP, n] = position_change


@kernel_helper
def unexplained_tension(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the part of the main residual that the model cannot explain [N].

    Friction and the tolerance of the motor force explain the other part of the residual. The main
    residual is filtered with a time constant of 0.2 s. The result is 0 or more.
    """
    residual = abs(x.tendon[s.RESIDUAL + BALANCE, n])
    return max(residual - _max_explained_difference(x, c, n, MOTOR_FORCE), 0.0)


@kernel_helper
def excess_tension(x: StateTables, c: ConstantTables, n: int) -> float:
    """Return the excess of a tension over the largest tension that its motor explains [N], 0 or more.

    The excess tension is filtered with a time constant of 20 ms. While the encoder of the motor is
    noisy, the acceleration of the rotor is wrong, and the excess tension is set to 0. Fault N07
    reports the noise.
    """
    if abs(x.tendon[s.RESIDUAL + JERK, n]) > TRUSTED_NOISE_FRACTION * c.run[h.POSITION_NOISE_LIMIT]:
        return 0.0
    excess = -x.tendon[s.RESIDUAL + QUICK_BALANCE, n]
    return max(excess - _max_explained_difference(x, c, n, QUICK_FORCE), 0.0)


@kernel_helper
def _max_explained_difference(x: StateTables, c: ConstantTables, n: int, force_row: int) -> float:
    """Return the largest residual that friction and the tolerance of the motor force explain [N]."""
    tolerance = TORQUE_CONSTANT_TOLERANCE * abs(x.tendon[s.RESIDUAL + force_row, n])
    return float(c.tendon[h.MOTOR_COULOMB_FRICTION, n] + tolerance)


@kernel_helper
def excess_friction(x: StateTables, n: int) -> float:
    """Return the excess of a moving rotor's friction over the friction of the model [N], 0 or more."""
    return max(
        x.tendon[s.RESIDUAL + EXCESS_FRICTION, n]
        - TORQUE_CONSTANT_TOLERANCE * abs(x.tendon[s.RESIDUAL + MOTOR_FORCE, n]),
        0.0,
    )
