"""The numbers of one tick for the log: which fields of the block they are, in which order."""

import numpy as np

from handctl.core.schema import Block, Layout
from handctl.core.types import TELEMETRY_FIELDS, PackedTelemetry

FIELD_OF = {
    "joint_encoder": "measured_joint",
    "tension_sigma": "sigma",
    "tension_raw": "measured_tension",
    "external_tension": "external",
    "motor_position": "measured_position",
    "motor_torque_goal": "torque",
    "motor_temperature": "temperature",
}
"""Fields of the block for those of the telemetry that have another name there."""


class Gather:
    """Takes the telemetry of a hand out of its block."""

    def __init__(self, layout: Layout) -> None:
        numbered = np.arange(layout.size, dtype=np.float64)
        parts = [layout.view(numbered, FIELD_OF.get(name, name)) for name in TELEMETRY_FIELDS]
        ends = np.cumsum([0, *map(len, parts)]).tolist()
        self._index = np.concatenate(parts).astype(np.intp)
        self._places = {
            name: slice(first, end) for name, first, end in zip(TELEMETRY_FIELDS, ends[:-1], ends[1:], strict=True)
        }

    def __call__(self, block: Block) -> PackedTelemetry:
        """Return the numbers of a block."""
        return PackedTelemetry(block.take(self._index), self._places)
