"""Names of joint angles and tensions in datasets. The command ``handctl log export --lerobot`` uses the same names."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

POSITION = ".pos_rad"
TENSION = ".tension_N"


def positions(joints: Iterable[str]) -> dict[str, type]:
    """Return the names and types of the elements with joint angles."""
    return {f"{joint}{POSITION}": float for joint in joints}


def named(joints: Iterable[str], angles: Iterable[float]) -> dict[str, float]:
    """Return joint angles [rad] as a dict whose keys are the names in a dataset."""
    return {f"{joint}{POSITION}": float(angle) for joint, angle in zip(joints, angles, strict=True)}


def angles_of(joints: tuple[str, ...], action: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the joint angles of an action in the order of the joints [rad].

    Raises:
        ValueError: the action has no angle for a joint.
    """
    missing = [joint for joint in joints if f"{joint}{POSITION}" not in action]
    if missing:
        raise ValueError(
            f"action: no {missing[0]}{POSITION}; expected an angle for each joint of the hand"
        )
    return np.array([float(action[f"{joint}{POSITION}"]) for joint in joints])
