"""Names of joints and tendons in datasets, the same as in ``handctl log export --lerobot``."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

POSITION = ".pos_rad"
TENSION = ".tension_N"


def positions(joints: Iterable[str]) -> dict[str, type]:
    """Return the features of joint angles."""
    return {f"{joint}{POSITION}": float for joint in joints}


def named(joints: Iterable[str], angles: Iterable[float]) -> dict[str, float]:
    """Return joint angles by their names [rad]."""
    return {f"{joint}{POSITION}": float(angle) for joint, angle in zip(joints, angles, strict=True)}


def angles_of(joints: tuple[str, ...], action: Mapping[str, Any]) -> NDArray[np.float64]:
    """Return the joint angles of an action in the order of the joints [rad].

    Raises:
        ValueError: an angle is missing.
    """
    missing = [joint for joint in joints if f"{joint}{POSITION}" not in action]
    if missing:
        raise ValueError(f"action: no {missing[0]}{POSITION}; expected an angle for each joint of the hand")
    return np.array([float(action[f"{joint}{POSITION}"]) for joint in joints])
