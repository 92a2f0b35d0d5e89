"""Name the elements of actions and observations in datasets, as ``handctl log export --lerobot`` does."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

TENSION = ".tension_N"


def named(names: Iterable[str], positions: Iterable[float]) -> dict[str, float]:
    """Return joint positions [rad, or m for prismatic joints] by their names in a dataset.

    Args:
        names: names of the elements of an action, see ``position_names``.
        positions: position of each joint.
    """
    return {name: float(position) for name, position in zip(names, positions, strict=True)}


def positions_of(names: tuple[str, ...], action: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the joint positions of an action in the order of ``names`` [rad, or m for prismatic joints].

    Raises:
        ValueError: the action has no position for a joint.
    """
    missing = [name for name in names if name not in action]
    if missing:
        raise ValueError(f"action: no {missing[0]}; expected a position for each joint of the hand")
    return np.array([float(action[name]) for name in names])
