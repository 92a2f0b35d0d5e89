"""Integral of the position error, for tendons that keep their joints at an angle while the hand pulls.

During a hold, the joints that close a digit are tension controlled. Its sideways joints keep their
angles, and so do the digits that carry it, such as a wrist. The contact loads these joints with
torques that no trajectory requires. The motion loop alone is a spring of stiffness k: a load F
displaces it by F / k. Therefore the tension goal of such a tendon contains a leaky integral I of
the position error:

    I' = (k (s_d - s) - I / G) / T_i        T_i = RESET_FACTOR / d

Against a constant load, the stiffness of the loop is then (1 + G) k. The damping of the motion loop
is d [1/s], and its crossover frequency is at least about d. There, the integral costs a phase of
atan(1 / RESET_FACTOR). Source: Astrom & Murray (2008), section 10.3.

The gain G is finite because held joints form a closed chain through the object. Small differences
between their angles and the shape of the object would make a pure integral grow up to the tension
limits, with forces that the joints exert on each other.
"""

from handctl.compiled import kernel_helper
from handctl.core import constants as h
from handctl.core import state_block as s
from handctl.core.constants import ConstantTables
from handctl.core.control_law.digit_reference import MOTION, STREAMED, TENSION
from handctl.core.state_block import StateTables
from handctl.core.tick_types import ACTIVE_MODE

RESET_FACTOR = 8.0
"""Reset time of the integral, times the damping of the motion loop: 7 degrees of phase margin."""
STATIC_GAIN = 10.0
"""G: stiffness that the integral adds against a constant load, divided by the motion loop's stiffness."""
MIN_INTEGRAL_N = 1e-3
"""Smallest integral that remains while it fades [N]."""


@kernel_helper
def is_hand_pulling(x: StateTables) -> bool:
    """Return True if at least one tendon of an active hand is tension controlled."""
    if x.run_int[s.MODE] != ACTIVE_MODE:
        return False
    for n in range(x.tendon.shape[1]):
        if x.tendon_int[s.GOAL_KIND, n] == TENSION:
            return True
    return False


@kernel_helper
def holds_position(x: StateTables, c: ConstantTables, n: int, pulling: bool) -> bool:
    """Return True if a tendon keeps its joints at an angle while other tendons pull.

    A stream may ask for compliant joints, so its tendons are excluded.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        pulling: result of ``is_hand_pulling``.
    """
    d = c.tendon_int[h.DIGIT_OF_TENDON, n]
    return (
        pulling
        and c.tendon_int[h.KEEPS_POSITION, n] == 1
        and x.tendon_int[s.GOAL_KIND, n] == MOTION
        and x.digit_int[s.TRAJECTORY_KIND, d] != STREAMED
    )


@kernel_helper
def position_integral(
    x: StateTables, c: ConstantTables, n: int, holds: bool, error: float, stiffness: float
) -> float:
    """Return the integral of a tendon's position error after this tick [N], without limits.

    The integral of a tendon that holds no position fades.

    Args:
        x: state tables.
        c: constants of the hand.
        n: index of the tendon.
        holds: result of ``holds_position``.
        error: excursion on the trajectory less estimated excursion [m].
        stiffness: stiffness of the motion loop [N/m].
    """
    integral = x.tendon[s.TENSION_INTEGRAL, n]
    if not holds:
        integral *= c.run[h.TRIM_DECAY]
        return integral if abs(integral) > MIN_INTEGRAL_N else 0.0
    fraction = c.run[h.PERIOD] * c.tendon[h.SPEED_GAIN, n] / RESET_FACTOR
    return float(integral + fraction * (stiffness * error - integral / STATIC_GAIN))
