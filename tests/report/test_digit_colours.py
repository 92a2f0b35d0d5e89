"""A digit has the same colour on every hand, and two digits of a hand have different colours."""

import pytest

from handctl.digit_colours import DIGITS_WITH_COLOUR, colour_numbers
from handctl.hand.hand_loading import load_hand, packaged_hands
from handctl.report.run_figure import DIGIT_COLOURS
from handctl.view.scene.palette import DIGIT_PALETTE


@pytest.mark.parametrize("digit_name", packaged_hands())
def test_a_digit_has_the_same_colour_on_every_hand(digit_name: str) -> None:
    digits = load_hand(digit_name).digit_names
    numbers = colour_numbers(digits)
    assert len(set(numbers)) == len(digits)
    assert max(numbers) < min(len(DIGIT_COLOURS), len(DIGIT_PALETTE))
    assert all(
        number == DIGITS_WITH_COLOUR.index(digit)
        for digit, number in zip(digits, numbers, strict=True)
        if digit in DIGITS_WITH_COLOUR
    )


def test_seven_digits_have_different_colours() -> None:
    numbers = colour_numbers(("wrist", "index", "middle", "ring", "little", "base", "thumb"))
    for palette in (DIGIT_COLOURS, DIGIT_PALETTE):
        assert len({palette[number] for number in numbers}) == 7


def test_digits_with_other_names_have_the_colours_in_order() -> None:
    assert colour_numbers(("left", "right")) == (0, 1)
    assert colour_numbers(("wrist", "index", "pinky")) == (4, 0, 5)
