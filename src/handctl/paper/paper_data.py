"""The hand of the paper, and the input numbers of the paper as exact fractions.

The remaining numbers of the paper can be calculated from the input numbers.
"""

import math
from fractions import Fraction
from functools import cache

from handctl.hand.description import Hand
from handctl.hand.file.section_models import Digit
from handctl.hand.hand_loading import load_hand

PULLEY_RADIUS_MM = Fraction(3)
"""Radius of the joint pulleys [mm]. Source: section 5."""
SPOOL_RADIUS_MM = Fraction(5)
"""Radius of the actuator pulley [mm]. Source: sections 5 and 6."""
FINGER_GRIP_FORCE_N = Fraction(6)
"""Force with which each finger presses [N]."""
THUMB_GRIP_FORCE_N = Fraction(10)
"""Force with which the thumb presses [N]."""
FINGER_COUNT = 3
"""Number of fingers."""
FRICTION_COEFFICIENT = Fraction(1, 2)
"""Coefficient of friction between digits and object."""
GRAVITY_M_PER_S2 = Fraction(981, 100)
"""Acceleration of gravity [m/s^2]."""
ALLOWABLE_STRESS_MPA = Fraction(190)
"""Allowable stress of the wire [MPa]. Source: section 5."""
KNEE_TENSIONS_N = (Fraction(200), Fraction(250))
"""Tensions at the knee of the force-displacement curve: the value in section 5, and the value in the abstract [N]."""
PAYLOAD_KG = "0.915"
"""Payload, as it is printed in the paper [kg]."""


@cache
def paper_hand() -> Hand:
    """Return the packaged hand that has the lengths and radii of the paper."""
    return load_hand("jamia")


def paper_finger() -> Digit:
    """Return a finger of the paper's hand."""
    return paper_hand().digit_named("index")


def paper_thumb() -> Digit:
    """Return the thumb of the paper's hand."""
    return paper_hand().digit_named("thumb")


def exact_millimetres(lengths_m: tuple[float, ...]) -> tuple[Fraction, ...]:
    """Convert lengths from a hand file to exact fractions [mm].

    The conversion is exact, because a hand file contains decimal numbers.
    """
    return tuple(1000 * Fraction(str(length)) for length in lengths_m)


def tip_distances_mm(digit: Digit) -> tuple[Fraction, ...]:
    """Return, for each joint of a straight digit, the distance [mm] between the joint and the tip.

    For a force of 1 N at the tip, the moment at the joint [N mm] has the same number as the
    distance [mm].
    """
    lengths = exact_millimetres(digit.link_length_m)
    return tuple(sum(lengths[i:], Fraction(0)) for i in range(len(lengths)))


def tension_per_newton(digit: Digit) -> Fraction:
    """Return the tendon tension that balances a force of 1 N at the tip of a straight digit [N/N].

    At joint 1, the moment of the tendon equals the moment of the tip force.
    """
    return tip_distances_mm(digit)[0] / PULLEY_RADIUS_MM


def tension_for_payload(mass: int) -> Fraction:
    """Return the tension [N] in the tendon of each finger when three fingers hold a mass.

    Friction between fingers and object carries the weight of the mass [kg].
    """
    return (
        mass
        * GRAVITY_M_PER_S2
        / (FINGER_COUNT * FRICTION_COEFFICIENT)
        * tension_per_newton(paper_finger())
    )


def wire_diameter_mm(tension_n: Fraction | float) -> float:
    """Return the diameter [mm] at which a wire under a given tension has the allowable stress."""
    return math.sqrt(4.0 * float(tension_n) / (math.pi * float(ALLOWABLE_STRESS_MPA)))


def wire_stress_mpa(tension_n: Fraction | float, diameter_mm: float) -> float:
    """Return the stress [MPa] in a wire of a given diameter under a given tension."""
    return 4.0 * float(tension_n) / (math.pi * diameter_mm**2)


def payload_kg(normal_force_N: Fraction) -> Fraction:
    """Return the mass [kg] that the friction of one contact holds at a given normal force."""
    return FRICTION_COEFFICIENT * normal_force_N / GRAVITY_M_PER_S2
