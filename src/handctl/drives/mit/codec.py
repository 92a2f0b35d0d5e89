"""Frames of Damiao's MIT mode: bytes <-> values at the output shaft.

Command, identifier ESC_ID, 8 bytes, big-endian, the first field in the highest bits:

    bits    63..48             47..36             35..24            23..12          11..0
    field   position           velocity           kp                kd              torque
    range   +-PMAX rad         +-VMAX rad/s       0..500 N m/rad    0..5 N m s/rad  +-TMAX N m

Special command, identifier ESC_ID, 8 bytes: FF FF FF FF FF FF FF, then FC enable, FD disable,
FB clear error.

Commands of the motor's own modes, each followed only in its mode, little-endian:

    identifier       mode                 bytes and fields
    0x100 + ESC_ID   position-velocity    0..3 position float32 [rad] | 4..7 speed limit float32 [rad/s]
    0x200 + ESC_ID   velocity             0..3 velocity float32 [rad/s]
    0x300 + ESC_ID   force-position       0..3 position float32 [rad] | 4..5 speed limit [0.01 rad/s]
                                          | 6..7 current limit [1/10000 of the largest]

Feedback, identifier MST_ID, 8 bytes, big-endian:

    byte    0                  1, 2          3, 4 high     4 low, 5      6              7
    field   state 4 | node 4   position 16   velocity 12   torque 12     MOSFET degC    winding degC
    range   see ERRORS         +-PMAX rad    +-VMAX rad/s  +-TMAX N m    1 degC/count   1 degC/count

Register request, identifier 0x7FF, and register reply, identifier MST_ID, 8 bytes, little-endian:

    byte    0, 1     2                                                3          4..7
    field   ESC_ID   33 read, 55 write, AA save, CC refresh           register   uint32 or float32

Register replies share identifier and length with feedback. Here they are distinguished by the first
four bytes. Feedback with the same four bytes would mean a position within 0.3 % of -PMAX, outside
the travel of any hand.

Source: Damiao DM-J4310-2EC manual. Details that the manual lacks are from public clients (LeRobot,
i2rt, openarm_can).
"""

import math
import struct
from typing import NamedTuple

from handctl.drives.signals import Coding, Message, Quantity, Signal, Table

BROADCAST_ID = 0x7FF
"""Identifier of register frames. The node number of the motor is in the payload."""
# Last byte of the special commands.
ENABLE = 0xFC
DISABLE = 0xFD
CLEAR = 0xFB
# Operations on registers. REFRESH requests a feedback frame.
READ = 0x33
WRITE = 0x55
SAVE = 0xAA
REFRESH = 0xCC
# Register numbers: watchdog, mode, serial number, and full scale of position, velocity, torque.
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
"""Register names in messages."""
_INTEGER = struct.Struct("<I")
_FLOAT = struct.Struct("<f")
_FORMATS = {TIMEOUT: _INTEGER, CTRL_MODE: _INTEGER, SERIAL_NUMBER: _INTEGER}
"""Registers with an unsigned integer. All other registers are float32."""
MIT_MODE = 1
"""Value of CTRL_MODE for MIT mode."""
POSITION_MODE = 2
"""Value of CTRL_MODE for position-velocity mode."""
VELOCITY_MODE = 3
"""Value of CTRL_MODE for velocity mode."""
FORCE_MODE = 4
"""Value of CTRL_MODE for force-position mode."""
SPEED_CODES = 100.0
"""Codes per rad/s of the speed limit in force-position mode."""
FULL_SCALE_COUNT = 10_000
"""Largest code of speed and current limit in force-position mode."""
TIMEOUT_UNITS_PER_MS = 20
"""Watchdog counts per millisecond. One count is 50 us."""

# State nibbles of a motor without an error.
DISABLED = 0
ENABLED = 1
ERRORS = {
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
"""Error text by state nibble. A motor with one of these errors makes no torque."""

_REPLY = struct.Struct("<HBB")
"""First bytes of a register reply: node number, operation, register."""
# Largest codes of the 16 bit and the 12 bit fields.
MAX_POSITION_COUNT = 2**16 - 1
MAX_COUNT = 2**12 - 1
KP_MAX = 500.0
"""Full scale of kp [N m/rad]."""
KD_MAX = 5.0
"""Full scale of kd [N m s/rad]."""
_NO_MOTION = MAX_POSITION_COUNT // 2 << 48 | MAX_COUNT // 2 << 36
"""Payload of a command with position, velocity, and gains 0.

Position and velocity act only through the gains.
"""


class Ranges(NamedTuple):
    """Full scale of registers PMAX, VMAX, TMAX: position [rad], velocity [rad/s], torque [N m]."""

    position: float
    velocity: float
    torque: float

    @property
    def position_step(self) -> float:
        """Return the position step of one count of the 16-bit field [rad]."""
        return 2 * self.position / 0xFFFF


Feedback = tuple[int, float, float, float, float]
"""Feedback: state nibble, position [rad], velocity [rad/s], torque [N m], higher of two temperatures [degC]."""


def command_message(can_id: int, ranges: Ranges, sign: int = 1, flags: int = 0) -> Message:
    """Return the signal table of the command with kp = kd = 0.

    Zero torque has no code in this format. 0 N m is sent as the nearest code, half a step
    (TMAX / 4095) away.

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of the motor. TMAX is the torque limit.
        sign: sign of the torque, 1 if positive torque winds.
        flags: flags of the frame.
    """
    unused = Quantity.UNUSED
    signals = (
        _signal_over_range("position", unused, 7, 16, ranges.position, "rad"),
        _signal_over_range("velocity", unused, 23, 12, ranges.velocity, "rad/s"),
        Signal("kp", unused, 27, 12, True, scale=KP_MAX / MAX_COUNT, unit="N m/rad"),
        Signal("kd", unused, 47, 12, True, scale=KD_MAX / MAX_COUNT, unit="N m s/rad"),
        _signal_over_range("torque", Quantity.TORQUE, 51, 12, ranges.torque, "N m", sign),
    )
    return Message("command", can_id, 8, signals, flags, _NO_MOTION.to_bytes(8, "big"), False, ranges.torque)


def impedance_message(
    can_id: int,
    ranges: Ranges,
    sign: int = 1,
    zero: float = 0.0,
    flags: int = 0,
    gains: tuple[float, float] = (KP_MAX, KD_MAX),
) -> Message:
    """Return the command with position, velocity, kp, kd and torque, see ``signals.POSITION_COMMAND``.

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of the motor. TMAX is the torque limit.
        sign: sign of position, velocity and torque, 1 if positive torque winds.
        zero: motor angle of the spool's zero [rad].
        flags: flags of the frame.
        gains: full scale of kp [N m/rad] and kd [N m s/rad].
    """
    kp, kd = gains
    position = _signal_over_range(
        "position", Quantity.POSITION, 7, 16, ranges.position, "rad", sign
    )
    signals = (
        position._replace(offset=position.offset - sign * zero),
        _signal_over_range("velocity", Quantity.VELOCITY, 23, 12, ranges.velocity, "rad/s", sign),
        Signal("kp", Quantity.STIFFNESS, 27, 12, True, scale=kp / MAX_COUNT, unit="N m/rad"),
        Signal("kd", Quantity.DAMPING, 47, 12, True, scale=kd / MAX_COUNT, unit="N m s/rad"),
        _signal_over_range("torque", Quantity.TORQUE, 51, 12, ranges.torque, "N m", sign),
    )
    return Message("position_command", can_id, 8, signals, flags, bytes(8), False, ranges.torque)


def position_message(can_id: int, ranges: Ranges, speed: float, sign: int, zero: float, flags: int) -> Message:
    """Return the command of position-velocity mode, with a constant speed limit.

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of the motor. PMAX is the largest position.
        speed: speed limit [rad/s].
        sign: sign of the position, 1 if a positive position winds.
        zero: motor angle of the spool's zero [rad].
        flags: flags of the frame.
    """
    signals = (
        _float_signal("position", Quantity.POSITION, 0, "rad", sign, -sign * zero),
        _float_signal("speed", Quantity.UNUSED, 4, "rad/s"),
    )
    base = struct.pack("<ff", 0.0, speed)
    return Message("position_velocity", 0x100 + can_id, 8, signals, flags, base, limit=ranges.position)


def velocity_message(can_id: int, limit: float, sign: int, flags: int) -> Message:
    """Return the command of velocity mode.

    Args:
        can_id: identifier of the motor, ESC_ID.
        limit: largest speed [rad/s].
        sign: sign of the velocity, 1 if a positive velocity winds.
        flags: flags of the frame.
    """
    signal = _float_signal("velocity", Quantity.VELOCITY, 0, "rad/s", sign)
    return Message("velocity", 0x200 + can_id, 4, (signal,), flags, bytes(4), limit=limit)


def force_position_message(
    can_id: int, ranges: Ranges, limits: tuple[float, float], sign: int, zero: float, flags: int
) -> Message:
    """Return the command of force-position mode, with constant limits.

    Args:
        can_id: identifier of the motor, ESC_ID.
        ranges: full scale of the motor. PMAX is the largest position.
        limits: speed limit [rad/s], and current limit as a fraction of the largest current.
        sign: sign of the position, 1 if a positive position winds.
        zero: motor angle of the spool's zero [rad].
        flags: flags of the frame.

    Raises:
        ValueError: a limit has no code.
    """
    speed, fraction = limits
    codes = math.floor(speed * SPEED_CODES), math.floor(fraction * FULL_SCALE_COUNT)
    if not all(0 < code <= FULL_SCALE_COUNT for code in codes):
        raise ValueError(f"no code for speed {speed:g} rad/s and current {fraction:g}, expected at most 100 and 1")
    signals = (
        _float_signal("position", Quantity.POSITION, 0, "rad", sign, -sign * zero),
        Signal("speed", Quantity.UNUSED, 32, 16, scale=1.0 / SPEED_CODES, unit="rad/s"),
        Signal("current", Quantity.UNUSED, 48, 16, scale=1.0 / FULL_SCALE_COUNT),
    )
    base = struct.pack("<fHH", 0.0, *codes)
    return Message("force_position", 0x300 + can_id, 8, signals, flags, base, limit=ranges.position)


def _float_signal(
    name: str, quantity: Quantity, first: int, unit: str, scale: float = 1.0, offset: float = 0.0
) -> Signal:
    """Return a float32 signal that begins at a byte."""
    return Signal(name, quantity, 8 * first, 32, False, Coding.FLOAT, scale, offset, unit)


def feedback_message(can_id: int, ranges: Ranges, sign: int = 1, zero: float = 0.0) -> Message:
    """Return the signal table of the feedback.

    Args:
        can_id: identifier of the feedback, MST_ID.
        ranges: full scale of the motor.
        sign: sign of position, velocity, and torque, 1 if positive torque winds.
        zero: motor angle of the spool's zero [rad].
    """
    position = _signal_over_range("position", Quantity.POSITION, 15, 16, ranges.position, "rad", sign)
    return Message("feedback", can_id, 8, (
        # State and node nibbles form one status byte, so that one comparison checks both.
        Signal("state", Quantity.STATUS, 7, 8, True),
        # Spool angle = sign * (motor angle - zero).
        position._replace(offset=position.offset - sign * zero),
        _signal_over_range("velocity", Quantity.VELOCITY, 31, 12, ranges.velocity, "rad/s", sign),
        _signal_over_range("torque", Quantity.TORQUE, 35, 12, ranges.torque, "N m", sign),
        Signal("mosfet", Quantity.TEMPERATURE, 55, 8, True, unit="degC"),
        Signal("winding", Quantity.TEMPERATURE, 63, 8, True, unit="degC"),
    ))  # fmt: skip


def _signal_over_range(
    name: str, quantity: Quantity, start: int, length: int, largest: float, unit: str, sign: int = 1
) -> Signal:
    """Return a signal whose range of codes covers the values from -largest to largest."""
    # The top code is +largest, hence 2^n - 1 steps. A negative sign reverses scale and offset.
    scale = sign * 2 * largest / ((1 << length) - 1)
    return Signal(name, quantity, start, length, True, Coding.UNSIGNED, scale, -sign * largest, unit)


def decode_feedback(data: bytes, table: Table) -> Feedback:
    """Decode 8 bytes of feedback.

    Args:
        data: payload.
        table: signal table of the feedback.
    """
    state, position, velocity, torque, mosfet, winding = table.unpack(data)
    return int(state) >> 4, position, velocity, torque, max(mosfet, winding)


def special_command(code: int) -> bytes:
    """Return the payload of a special command: ENABLE, DISABLE, or CLEAR."""
    return b"\xff" * 7 + bytes((code,))


def register_request(node_id: int, operation: int, register: int = 0, value: float = 0.0) -> bytes:
    """Return the payload of a register request. Register requests use the identifier BROADCAST_ID.

    Args:
        node_id: ESC_ID.
        operation: READ, WRITE or REFRESH.
        register: number of the register.
        value: value for WRITE, ignored by the other operations.
    """
    raw = register_bytes(register, value) if operation == WRITE else bytes(4)
    return struct.pack("<HBB", node_id, operation, register) + raw


def register_bytes(register: int, value: float) -> bytes:
    """Return a register value as four bytes. For an integer register the fraction is cut off."""
    layout = _FORMATS.get(register, _FLOAT)
    return layout.pack(int(value)) if layout is _INTEGER else layout.pack(value)


class RegisterReply(NamedTuple):
    """Register reply: operation, register, and the four bytes of the value."""

    operation: int
    register: int
    raw: bytes

    @property
    def value(self) -> float:
        """Return the value decoded with the type of the register."""
        return float(_FORMATS.get(self.register, _FLOAT).unpack(self.raw)[0])


def decode_register_reply(data: bytes, node_id: int) -> RegisterReply | None:
    """Decode 8 bytes as a register reply of the motor, or return None if they are feedback."""
    # Fast path: in nearly every feedback the state nibble makes byte 0 differ from the node number.
    if data[0] != node_id & 0xFF:  # nearly every feedback ends here: its first byte has the state above the identifier
        return None
    sender, operation, register = _REPLY.unpack_from(data)
    if sender != node_id or operation not in (READ, WRITE, SAVE):
        return None
    return RegisterReply(operation, register, data[4:])
