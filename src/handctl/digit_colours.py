"""Order of the colours of digits.

A digit has the same colour in every figure and on every hand.
"""

from collections.abc import Sequence

DIGITS_WITH_COLOUR = ("index", "middle", "ring", "thumb")
"""Names of the digits with a fixed colour, in the order of the colours in each palette."""


def colour_numbers(digit_names: Sequence[str]) -> tuple[int, ...]:
    """Return the number of the colour of each digit in a palette.

    The digits in DIGITS_WITH_COLOUR have the first numbers. The other digits of the hand have the
    next numbers, in order. If a hand has no digit of DIGITS_WITH_COLOUR, the other digits have the
    first numbers. A number may exceed the size of a palette.
    """
    others = [name for name in digit_names if name not in DIGITS_WITH_COLOUR]
    first = 0 if len(others) == len(digit_names) else len(DIGITS_WITH_COLOUR)
    return tuple(
        DIGITS_WITH_COLOUR.index(name) if name in DIGITS_WITH_COLOUR else first + others.index(name)
        for name in digit_names
    )
