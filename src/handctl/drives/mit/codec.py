"""Conversion of the frames of Damiao motors between bytes and values at the output shaft.

Command with identifier ESC_ID, 8 bytes, big-endian, with the first field in the highest bits:

    bits    63..48             47..36             35..24            23..12          11..0
    field   position           velocity           kp                kd              torque
    range   +-PMAX rad         +-VMAX rad/s       0..500 N m/rad    0..5 N m s/rad  +-TMAX N m

Special command with identifier ESC_ID, 8 bytes. Seven bytes FF are followed by FC to enable, FD to
disable, or FB to clear an error.

Commands of the modes in which the motor controls its own position or velocity, little-endian. The
motor obeys each command only in the mode that the table gives for the command:

    identifier       mode                 bytes and fields
    0x100 + ESC_ID   position-velocity    0..3 position float32 [rad] | 4..7 speed limit float32 [rad/s]
    0x200 + ESC_ID   velocity             0..3 velocity float32 [rad/s]
    0x300 + ESC_ID   force-position       0..3 position float32 [rad] | 4..5 speed limit [0.01 rad/s]
                                          | 6..7 current limit [1/10000 of the largest]

Feedback with identifier MST_ID, 8 bytes, big-endian:

    byte    0                  1, 2          3, 4 high     4 low, 5      6              7
    field   state 4 | node 4   position 16   velocity 12   torque 12     MOSFET degC    winding degC
    range   see ERROR_TEXTS    +-PMAX rad    +-VMAX rad/s  +-TMAX N m    1 degC/count   1 degC/count

Register request with identifier 0x7FF, and register reply with identifier MST_ID, 8 bytes,
little-endian:

    byte    0, 1     2                                                3          4..7
    field   ESC_ID   33 read, 55 write, AA save, CC refresh           register   uint32 or float32

Register replies have the same identifier and length as feedback. This module distinguishes register
replies from feedback by the first four bytes. If feedback had the first four bytes of a register
reply, the position in the feedback would be within 0.3 % of -PMAX. No hand can reach a position so
close to -PMAX.

Source: Damiao DM-J4310-2EC manual. Details missing in the manual are from public client programs
(LeRobot, i2rt, openarm_can).
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.signals import CyclicMessage, Signal, SignalCoding, SignalQuantity, SignalTable

BROADCAST_ID = 0x7FF
"""Identifier of register requests to all motors.

The payload of a register request contains the node number of the motor.
"""
# Last payload byte of each special command.
ENABLE = 0xFC
DISABLE = 0xFD
CLEAR_ERROR = 0xFB
# Operations in a register request. REFRESH requests a feedback frame instead of a register.
READ = 0x33
WRITE = 0x55
SAVE = 0xAA
REFRESH = 0xCC
# Register numbers: ramps, largest speed, watchdog, mode, serial number, and full scale of position,
# velocity and torque.
ACCELERATION = 4
DECELERATION = 5
MAX_SPEED = 6
TIMEOUT = 9
CTRL_MODE = 10
SERIAL_NUMBER = 15
PMAX = 21
VMAX = 22
TMAX = 23
REGISTER_NAMES = {
    ACCELERATION: "ACC", DECELERATION: "DEC", MAX_SPEED: "MAX_SPD",
    TIMEOUT: "TIMEOUT", CTRL_MODE: "CTRL_MODE", PMAX: "PMAX", VMAX: "VMAX", TMAX: "TMAX",
}  # fmt: skip
"""Names of the registers in messages to the operator."""
_INTEGER_STRUCT = struct.Struct("<I")
_FLOAT_STRUCT = struct.Struct("<f")
_REGISTER_STRUCTS = {
    TIMEOUT: _INTEGER_STRUCT,
    CTRL_MODE: _INTEGER_STRUCT,
    SERIAL_NUMBER: _INTEGER_STRUCT,
}
"""Registers with an unsigned integer. All registers that are not in this table contain a float32."""
MIT_MODE = 1
"""Value of register CTRL_MODE for MIT mode."""
POSITION_MODE = 2
"""Value of register CTRL_MODE for position-velocity mode."""
VELOCITY_MODE = 3
"""Value of register CTRL_MODE for velocity mode."""
FORCE_MODE = 4
"""Value of register CTRL_MODE for force-position mode."""
CODES_PER_RAD_S = 100.0
"""Number of counts per rad/s in the speed limit of a force-position command."""
FULL_SCALE_COUNT = 10_000
"""Largest count of the speed limit and of the current limit in a force-position command."""
TIMEOUT_UNITS_PER_MS = 20
"""Number of counts per millisecond in register TIMEOUT, the watchdog. One count of the register is 50 us."""

# Values of the state nibble for a motor without an error.
DISABLED = 0
ENABLED = 1
ERROR_TEXTS = {
    0x5: "sensor error",
    0x6: "parameter error",
    0x8: "over-voltage",
    0x9: "under-voltage",
    0xA: "over-current",
    0xB: "MOSFET too hot",
    0xC: "winding too hot",
    0xD: "communication lost: the drive's watchdog fired",
    0xE: "overload",
}
"""Text of each error, by the state nibble of the feedback. A motor with a listed error makes no torque."""

_REPLY_STRUCT = struct.Struct("<HBB")
"""First bytes of a register reply: node number, operation, register."""
# Largest counts in the 16-bit field and in the 12-bit fields of a frame.
MAX_POSITION_COUNT = 2**16 - 1
MAX_12_BIT_COUNT = 2**12 - 1
KP_MAX = 500.0
"""Full scale of the gain kp in a command [N m/rad]."""
KD_MAX = 5.0
"""Full scale of the gain kd in a command [N m s/rad]."""
_ZERO_MOTION_BITS = MAX_POSITION_COUNT // 2 << 48 | MAX_12_BIT_COUNT // 2 << 36
"""Payload of a command in which position, velocity, and gains are 0.

The motor multiplies position and velocity errors by the gains, so that gains of 0 cancel both.
"""


class MotorRanges(NamedTuple):
    """Full scale of a motor: position [rad], velocity [rad/s], torque [N m].

    The three values are the contents of the registers PMAX, VMAX and TMAX of the motor.
    """

    position: float
    velocity: float
    torque: float

    @property
    def position_step(self) -> float:
        """Return the change of the position per count of the 16-bit position field [rad]."""
        return 2 * self.position / 0xFFFF


FeedbackValues = tuple[int, float, float, float, float]
"""Values in feedback: state nibble, position [rad], velocity [rad/s], torque [N m], higher temperature [degC]."""


def command_message(
    can_id: int, ranges: MotorRanges, direction: int = 1, flags: int = 0
) -> CyclicMessage:
    """Return the signal table of the torque command, which has kp = kd = 0.

    The torque field cannot represent exactly zero torque. For 0 N m, the host sends the nearest
    count, whose torque differs from zero by half a count (TMAX / 4095).

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of position, velocity and torque of the motor. TMAX is the torque limit.
        direction: 1 if positive torque of the motor winds the tendon, else -1.
        flags: flags of the frame, see ``frame``.
    """
    unused_signal = SignalQuantity.UNUSED
    signals = (
        _signal_over_range("position", unused_signal, 7, 16, ranges.position, "rad"),
        _signal_over_range("velocity", unused_signal, 23, 12, ranges.velocity, "rad/s"),
        Signal("kp", unused_signal, 27, 12, True, scale=KP_MAX / MAX_12_BIT_COUNT, unit="N m/rad"),
        Signal(
            "kd", unused_signal, 47, 12, True, scale=KD_MAX / MAX_12_BIT_COUNT, unit="N m s/rad"
        ),
        _signal_over_range(
            "torque", SignalQuantity.TORQUE, 51, 12, ranges.torque, "N m", direction
        ),
    )
    return CyclicMessage(
        "command",
        can_id,
        8,
        signals,
        flags,
        _ZERO_MOTION_BITS.to_bytes(8, "big"),
        False,
        ranges.torque,
    )


def impedance_message(
    can_id: int,
    ranges: MotorRanges,
    direction: int = 1,
    zero: float = 0.0,
    flags: int = 0,
    gains: tuple[float, float] = (KP_MAX, KD_MAX),
) -> CyclicMessage:
    """Return the signal table of the position command, see ``signals.POSITION_COMMAND``.

    The position command contains position, velocity, kp, kd and torque.

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of position, velocity and torque of the motor. TMAX is the torque limit.
        direction: 1 if positive torque of the motor winds the tendon, else -1. The position and the
            velocity have the same sign as the torque.
        zero: angle of the motor when the spool angle is zero [rad].
        flags: flags of the frame.
        gains: full scale of the gains kp [N m/rad] and kd [N m s/rad].
    """
    kp, kd = gains
    position = _signal_over_range(
        "position", SignalQuantity.POSITION, 7, 16, ranges.position, "rad", direction
    )
    signals = (
        position._replace(offset=position.offset - direction * zero),
        _signal_over_range(
            "velocity", SignalQuantity.VELOCITY, 23, 12, ranges.velocity, "rad/s", direction
        ),
        Signal(
            "kp",
            SignalQuantity.STIFFNESS,
            27,
            12,
            True,
            scale=kp / MAX_12_BIT_COUNT,
            unit="N m/rad",
        ),
        Signal(
            "kd",
            SignalQuantity.DAMPING,
            47,
            12,
            True,
            scale=kd / MAX_12_BIT_COUNT,
            unit="N m s/rad",
        ),
        _signal_over_range(
            "torque", SignalQuantity.TORQUE, 51, 12, ranges.torque, "N m", direction
        ),
    )
    return CyclicMessage(
        "position_command", can_id, 8, signals, flags, bytes(8), False, ranges.torque
    )


def position_message(
    can_id: int, ranges: MotorRanges, speed: float, direction: int, zero: float, flags: int
) -> CyclicMessage:
    """Return the signal table of the command in position-velocity mode, which has a constant speed limit.

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of position, velocity and torque of the motor. PMAX is the largest
            position command.
        speed: speed limit [rad/s].
        direction: 1 if a positive position of the motor winds the tendon, else -1.
        zero: angle of the motor when the spool angle is zero [rad].
        flags: flags of the frame.
    """
    signals = (
        _float_signal("position", SignalQuantity.POSITION, 0, "rad", direction, -direction * zero),
        _float_signal("speed", SignalQuantity.UNUSED, 4, "rad/s"),
    )
    base = struct.pack("<ff", 0.0, speed)
    return CyclicMessage(
        "position_velocity", 0x100 + can_id, 8, signals, flags, base, limit=ranges.position
    )


def velocity_message(can_id: int, limit: float, direction: int, flags: int) -> CyclicMessage:
    """Return the signal table of the command in velocity mode.

    Args:
        can_id: identifier of the motor, ESC_ID.
        limit: largest speed in a command [rad/s].
        direction: 1 if a positive velocity of the motor winds the tendon, else -1.
        flags: flags of the frame.
    """
    signal = _float_signal("velocity", SignalQuantity.VELOCITY, 0, "rad/s", direction)
    return CyclicMessage("velocity", 0x200 + can_id, 4, (signal,), flags, bytes(4), limit=limit)


def force_position_message(
    can_id: int,
    ranges: MotorRanges,
    limits: tuple[float, float],
    direction: int,
    zero: float,
    flags: int,
) -> CyclicMessage:
    """Return the signal table of the command in force-position mode, which has constant limits.

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of position, velocity and torque of the motor. PMAX is the largest
            position command.
        limits: speed limit [rad/s], and current limit as a fraction of the largest current of the
            motor.
        direction: 1 if a positive position of the motor winds the tendon, else -1.
        zero: angle of the motor when the spool angle is zero [rad].
        flags: flags of the frame.

    Raises:
        ValueError: a limit is too small or too large for the command.
    """
    speed, fraction = limits
    codes = math.floor(speed * CODES_PER_RAD_S), math.floor(fraction * FULL_SCALE_COUNT)
    if not all(0 < code <= FULL_SCALE_COUNT for code in codes):
        raise ValueError(
            f"no code for speed {speed:g} rad/s and current {fraction:g}, expected at most 100 and 1"
        )
    signals = (
        _float_signal("position", SignalQuantity.POSITION, 0, "rad", direction, -direction * zero),
        Signal("speed", SignalQuantity.UNUSED, 32, 16, scale=1.0 / CODES_PER_RAD_S, unit="rad/s"),
        Signal("current", SignalQuantity.UNUSED, 48, 16, scale=1.0 / FULL_SCALE_COUNT),
    )
    base = struct.pack("<fHH", 0.0, *codes)
    return CyclicMessage(
        "force_position", 0x300 + can_id, 8, signals, flags, base, limit=ranges.position
    )


def _float_signal(
    name: str,
    quantity: SignalQuantity,
    byte_offset: int,
    unit: str,
    scale: float = 1.0,
    offset: float = 0.0,
) -> Signal:
    """Return the description of a float32 signal that begins at byte ``byte_offset``."""
    return Signal(
        name, quantity, 8 * byte_offset, 32, False, SignalCoding.FLOAT, scale, offset, unit
    )


def feedback_message(
    can_id: int, ranges: MotorRanges, direction: int = 1, zero: float = 0.0
) -> CyclicMessage:
    """Return the signal table of the feedback frame.

    Args:
        can_id: identifier of the feedback, MST_ID.
        ranges: full scale of position, velocity and torque of the motor.
        direction: 1 if positive torque of the motor winds the tendon, else -1. The position and the
            velocity have the same sign as the torque.
        zero: angle of the motor when the spool angle is zero [rad].
    """
    position = _signal_over_range(
        "position", SignalQuantity.POSITION, 15, 16, ranges.position, "rad", direction
    )
    return CyclicMessage("feedback", can_id, 8, (
        # The nibbles of state and node form one status byte, so that one comparison checks both.
        Signal("state", SignalQuantity.STATUS, 7, 8, True),
        # The spool angle is sign * (motor angle - zero).
        position._replace(offset=position.offset - direction * zero),
        _signal_over_range("velocity", SignalQuantity.VELOCITY, 31, 12, ranges.velocity, "rad/s", direction),
        _signal_over_range("torque", SignalQuantity.TORQUE, 35, 12, ranges.torque, "N m", direction),
        Signal("mosfet", SignalQuantity.TEMPERATURE, 55, 8, True, unit="degC"),
        Signal("winding", SignalQuantity.TEMPERATURE, 63, 8, True, unit="degC"),
    ))  # fmt: skip


def _signal_over_range(
    name: str,
    quantity: SignalQuantity,
    start: int,
    bit_count: int,
    largest: float,
    unit: str,
    direction: int = 1,
) -> Signal:
    """Return the description of a signal with values from -largest to largest."""
    # The highest count means +largest, so the range consists of 2^n - 1 steps of one count. A
    # negative sign of the direction reverses scale and offset.
    scale = direction * 2 * largest / ((1 << bit_count) - 1)
    return Signal(
        name,
        quantity,
        start,
        bit_count,
        True,
        SignalCoding.UNSIGNED,
        scale,
        -direction * largest,
        unit,
    )


def decode_feedback(data: bytes, table: SignalTable) -> FeedbackValues:
    """Decode the 8 bytes of a feedback frame.

    Args:
        data: payload of the frame.
        table: signal table of the feedback frame.
    """
    state, position, velocity, torque, mosfet_temperature, winding_temperature = table.unpack(data)
    return int(state) >> 4, position, velocity, torque, max(mosfet_temperature, winding_temperature)


def special_command(command_code: int) -> bytes:
    """Return the payload of a special command: ENABLE, DISABLE, or CLEAR_ERROR."""
    return b"\xff" * 7 + bytes((command_code,))


def register_request(
    node_id: int, operation_code: int, register: int = 0, value: float = 0.0
) -> bytes:
    """Return the payload of a register request. The identifier of the request is BROADCAST_ID.

    Args:
        node_id: node number of the motor, ESC_ID.
        operation_code: READ, WRITE or REFRESH.
        register: number of the register.
        value: value to write. The value has no effect in operations other than WRITE.
    """
    raw_bytes = register_bytes(register, value) if operation_code == WRITE else bytes(4)
    return struct.pack("<HBB", node_id, operation_code, register) + raw_bytes


def register_bytes(register: int, value: float) -> bytes:
    """Return the value of a register as four bytes.

    The value for an integer register is truncated to a whole number.
    """
    layout = _REGISTER_STRUCTS.get(register, _FLOAT_STRUCT)
    return layout.pack(int(value)) if layout is _INTEGER_STRUCT else layout.pack(value)


def register_reply(node_id: int, operation_code: int, register: int, value: float) -> bytes:
    """Return the payload of a motor's answer to a register request, see ``register_request``."""
    return struct.pack("<HBB", node_id, operation_code, register) + register_bytes(register, value)


class RegisterReply(NamedTuple):
    """Reply of a motor to a register request: operation, register number, and the four bytes of the register value."""

    operation: int
    register: int
    raw: bytes

    @property
    def value(self) -> float:
        """Decode the four bytes of the register value by the type of the register."""
        return float(_REGISTER_STRUCTS.get(self.register, _FLOAT_STRUCT).unpack(self.raw)[0])


def decode_register_reply(data: bytes, node_id: int) -> RegisterReply | None:
    """Decode 8 bytes from a motor as a register reply, or return None if they are feedback."""
    # In nearly every feedback frame, the state nibble makes byte 0 differ from the node number. The
    # fast test of byte 0 precedes the other tests.
    if data[0] != node_id & 0xFF:  # in byte 0 of feedback, the high bits are the state nibble
        return None
    sender, operation, register = _REPLY_STRUCT.unpack_from(data)
    if sender != node_id or operation not in (READ, WRITE, SAVE):
        return None
    return RegisterReply(operation, register, data[4:])
