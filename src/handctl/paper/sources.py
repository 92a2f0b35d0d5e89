"""Numbers in the paper from which all others follow, as exact fractions, and the paper's hand."""

import math
from fractions import Fraction
from functools import cache

from handctl.hand.description import Hand
from handctl.hand.file.sections import Digit
from handctl.hand.load import load_hand

PULLEY_MM = Fraction(3)
"""Radius of the joint pulleys [mm]. Source: section 5."""
SPOOL_MM = Fraction(5)
"""Radius of the actuator pulley [mm]. Source: sections 5 and 6."""
GRIP_FINGER_N = Fraction(6)
"""Force of each finger [N]."""
GRIP_THUMB_N = Fraction(10)
"""Force of the thumb [N]."""
FINGERS = 3
"""Number of fingers."""
FRICTION = Fraction(1, 2)
"""Coefficient of friction."""
GRAVITY = Fraction(981, 100)
"""Acceleration of gravity [m/s^2]."""
STRESS_MPA = Fraction(190)
"""Allowable stress of the wire [MPa]. Source: section 5."""
KNEES_N = (Fraction(200), Fraction(250))
"""Knees of the force-displacement curve in section 5 and in the abstract [N]."""
PAYLOAD_KG = "0.915"
"""Payload as printed [kg]."""


@cache
def paper_hand() -> Hand:
    """Return the packaged hand with the lengths and radii of the paper."""
    return load_hand("jamia")


def paper_finger() -> Digit:
    """Return a finger of this hand."""
    return paper_hand().digit_named("index")


def paper_thumb() -> Digit:
    """Return the thumb of this hand."""
    return paper_hand().digit_named("thumb")


def millimetres(lengths_m: tuple[float, ...]) -> tuple[Fraction, ...]:
    """Return lengths from a hand file as exact numbers [mm]. The file writes decimal numbers, so the
    conversion loses nothing."""
    return tuple(1000 * Fraction(str(length)) for length in lengths_m)


def levers_mm(digit: Digit) -> tuple[Fraction, ...]:
    """Return the distance of the tip from each joint of the straight digit [mm], equal to the moment per newton."""
    lengths = millimetres(digit.link_length_m)
    return tuple(sum(lengths[i:], Fraction(0)) for i in range(len(lengths)))


def tension_per_newton(digit: Digit) -> Fraction:
    """Return the tension that balances joint 1 of the straight digit, per newton of tip force [N/N]."""
    return levers_mm(digit)[0] / PULLEY_MM


def tension_of_payload_kg(mass: int) -> Fraction:
    """Return the tension of each finger's tendon at which friction of three fingers holds a mass [N]."""
    return mass * GRAVITY / (FINGERS * FRICTION) * tension_per_newton(paper_finger())


def wire_diameter_mm(tension_n: Fraction | float) -> float:
    """Return the smallest diameter of a wire at the allowable stress [mm]."""
    return math.sqrt(4.0 * float(tension_n) / (math.pi * float(STRESS_MPA)))


def wire_stress_mpa(tension_n: Fraction | float, diameter_mm: float) -> float:
    """Return the stress in a wire [MPa]."""
    return 4.0 * float(tension_n) / (math.pi * diameter_mm**2)


def payload_kg(normal_n: Fraction) -> Fraction:
    """Return the mass that the friction of a contact holds [kg]."""
    return FRICTION * normal_n / GRAVITY
