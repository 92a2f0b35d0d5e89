"""List of drive protocols, and interface of a ``[[motor]]`` section in the hand file.

``PROTOCOL_TRAITS`` is the list of drive protocols. The module ``protocol_registry`` adds the code
of each protocol. Help texts use only ``PROTOCOL_TRAITS``, because the import of
``protocol_registry`` would delay the output of a help text.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from handctl.errors import ConfigError


class ProtocolTraits(NamedTuple):
    """Properties of a drive protocol that are known without an import of its code.

    Attributes:
        title: name of the protocol in documents.
        is_verifiable: True if the drives have a watchdog, and limits that can be read back. The
            fault campaign accepts only protocols with ``is_verifiable``.
        can_fd: True if the bus of the drives needs CAN FD.
        options: values of the drive options in a simulated hand.
        torque_option: drive option without which the drives report no torque. The text is empty if
            the drives always report their torque.
        position_option: drive option with which the drives close the position loop of a digit. The
            text is empty if the drives need no option for the position loop.
        no_position_loop_reason: reason why the drives close no position loop. The text is empty if
            the drives close a position loop.
        hint: advice about a drive option that no frame can verify, and that does not belong to a
            protection. Commands print the advice with ``--verbose``.
        motor_types: values of the required option ``motor_type``, empty if the drives have no such
            option.
    """

    title: str
    is_verifiable: bool = True
    can_fd: bool = False
    options: Mapping[str, Any] = {}
    torque_option: str = ""
    position_option: str = ""
    no_position_loop_reason: str = ""
    hint: str = ""
    motor_types: tuple[str, ...] = ()

    @property
    def has_separate_torque_frame(self) -> bool:
        """Return True if the reply to a command contains no torque.

        A drive whose reply contains no torque reports its torque in a separate frame, and only with
        ``torque_option``.
        """
        return bool(self.torque_option)


PROTOCOL_TRAITS: dict[str, ProtocolTraits] = {
    "mit": ProtocolTraits("MIT"),
    "odrive": ProtocolTraits("ODrive", options={
        "endpoint_enable_watchdog": 201, "endpoint_watchdog_timeout": 202,
        "endpoint_torque_max": 203, "endpoint_torque_min": 204,
    }, torque_option="torque_feedback",
    no_position_loop_reason="Set_Input_Pos of an ODrive contains no gains, and torque commands need another mode"),
    "cia402": ProtocolTraits(
        "CiA 402", options={"rated_torque_N_m": 0.4, "counts_per_turn": 65536},
        no_position_loop_reason="CiA 402 standardises no gains of position loops, "
        "and torque commands need another mode",
    ),
    "moteus": ProtocolTraits("moteus", can_fd=True, position_option='control = "position"'),
    "robstride": ProtocolTraits(
        "RobStride", options={"motor_type": "rs05"},
        motor_types=("rs00", "rs01", "rs02", "rs03", "rs04", "rs05"),
    ),
    "cubemars": ProtocolTraits(
        "CubeMars", is_verifiable=False, options={"motor_type": "ak80-6"},
        hint="temperature counts from -40 degC by the manual; "
        "a cold motor that reads below zero needs temperature_offset_C = 0",
        motor_types=("ak60-6", "ak70-10", "ak80-6", "ak80-9", "ak10-9"),
    ),
    "robstride_mit": ProtocolTraits(
        "RobStride in MIT mode", is_verifiable=False, options={"motor_type": "rs05"},
        motor_types=("rs00", "rs01", "rs05"),
    ),
}  # fmt: skip
"""Properties of each protocol, by the name of the protocol in the hand file."""
VERIFIABLE_PROTOCOLS = tuple(
    name for name, traits in PROTOCOL_TRAITS.items() if traits.is_verifiable
)
"""Names of the protocols with protections that can be verified, see ``ProtocolTraits.is_verifiable``."""


def motor_types_text() -> str:
    """Return a text that lists the motor types of each protocol that requires the option ``motor_type``."""
    return "; ".join(
        f"{name}: {', '.join(protocol_traits.motor_types)}"
        for name, protocol_traits in PROTOCOL_TRAITS.items()
        if protocol_traits.motor_types
    )


def check_protocol_given(protocol: str | None, motor_type: str | None) -> None:
    """Check that an operator who has chosen a motor type has also chosen a protocol.

    Raises:
        ConfigError: the operator has chosen a motor type, but no protocol.
    """
    if motor_type is not None and protocol is None:
        raise ConfigError(motor_type, "--motor-type", "--protocol with it")


def options_with_motor_type(protocol: str, motor_type: str | None) -> dict[str, Any]:
    """Return the drive options of a protocol, including the motor type that the operator has chosen.

    Args:
        protocol: name of the protocol.
        motor_type: chosen motor type, None for the motor type in ``ProtocolTraits.options``.

    Raises:
        ConfigError: the protocol has no motor type with the given name.
    """
    protocol_traits = PROTOCOL_TRAITS[protocol]
    if motor_type is None:
        return dict(protocol_traits.options)
    if motor_type not in protocol_traits.motor_types:
        expected = (
            f"one of {', '.join(protocol_traits.motor_types)}"
            if protocol_traits.motor_types
            else "no motor type"
        )
        raise ConfigError(f"{motor_type!r} with {protocol}", "--motor-type", expected)
    return {**protocol_traits.options, "motor_type": motor_type}


def position_loop_protocols_text() -> str:
    """Return a text that lists the protocols with a position loop in the drive.

    For each protocol, the text names the option that the position loop requires, if there is one.
    """
    names = [
        f"{name} with {protocol_traits.position_option}"
        if protocol_traits.position_option
        else name
        for name, protocol_traits in PROTOCOL_TRAITS.items()
        if not protocol_traits.no_position_loop_reason
    ]
    return f"{', '.join(names[:-1])} or {names[-1]}"


class MotorDescription(Protocol):
    """A ``[[motor]]`` section of the hand file.

    The attributes have the names of the keys in the hand file.
    """

    @property
    def name(self) -> str:
        """Return the name of the motor."""
        ...

    @property
    def protocol(self) -> str:
        """Return the name of the drive's protocol."""
        ...

    @property
    def node_id(self) -> int:
        """Return the node number of the drive on its bus."""
        ...

    @property
    def position_range_rad(self) -> float:
        """Return the full scale of the position of the drive [rad]."""
        ...

    @property
    def velocity_range_rad_s(self) -> float:
        """Return the full scale of the velocity of the drive [rad/s]."""
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
        """Return the motor angle at spool angle zero [rad]."""
        ...

    @property
    def watchdog_ms(self) -> float:
        """Return the timeout of the drive's watchdog [ms]."""
        ...

    @property
    def options(self) -> Mapping[str, Any]:
        """Return the values of the protocol-specific options of the motor."""
        ...

    @property
    def closes_position_loop(self) -> bool:
        """Return True if the drive closes the position loop of a moving digit."""
        ...

    @property
    def kp_N_m_per_rad(self) -> float | None:  # noqa: N802 - the file's key
        """Return the stiffness of the drive's position loop [N m/rad], None if the hand file does not contain it."""
        ...

    @property
    def kd_N_m_s_per_rad(self) -> float | None:  # noqa: N802 - the file's key
        """Return the damping of the drive's position loop [N m s/rad], None if the hand file does not contain it."""
        ...
