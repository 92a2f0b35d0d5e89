"""Hands of the benchmarks: the packaged hands, and variants of these hands with more distance between their digits.

When all joints of a packaged hand are at 60 degrees, the fingertips touch the palm, and the middle
finger touches the thumb. In the benchmarks of free motion the digits must not touch any object. In
the variants the digits are therefore moved apart. All other properties of the hands are unchanged.
"""

from functools import cache
from pathlib import Path

from handctl.hand.description import Hand
from handctl.hand.hand_loading import hand_content, hand_from_content, hand_path, load_hand

CLEAR_SUFFIX = ".clear"
"""Suffix in the name of the variant of a packaged hand that has free space around every digit."""
SIDE_SUFFIX = ".side"
"""Suffix in the name of the variant that also lies on its side.

Gravity then acts in the plane in which the digits flex.
"""
SIDE_GRAVITY_M_S2 = [0.0, -9.81, 0.0]
"""Gravity in the frame of the palm [m/s2], from the fingers to the thumb.

This gravity closes the fingers and opens the thumb.
"""
FINGERTIP_LOAD = 10.0
"""Factor on mass and inertia of the last links of a hand on its side. With this factor a fingertip weighs 21 g."""
FORWARD_M, APART_M = 0.04, 0.1
"""Distance of the digits from the palm, and distance between neighbouring digits, in the variants [m]."""


@cache
def hand_by_name(name: str) -> Hand:
    """Return the hand that has a name in the benchmarks."""
    if not name.endswith((CLEAR_SUFFIX, SIDE_SUFFIX)):
        return load_hand(name)
    content = hand_content(packaged_name(name))
    for i, digit in enumerate(content["digit"]):
        x, y, z = digit["mount_position_m"]
        digit["mount_position_m"] = [x + FORWARD_M, y, z + i * APART_M]
        if name.endswith(SIDE_SUFFIX):
            for key in ("link_mass_kg", "link_inertia_kg_m2"):
                digit[key][-1] *= FINGERTIP_LOAD
    if name.endswith(SIDE_SUFFIX):
        content["mount"]["gravity_m_s2"] = SIDE_GRAVITY_M_S2
    return hand_from_content(content, name)


def packaged_name(name: str) -> str:
    """Return the name of the packaged hand from which a hand of the benchmarks is derived."""
    return name.removesuffix(CLEAR_SUFFIX).removesuffix(SIDE_SUFFIX)


def hand_file_of(name: str, folder: Path) -> Path:
    """Return the path of the hand file for the simulator. The file of a variant is written into the folder."""
    if not name.endswith((CLEAR_SUFFIX, SIDE_SUFFIX)):
        return hand_path(name)
    path = folder / f"{name}.toml"
    path.write_text(hand_by_name(name).to_toml())
    return path
