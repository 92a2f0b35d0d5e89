"""The paper's numbers that everything else in it follows from, as exact fractions, and the hand that it describes."""

import math
from fractions import Fraction
from functools import cache

from handctl.hand.description import Hand
from handctl.hand.file.sections import Digit
from handctl.hand.load import load_hand

PULLEY_MM = Fraction(3)
"""Radius of the joint pulleys. Source: section 5."""
SPOOL_MM = Fraction(5)
"""Radius of the actuator. Source: sections 5 and 6."""
GRIP_FINGER_N = Fraction(6)
GRIP_THUMB_N = Fraction(10)
FINGERS = 3
FRICTION = Fraction(1, 2)
GRAVITY = Fraction(981, 100)
STRESS_MPA = Fraction(190)
"""Allowable stress of the wire. Source: section 5."""
KNEES_N = (Fraction(200), Fraction(250))
"""Where the force-displacement curve bends: section 5, abstract."""
PAYLOAD_KG = "0.915"


@cache
def hand() -> Hand:
    """The packaged hand, whose lengths and radii are the paper's."""
    return load_hand("jamia")


def finger() -> Digit:
    """A finger."""
    return hand().digit_named("index")


def thumb() -> Digit:
    """The thumb."""
    return hand().digit_named("thumb")


def millimetres(lengths_m: tuple[float, ...]) -> tuple[Fraction, ...]:
    """Lengths of a hand file, which are decimal numbers, exactly [mm]."""
    return tuple(1000 * Fraction(str(length)) for length in lengths_m)


def levers(digit: Digit) -> tuple[Fraction, ...]:
    """Distance of the tip from each joint of the straight digit [mm]: moment per newton at the tip."""
    lengths = millimetres(digit.link_length_m)
    return tuple(sum(lengths[i:], Fraction(0)) for i in range(len(lengths)))


def tension_per_newton(digit: Digit) -> Fraction:
    """Tension that balances joint 1 of the straight digit, for a newton at the tip [N/N]."""
    return levers(digit)[0] / PULLEY_MM


def tension_for_kg(mass: int) -> Fraction:
    """Return the tension of each finger's tendon at which three fingers' friction carries a mass [kg] [N]."""
    return mass * GRAVITY / (FINGERS * FRICTION) * tension_per_newton(finger())


def wire_diameter_mm(tension_n: Fraction | float) -> float:
    """Least diameter of a wire at the allowable stress [mm]."""
    return math.sqrt(4.0 * float(tension_n) / (math.pi * float(STRESS_MPA)))


def wire_stress_mpa(tension_n: Fraction | float, diameter_mm: float) -> float:
    """Stress in a wire [MPa]."""
    return 4.0 * float(tension_n) / (math.pi * diameter_mm**2)


def payload_kg(normal_n: Fraction) -> Fraction:
    """Mass that friction of one contact carries [kg]."""
    return FRICTION * normal_n / GRAVITY
