"""Keys of a ``[[motor]]`` section in the hand file that the drives use."""

from collections.abc import Mapping
from typing import Any, Protocol


class MotorDescription(Protocol):
    """A ``[[motor]]`` section. Attribute names are the keys of the file."""

    @property
    def name(self) -> str:
        """Return the name of the motor."""
        ...

    @property
    def protocol(self) -> str:
        """Return the name of the protocol."""
        ...

    @property
    def node_id(self) -> int:
        """Return the node number on the bus."""
        ...

    @property
    def position_range_rad(self) -> float:
        """Return the full scale of the position [rad]."""
        ...

    @property
    def velocity_range_rad_s(self) -> float:
        """Return the full scale of the velocity [rad/s]."""
        ...

    @property
    def torque_max_N_m(self) -> float:  # noqa: N802 - the file's key
        """Return the largest torque command [N m at the spool]."""
        ...

    @property
    def direction(self) -> int:
        """Return 1 if positive torque of the motor winds the tendon, else -1."""
        ...

    @property
    def zero_rad(self) -> float:
        """Return the motor angle of the spool's zero [rad]."""
        ...

    @property
    def watchdog_ms(self) -> float:
        """Return the watchdog time of the drive [ms]."""
        ...

    @property
    def options(self) -> Mapping[str, Any]:
        """Return the options of the protocol."""
        ...
