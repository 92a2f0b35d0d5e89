"""Hands of the benchmarks: the packaged ones, and the same with digits that touch neither the palm nor each other.

With all joints of a packaged hand at 60 degrees the fingertips touch the palm and the middle finger touches the thumb.
A motion that is judged as free must be free. These hands have the digits moved apart and are otherwise the same.
"""

from functools import cache
from pathlib import Path

from handctl.hand.description import Hand
from handctl.hand.load import hand_content, hand_from, hand_path, load_hand

CLEAR = ".clear"
"""Suffix of a packaged hand's name for its twin with room around every digit."""
SIDE = ".side"
"""Suffix of its twin that lies on its side: gravity acts in the plane in which the digits flex. Also with room."""
SIDE_GRAVITY_M_S2 = [0.0, -9.81, 0.0]
"""In the palm's frame, from the fingers to the thumb: fingers are pulled closed, the thumb is pulled open."""
FINGERTIP_LOAD = 10.0
"""Factor on mass and inertia of the last link of each digit lying on its side: a fingertip of 21 g."""
FORWARD_M, APART_M = 0.04, 0.1
"""How far the digits stand in front of the palm, and from one to the next."""


@cache
def hand_by_name(name: str) -> Hand:
    """Return a hand by its name in the benchmarks."""
    if not name.endswith((CLEAR, SIDE)):
        return load_hand(name)
    content = hand_content(packaged(name))
    for i, digit in enumerate(content["digit"]):
        x, y, z = digit["mount_position_m"]
        digit["mount_position_m"] = [x + FORWARD_M, y, z + i * APART_M]
        if name.endswith(SIDE):
            for key in ("link_mass_kg", "link_inertia_kg_m2"):
                digit[key][-1] *= FINGERTIP_LOAD
    if name.endswith(SIDE):
        content["mount"]["gravity_m_s2"] = SIDE_GRAVITY_M_S2
    return hand_from(content, name)


def packaged(name: str) -> str:
    """Return the name of the packaged hand that a hand of the benchmarks is made of."""
    return name.removesuffix(CLEAR).removesuffix(SIDE)


def file_of(name: str, folder: Path) -> Path:
    """Return the file of a hand, for the simulator."""
    if not name.endswith((CLEAR, SIDE)):
        return hand_path(name)
    path = folder / f"{name}.toml"
    path.write_text(hand_by_name(name).to_toml())
    return path
