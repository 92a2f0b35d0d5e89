"""Hands of the benchmarks: the packaged ones, and the same with digits that touch neither the palm nor each other.

With all joints of a packaged hand at 60 degrees the fingertips are in the palm and the middle finger is on the thumb.
A motion that is to be judged as free has to be free, so these hands have the digits moved apart: nothing else differs.
"""

import tomllib
from functools import cache
from pathlib import Path

from handctl.hand.description import Hand
from handctl.hand.load import hand_from, hand_path, load_hand

CLEAR = ".clear"
"""Suffix of a packaged hand's name for its twin with room around every digit."""
FORWARD_M, APART_M = 0.04, 0.1
"""How far the digits stand in front of the palm, and from one to the next."""


@cache
def known(name: str) -> Hand:
    """A hand by its name in the benchmarks."""
    if not name.endswith(CLEAR):
        return load_hand(name)
    content = tomllib.loads(hand_path(name.removesuffix(CLEAR)).read_text())
    for i, digit in enumerate(content["digit"]):
        x, y, z = digit["mount_position_m"]
        digit["mount_position_m"] = [x + FORWARD_M, y, z + i * APART_M]
    return hand_from(content, name)


def file_of(name: str, folder: Path) -> Path:
    """Its file, for the simulator."""
    if not name.endswith(CLEAR):
        return hand_path(name)
    path = folder / f"{name}.toml"
    path.write_text(known(name).to_toml())
    return path
