"""Observation vector of a Gymnasium environment.

The observation vector consists of named values with fixed bounds. Most values of the vector come
from the telemetry.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from handctl.core.tick_types import TELEMETRY_AXES
from handctl.hand.description import Hand
from handctl.runtime.observations import PUBLISHED_NAME_BY_FIELD

Float32Array = NDArray[np.float32]
"""Type of an observation, and of an action."""
TELEMETRY_FIELD_BY_PART_NAME = {name: field for field, name in PUBLISHED_NAME_BY_FIELD.items()}
"""Field of the telemetry that provides the values of an observation's part, by name of the part."""


class ObservationPart(NamedTuple):
    """Part of an observation whose values all have the same meaning, such as joint angles.

    Attributes:
        name: name of the part with the unit, as in ``handctl.client.Observation``.
        value_names: name of each value of the part, e.g. the names of the joints.
        low, high: bounds of every value of the part.
    """

    name: str
    value_names: tuple[str, ...]
    low: float
    high: float


class ObservationLayout:
    """Names, units and bounds of an observation vector.

    Attributes:
        parts: parts of the vector, in order.
        names: name of every value of the vector with the unit, e.g. ``q_rad[index_j1]``.
        space: bounds of the values of the vector, as a Gymnasium space. Values outside the bounds
            are clipped.
    """

    def __init__(self, parts: Sequence[ObservationPart]) -> None:
        """Place the values of the parts in the vector, one part after the other."""
        self.parts = tuple(parts)
        self.names = tuple([f"{part.name}[{name}]" for part in parts for name in part.value_names])
        sizes = [len(part.value_names) for part in parts]
        low = np.repeat(np.array([part.low for part in parts], np.float32), sizes)
        high = np.repeat(np.array([part.high for part in parts], np.float32), sizes)
        self.space = Box(low, high, dtype=np.float32)

    def to_vector(self, values_of_part: Callable[[str], Any]) -> Float32Array:
        """Return the observation as a vector.

        Args:
            values_of_part: function that takes the name of a part and returns its values. An unknown value
                (NaN) becomes 0.
        """
        part_values = np.concatenate(
            [
                np.asarray(values_of_part(observation_part.name), np.float64)
                for observation_part in self.parts
            ]
        )
        clipped_values = np.clip(
            np.nan_to_num(part_values, nan=0.0).astype(np.float32), self.space.low, self.space.high
        )
        return np.asarray(clipped_values, np.float32)


def telemetry_observation(hand: Hand, name: str, low: float, high: float) -> ObservationPart:
    """Return the observation part for a telemetry field, given by name and unit, such as ``q_rad``."""
    axis: Mapping[str, tuple[str, ...]] = {
        "joint": hand.joints,
        "tendon": hand.tendon_names,
        "motor": tuple(motor.name for motor in hand.motor),
        "digit": hand.digit_names,
    }
    return ObservationPart(
        name, axis[TELEMETRY_AXES[TELEMETRY_FIELD_BY_PART_NAME[name]]], low, high
    )
