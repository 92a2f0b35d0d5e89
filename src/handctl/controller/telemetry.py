"""Places of the telemetry for the log in the state block."""

import numpy as np

from handctl.core.block_schema import BlockLayout
from handctl.core.tick_types import TELEMETRY_FIELDS, TelemetrySlices

STATE_FIELD_BY_TELEMETRY_FIELD = {
    "joint_encoder": "measured_joint",
    "tension_sigma": "sigma",
    "tension_raw": "measured_tension",
    "external_tension": "external",
    "motor_position": "measured_position",
    "motor_torque_goal": "torque",
    "motor_temperature": "temperature",
}
"""Name of the state block's field for each telemetry field that has another name in the block."""


class TelemetryPlaces:
    """Places of the telemetry of a hand in the state block.

    Attributes:
        elements: (m,) index of each number of the telemetry in the state block.
        slices: slice of each field in the telemetry.
    """

    def __init__(self, layout: BlockLayout) -> None:
        """Compute the position of each number of the telemetry in the state block.

        Args:
            layout: layout of the state block.
        """
        # In the block below, the value of each element is the index of the element, so the view of
        # a field contains the indices of the field's elements.
        element_numbers = np.arange(layout.size, dtype=np.float64)
        element_indices_of_fields = [
            layout.view(element_numbers, STATE_FIELD_BY_TELEMETRY_FIELD.get(name, name))
            for name in TELEMETRY_FIELDS
        ]
        end_offsets = np.cumsum([0, *map(len, element_indices_of_fields)]).tolist()
        self.elements = np.concatenate(element_indices_of_fields).astype(np.int64)
        self.slices = TelemetrySlices(
            zip(TELEMETRY_FIELDS, map(slice, end_offsets[:-1], end_offsets[1:]), strict=True)
        )
