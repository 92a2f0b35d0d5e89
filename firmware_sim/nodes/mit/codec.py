"""MIT frames of Damiao motors. Source: fact sheet mit_damiao.

Command to ESC_ID (8 bytes, highest byte and bit first):

    bit 63..48  position   16 bit, -PMAX..PMAX [rad]
    bit 47..36  velocity   12 bit, -VMAX..VMAX [rad/s]
    bit 35..24  kp         12 bit, 0..500 [N m/rad]
    bit 23..12  kd         12 bit, 0..5 [N m s/rad]
    bit 11..0   torque     12 bit, -TMAX..TMAX [N m]

Feedback from MST_ID (8 bytes, highest byte and bit first):

    bit 63..60  state or error nibble
    bit 59..56  low four bits of ESC_ID
    bit 55..40  position   16 bit, -PMAX..PMAX [rad]
    bit 39..28  velocity   12 bit, -VMAX..VMAX [rad/s]
    bit 27..16  torque     12 bit, -TMAX..TMAX [N m]
    bit 15..8   temperature of the MOSFETs [degC]
    bit  7..0   temperature of the winding [degC]

Kernels handle the eight bytes of a payload as one signed 64-bit integer. The sign of the integer
has no meaning. Callers that want compiled kernels must call the kernels through this module,
because ``compiled.use_compiled_kernels`` replaces the attributes of the module.
"""

import ctypes
import struct
from typing import Any, NamedTuple

from firmware_sim.compiled import compiled, kernel_helper
from firmware_sim.nodes.drive_temperatures import ThermalStruct

PAYLOAD_WORD_STRUCT = struct.Struct(">q")
"""Conversion between the eight bytes of a payload and a 64-bit integer."""
KP_MAX = 500.0
"""Maximum of kp in a command [N m/rad]."""
KD_MAX = 5.0
"""Maximum of kd in a command [N m s/rad]."""
ENABLED_STATE = 0x1
"""State nibble in the feedback of an enabled drive."""
THERMAL_PERIOD_NS = 100_000_000
"""Period of the update of the drive's temperatures [ns]."""


class MitRanges(NamedTuple):
    """Symmetric ranges of the values in frames, from registers 21, 22 and 23.

    Attributes:
        position: largest position, register PMAX [rad].
        velocity: largest velocity, register VMAX [rad/s].
        torque: largest torque, register TMAX [N m].
    """

    position: float
    velocity: float
    torque: float


class MitStruct(ctypes.Structure):
    """Memory layout of the state of a simulated drive, for compiled kernels. See ``node.MitNode``.

    ``motor_number`` is the index of the drive's rotor in the array of rotors.
    """

    _fields_ = [
        *((name, ctypes.c_double) for name in ("offset", "direction")),
        *((name, ctypes.c_double) for name in ("position_range", "velocity_range", "torque_range")),
        *(
            (name, ctypes.c_int64)
            for name in ("state", "node_id", "reply_id", "motor_number", "mode")
        ),
        *(
            (name, ctypes.c_int64)
            for name in ("watchdog_fed_ns", "wake_ns", "thermal_ns", "timeout_ns")
        ),
        ("temperatures", ThermalStruct),
    ]


class MitCommand(NamedTuple):
    """MIT command, with all values referred to the output shaft of the gear.

    Attributes:
        position: position setpoint [rad].
        velocity: velocity setpoint [rad/s].
        kp: stiffness towards the position setpoint [N m/rad].
        kd: damping towards the velocity setpoint [N m s/rad].
        torque: feedforward torque [N m].
    """

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


@compiled("real", "real", "count")
def value_to_code(value: float, limit: float, bits: int) -> int:
    """Encode a value as an integer code.

    The value is limited to -limit..limit, and the code is truncated in the same way as in the
    firmware.
    """
    clamped_value = -limit if value < -limit else limit if value > limit else value
    # The operations are in the same order as in the firmware, because another order would give
    # other rounding errors.
    return int((clamped_value + limit) * ((1 << bits) - 1) / (2.0 * limit))


@compiled("count", "real", "count")
def code_to_value(code: int, limit: float, bits: int) -> float:
    """Decode an integer code into a value between -limit and limit."""
    return code * (2.0 * limit) / ((1 << bits) - 1) - limit


@compiled("count", "real", "real", "real")
def read_command(
    command_word: int, position: float, velocity: float, torque: float
) -> tuple[float, ...]:
    """Decode an MIT command.

    Args:
        command_word: payload of the command as an integer.
        position: position range [rad].
        velocity: velocity range [rad/s].
        torque: torque range [N m].

    Returns:
        The fields of ``MitCommand``.
    """
    return (
        code_to_value(command_word >> 48 & 0xFFFF, position, 16),
        code_to_value(command_word >> 36 & 0xFFF, velocity, 12),
        (command_word >> 24 & 0xFFF) * KP_MAX / 4095.0,
        (command_word >> 12 & 0xFFF) * KD_MAX / 4095.0,
        code_to_value(command_word & 0xFFF, torque, 12),
    )


@compiled("real")
def _degrees(value: float) -> int:
    """Return a temperature [degC] as one byte, limited to the range from 0 to 255."""
    return 0 if value < 0.0 else 255 if value > 255.0 else int(value)


@compiled("count", *("real",) * 8)
def write_feedback(
    state_and_id_byte: int, p: float, v: float, t: float, position: float, velocity: float, torque: float,
    mosfet_temperature: float, winding_temperature: float,
) -> int:  # fmt: skip
    """Encode the feedback of an MIT drive.

    Args:
        state_and_id_byte: one byte with the state or error nibble and the low four bits of ESC_ID.
        p: measured position [rad], limited to the range of the motor type.
        v: measured velocity [rad/s], limited to the range of the motor type.
        t: measured torque [N m], limited to the range of the motor type.
        position: position range, register 21 [rad].
        velocity: velocity range, register 22 [rad/s].
        torque: torque range, register 23 [N m].
        mosfet_temperature: temperature of the MOSFETs [degC].
        winding_temperature: temperature of the winding [degC].

    Returns:
        Payload of the feedback as an integer.
    """
    motion = (
        value_to_code(p, position, 16) << 24
        | value_to_code(v, velocity, 12) << 12
        | value_to_code(t, torque, 12)
    )
    # The code first converts the most significant byte to a signed byte. In compiled code, the
    # shift of an unsigned byte above 127 would overflow 64 bits.
    signed_byte = state_and_id_byte - 256 if state_and_id_byte > 127 else state_and_id_byte
    return (
        signed_byte << 56
        | motion << 16
        | _degrees(mosfet_temperature) << 8
        | _degrees(winding_temperature)
    )


@kernel_helper
def apply_command(node: Any, servo: Any, command_word: int) -> None:
    """Apply an MIT command to the servo of an enabled drive.

    Args:
        node: simulated drive, as an array row or as a Python object.
        servo: servo of the drive's rotor.
        command_word: payload of the command as an integer.
    """
    ranges = node.position_range, node.velocity_range, node.torque_range
    position, velocity, servo.kp, servo.kd, torque = read_command(command_word, *ranges)
    # To convert an angle in a frame to a spool angle, subtract the encoder offset, and then apply
    # the direction of the motor.
    servo.position = node.direction * (position - node.offset)
    servo.velocity = node.direction * velocity
    servo.torque = node.direction * torque


@kernel_helper
def feedback_word(
    node: Any, rotor: Any, angle: float, mosfet_temperature: float, winding_temperature: float
) -> int:
    """Encode the present feedback of a drive.

    Args:
        node: simulated drive, as an array row or as a Python object.
        rotor: rotor of the drive.
        angle: spool angle that the encoder measures [rad].
        mosfet_temperature: temperature of the MOSFETs [degC].
        winding_temperature: temperature of the winding [degC].

    Returns:
        Payload of the feedback as an integer.
    """
    sign = node.direction
    first_byte = node.state << 4 | node.node_id & 0xF
    p = sign * angle + node.offset
    v = sign * rotor.velocity
    t = sign * rotor.torque
    ranges = node.position_range, node.velocity_range, node.torque_range
    return write_feedback(first_byte, p, v, t, *ranges, mosfet_temperature, winding_temperature)


@kernel_helper
def schedule_wake(node: Any) -> None:
    """Schedule the next wake of a drive.

    The next wake is the next update of the temperatures, or an earlier time if the watchdog must be
    checked.
    """
    node.wake_ns = node.thermal_ns + THERMAL_PERIOD_NS
    if node.timeout_ns != 0 and node.state == ENABLED_STATE:
        node.wake_ns = min(node.wake_ns, node.watchdog_fed_ns + node.timeout_ns)


def decode_command(data: bytes, ranges: MitRanges) -> MitCommand:
    """Decode an MIT command of 8 bytes."""
    return MitCommand(*read_command(PAYLOAD_WORD_STRUCT.unpack(data)[0], *ranges))


def encode_feedback(
    state: int,
    node_id: int,
    motion: tuple[float, float, float],
    ranges: MitRanges,
    temperatures: tuple[float, float],
) -> bytes:
    """Encode feedback into 8 bytes. The function ``write_feedback`` explains the layout."""
    return PAYLOAD_WORD_STRUCT.pack(
        write_feedback(state << 4 | node_id & 0xF, *motion, *ranges, *temperatures)
    )
