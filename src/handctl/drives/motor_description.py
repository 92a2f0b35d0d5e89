"""List of protocols, and the keys of a ``[[motor]]`` section in the hand file that the drives use.

``PROTOCOLS`` is the list of protocols. ``registry`` adds the code of each protocol. Its import
would take too long for a help text.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol


class ProtocolTraits(NamedTuple):
    """Properties of a protocol that are known without its code.

    Attributes:
        title: name in documents.
        guarded: True if the drives have a watchdog and limits that are read back. The fault
            campaign and the option ``--protocol`` of a simulated hand take guarded protocols only.
        can_fd: True if the bus needs CAN FD.
        options: drive options of a simulated hand.
    """

    title: str
    guarded: bool = True
    can_fd: bool = False
    options: Mapping[str, Any] = {}


PROTOCOLS: dict[str, ProtocolTraits] = {
    "mit": ProtocolTraits("MIT"),
    "odrive": ProtocolTraits("ODrive", options={
        "endpoint_enable_watchdog": 201, "endpoint_watchdog_timeout": 202,
        "endpoint_torque_max": 203, "endpoint_torque_min": 204,
    }),
    "cia402": ProtocolTraits("CiA 402", options={"rated_torque_N_m": 0.4, "counts_per_turn": 65536}),
    "moteus": ProtocolTraits("moteus", can_fd=True),
    "robstride": ProtocolTraits("RobStride", options={"motor_type": "rs05"}),
    "cubemars": ProtocolTraits("CubeMars", guarded=False, options={"motor_type": "ak80-6"}),
    "robstride_mit": ProtocolTraits("RobStride in MIT mode", guarded=False, options={"motor_type": "rs05"}),
}  # fmt: skip
"""Protocols by their name in the hand file."""
GUARDED = tuple(name for name, traits in PROTOCOLS.items() if traits.guarded)
"""Names of the guarded protocols, see ``Protocol.guarded``."""


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
