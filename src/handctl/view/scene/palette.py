"""Colours of the dashboard. All links, force arrows and plot lines of a digit have the same hue."""

from typing import NamedTuple


class Colour(NamedTuple):
    """Colour with the components red, green and blue, from 0 to 255."""

    red: int
    green: int
    blue: int

    def mixed_with(self, other_colour: "Colour", fraction: float) -> "Colour":
        """Return a mix of this colour and another colour.

        With the fraction 0, the result is this colour. With the fraction 1, the result is
        ``other_colour``.
        """
        return Colour(
            *(round(a + fraction * (b - a)) for a, b in zip(self, other_colour, strict=True))
        )


WHITE = Colour(255, 255, 255)
BLACK = Colour(13, 16, 17)
PALM_COLOUR = Colour(96, 104, 116)
LIMIT_COLOUR = Colour(255, 72, 66)
NEUTRAL_COLOUR = Colour(168, 180, 196)
DIGIT_PALETTE = (
    Colour(84, 160, 255),
    Colour(255, 166, 64),
    Colour(76, 206, 136),
    Colour(246, 104, 158),
    Colour(184, 146, 255),
    Colour(206, 206, 92),
    Colour(104, 206, 216),
)
"""Colours of the digits.

The colours of the digits suit a dark background. People with red-green colour blindness can
distinguish the colours of the digits.
"""

PHASE_COLOURS = {
    "idle": Colour(84, 90, 100),
    "silent": Colour(84, 90, 100),
    "done": Colour(84, 90, 100),
    "end": Colour(84, 90, 100),
    "start": Colour(112, 120, 132),
    "inventory": Colour(112, 120, 132),
    "ready": Colour(122, 142, 190),
    "disarm": Colour(122, 142, 190),
    "tighten": Colour(122, 142, 190),
    "home": Colour(122, 142, 190),
    "preshape": Colour(84, 160, 255),
    "move": Colour(84, 160, 255),
    "open": Colour(84, 160, 255),
    "close": Colour(255, 166, 64),
    "arming": Colour(206, 206, 92),
    "live": Colour(206, 206, 92),
    "hold": Colour(76, 206, 136),
    "active": Colour(76, 206, 136),
    "release": Colour(184, 146, 255),
    "relax": Colour(255, 140, 64),
    "cut": Colour(255, 72, 66),
}
"""Colours of the grasp phases and of the modes of the hand, by name."""
ACTION_COLOURS = {
    "pass": Colour(66, 74, 84),
    "warn": Colour(206, 206, 92),
    "hold": Colour(255, 166, 64),
    "relax": Colour(255, 120, 64),
    "cut": Colour(255, 72, 66),
}
"""Colours of the actions of the safety monitor, by name."""


def digit_colour(digit_index: int) -> Colour:
    """Return the colour of a digit by its colour number.

    The function ``colour_numbers`` returns the colour number of each digit of a hand.
    """
    return DIGIT_PALETTE[digit_index % len(DIGIT_PALETTE)]


def joint_colours(digit_index: int, joint_count: int) -> list[Colour]:
    """Return a colour for each joint of a digit. The colours get lighter towards the tip."""
    return [
        digit_colour(digit_index).mixed_with(WHITE, 0.4 * i / max(joint_count - 1, 1))
        for i in range(joint_count)
    ]


def dimmed_colour(colour: Colour) -> Colour:
    """Return a dimmed colour, for a command that is drawn next to an estimate."""
    return colour.mixed_with(BLACK, 0.45)
