"""Assignment of the colours of a palette to digits.

A digit of a given name has the same colour in every figure and on every hand.
"""

from collections.abc import Sequence

DIGITS_WITH_COLOUR = ("index", "middle", "ring", "thumb")
"""Names of the digits with a fixed colour, in the order of the colours in each palette."""


def colour_numbers(digit_names: Sequence[str]) -> tuple[int, ...]:
    """Return the index of each digit's colour in a palette.

    The digits in DIGITS_WITH_COLOUR have the first indices. Digits whose names are not in
    DIGITS_WITH_COLOUR have the next indices, in the order of the hand. If no digit of the hand is
    in DIGITS_WITH_COLOUR, the indices of the digits begin at 0. An index can exceed the number of
    colours in the palette.
    """
    other_digit_names = [name for name in digit_names if name not in DIGITS_WITH_COLOUR]
    first_colour = 0 if len(other_digit_names) == len(digit_names) else len(DIGITS_WITH_COLOUR)
    return tuple(
        DIGITS_WITH_COLOUR.index(name)
        if name in DIGITS_WITH_COLOUR
        else first_colour + other_digit_names.index(name)
        for name in digit_names
    )
