"""Parameters of a RobStride motor required before arming: read, written if wrong, and read again.

A write changes the working memory alone. The flash is written by type 0x16, which handctl never sends.
"""

import struct
from typing import NamedTuple

from handctl.drives.robstride import codec

WRITE_TRIES = 3
"""Number of writes per parameter. The motor answers a write without the value, so each write is read back."""


class RequiredParameter(NamedTuple):
    """Parameter with its required value.

    Attributes:
        name: name in the manual.
        number: number of the parameter.
        coding: ``struct`` code of the value: B, I or f.
        value: required value.
    """

    name: str
    number: int
    coding: str
    value: float

    @property
    def raw(self) -> bytes:
        """Return the required value as four bytes."""
        value = self.value if self.coding == "f" else int(self.value)
        return struct.pack(f"<{self.coding}", value).ljust(4, b"\0")

    def is_right(self, raw: bytes) -> bool:
        """Return True if four bytes are the required value. Bytes after a shorter value are ignored."""
        size = struct.calcsize(self.coding)
        return raw[:size] == self.raw[:size]

    def shown(self, raw: bytes) -> str:
        """Return the value in four bytes as text."""
        return f"{struct.unpack_from(f'<{self.coding}', raw)[0]:g}"


def required_parameters(torque: float, watchdog_ms: float) -> tuple[RequiredParameter, ...]:
    """Return the parameters required before arming.

    Args:
        torque: torque limit [N m].
        watchdog_ms: watchdog [ms].
    """
    counts = round(watchdog_ms * codec.TIMEOUT_UNITS_PER_MS)
    return (
        RequiredParameter("run_mode", codec.RUN_MODE, "B", codec.OPERATION),
        RequiredParameter("limit_torque", codec.LIMIT_TORQUE, "f", torque),
        RequiredParameter("canTimeout", codec.CAN_TIMEOUT, "I", counts),
    )
