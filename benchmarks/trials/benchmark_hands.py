"""Hands of the benchmarks: the packaged hands, and variants with more distance between the digits.

When all joints of a packaged hand are at 60 degrees, the fingertips touch the palm, and the middle
finger touches the thumb. In benchmarks of free motion, the digits must not touch anything.
Therefore the variants of a packaged hand have more distance between the digits. Variants are tested
in the scene ``no_palm``, in which the digits can pass through the palm. In the variants that lie on
their side, gravity has another direction, and the last links are heavier. All other properties of a
variant are those of the packaged hand.
"""

from functools import cache
from pathlib import Path

from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content, hand_path, load_hand

SPACED_HAND_SUFFIX = ".clear"
"""Suffix in the names of the variants with free space around every digit."""
FREE_MOTION_SCENE = "no_palm"
"""Scene for the trials with variants of the packaged hands.

The simulator places the palm behind the mounts of the digits, at any distance between the mounts.
Digits can touch the palm even if the distance between the digits is large.
"""
SIDEWAYS_HAND_SUFFIX = ".side"
"""Suffix in the names of the variants that lie on their side.

The digits of these variants are also farther apart. If a hand lies on its side, gravity acts in the
plane in which the digits flex.
"""
SIDE_GRAVITY_M_S2 = [0.0, -9.81, 0.0]
"""Gravity in the palm frame of a hand that lies on its side [m/s2].

The direction of gravity is from the fingers to the thumb. On a hand that lies on its side, gravity
closes the fingers and opens the thumb.
"""
FINGERTIP_MASS_FACTOR = 10.0
"""Factor that multiplies mass and inertia of the last links, for a hand that lies on its side.

With this factor, a fingertip weighs 21 g.
"""
ADDED_DIGIT_DISTANCE_M = 0.1
"""Additional distance between neighbouring digits of the variants [m]."""


@cache
def hand_by_name(hand_name: str) -> Hand:
    """Return the hand with the name ``hand_name``: a packaged hand or a variant of a packaged hand."""
    if not hand_name.endswith((SPACED_HAND_SUFFIX, SIDEWAYS_HAND_SUFFIX)):
        return load_hand(hand_name)
    content = hand_content(packaged_hand_name(hand_name))
    for i, digit in enumerate(content["digit"]):
        x, y, z = digit["mount_position_m"]
        digit["mount_position_m"] = [x, y, z + i * ADDED_DIGIT_DISTANCE_M]
        if hand_name.endswith(SIDEWAYS_HAND_SUFFIX):
            for key in ("link_mass_kg", "link_inertia_kg_m2"):
                digit[key][-1] *= FINGERTIP_MASS_FACTOR
    if hand_name.endswith(SIDEWAYS_HAND_SUFFIX):
        content["mount"]["gravity_m_s2"] = SIDE_GRAVITY_M_S2
    return hand_from_content(content, hand_name)


def packaged_hand_name(hand_name: str) -> str:
    """Return the name of the packaged hand from which a variant is derived."""
    return hand_name.removesuffix(SPACED_HAND_SUFFIX).removesuffix(SIDEWAYS_HAND_SUFFIX)


def hand_file_of(hand_name: str, file_folder: Path) -> Path:
    """Return the path of the hand file for the simulator. Write the file of a variant into ``file_folder``."""
    if not hand_name.endswith((SPACED_HAND_SUFFIX, SIDEWAYS_HAND_SUFFIX)):
        return hand_path(hand_name)
    path = file_folder / f"{hand_name}.toml"
    path.write_text(hand_by_name(hand_name).to_toml())
    return path
