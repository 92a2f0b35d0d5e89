"""Parameters of a RobStride motor with required values.

Before arming, the host reads each parameter of the motor. If a parameter has a wrong value, the
host writes the parameter and reads it again.

The write of a parameter changes only the working memory of the motor. Frames of type 0x16 write the
flash, and handctl never sends a frame of type 0x16.
"""

import struct
from typing import NamedTuple

from handctl.drives.robstride import codec

WRITE_TRIES = 3
"""Largest number of writes per parameter.

The motor's answer to a write does not contain the value of the parameter, so the host reads each
written parameter back.
"""


class RequiredParameter(NamedTuple):
    """Parameter of a motor, with its required value.

    Attributes:
        name: name of the parameter in the manual.
        number: number of the parameter.
        coding: ``struct`` code of the parameter value: B, I or f.
        value: required value of the parameter.
    """

    name: str
    number: int
    coding: str
    value: float

    @property
    def raw(self) -> bytes:
        """Return the required value of the parameter as four bytes."""
        value = self.value if self.coding == "f" else int(self.value)
        return struct.pack(f"<{self.coding}", value).ljust(4, b"\0")

    def is_required_value(self, value_bytes: bytes) -> bool:
        """Return True if four received bytes contain the required value.

        If the parameter has fewer than four bytes, the remaining received bytes are ignored.
        """
        size = struct.calcsize(self.coding)
        return value_bytes[:size] == self.raw[:size]

    def value_text(self, value_bytes: bytes) -> str:
        """Return the parameter value in four received bytes as text."""
        return f"{struct.unpack_from(f'<{self.coding}', value_bytes)[0]:g}"


def required_parameters(torque: float, watchdog_ms: float) -> tuple[RequiredParameter, ...]:
    """Return the parameters of a motor, with the values required before arming.

    Args:
        torque: required torque limit [N m].
        watchdog_ms: required timeout of the watchdog [ms].
    """
    counts = round(watchdog_ms * codec.TIMEOUT_UNITS_PER_MS)
    return (
        RequiredParameter("run_mode", codec.RUN_MODE, "B", codec.OPERATION_RUN_MODE),
        RequiredParameter("limit_torque", codec.LIMIT_TORQUE, "f", torque),
        RequiredParameter("canTimeout", codec.CAN_TIMEOUT, "I", counts),
    )
