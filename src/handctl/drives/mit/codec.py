"""MIT mode on the wire: bytes <-> values at the output shaft, as Damiao motors speak it.

Commands and feedback have 8 bytes, packed big-endian with the first field in the highest bits; registers are
little-endian. Register replies come on the identifier of the feedback and are told apart here by their first four
bytes: as feedback these would mean a position within 0.3 % of -PMAX, where no hand works.
Source: Damiao DM-J4310-2EC manual; public clients for what the manual leaves open.
"""

import struct
from typing import NamedTuple

BROADCAST_ID = 0x7FF
ENABLE, DISABLE, CLEAR = 0xFC, 0xFD, 0xFB
READ, WRITE, SAVE, REFRESH = 0x33, 0x55, 0xAA, 0xCC
TIMEOUT, CTRL_MODE, SERIAL, PMAX, VMAX, TMAX = 9, 10, 15, 21, 22, 23
REGISTER_NAMES = {TIMEOUT: "TIMEOUT", CTRL_MODE: "CTRL_MODE", PMAX: "PMAX", VMAX: "VMAX", TMAX: "TMAX"}
_INTEGER = struct.Struct("<I")
_FLOAT = struct.Struct("<f")
_FORMATS = {TIMEOUT: _INTEGER, CTRL_MODE: _INTEGER, SERIAL: _INTEGER}
"""Of the registers that are not float32."""
MIT_MODE = 1
TIMEOUT_UNITS_PER_MS = 20
"""The watchdog counts in 50 us."""

DISABLED, ENABLED = 0, 1
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
"""State nibbles of the feedback that mean an error, and no torque."""

_unpack_feedback = struct.Struct(">BH5B").unpack
_REPLY = struct.Struct("<HBB")
POSITION_TOP, TOP = 2**16 - 1, 2**12 - 1
_NO_MOTION = POSITION_TOP // 2 << 48 | TOP // 2 << 36
"""Codes of a command's position and velocity, which act only through gains, and of gains 0."""


class Ranges(NamedTuple):
    """Full scale of registers PMAX, VMAX, TMAX: position [rad], velocity [rad/s], torque [N m]."""

    position: float
    velocity: float
    torque: float

    @property
    def position_step(self) -> float:
        """One count of the 16 bit position [rad]."""
        return 2 * self.position / 0xFFFF


Lines = tuple[float, float, float, float, float, float]
"""Slope and offset by which a code of position, of velocity and of torque becomes a value."""
Feedback = tuple[int, float, float, float, float]
"""State nibble, position [rad], velocity [rad/s], torque [N m], hotter of two temperatures [degC]."""


def encode_torque(torque: float, limit: float) -> bytes:
    """Payload of a command with kp = kd = 0.

    Zero has no code in this format: 0 N m is sent as the code next to it, half a step (limit / 4095) away.

    Args:
        torque: at the output shaft [N m].
        limit: TMAX [N m].

    Raises:
        ValueError: not finite, or beyond the limit.
    """
    if not abs(torque) <= limit:
        raise ValueError(f"torque {torque} N m, expected at most {limit:g}")
    code = round((torque + limit) * TOP / (2 * limit))
    return (_NO_MOTION | code).to_bytes(8, "big")


def lines(ranges: Ranges, sign: int = 1, zero: float = 0.0) -> Lines:
    """What makes values of the codes of a feedback.

    Args:
        ranges: of the motor.
        sign: of all three values.
        zero: position that is to read 0 [rad].
    """
    position, velocity, torque = (sign * most for most in ranges)
    return (
        2 * position / POSITION_TOP,
        -position - sign * zero,
        2 * velocity / TOP,
        -velocity,
        2 * torque / TOP,
        -torque,
    )


def decode_feedback(data: bytes, lines: Lines) -> Feedback:
    """Values of 8 bytes of feedback; ``lines`` are constant, and computed once."""
    head, position, high, middle, low, mosfet, winding = _unpack_feedback(data)
    position_slope, position_0, velocity_slope, velocity_0, torque_slope, torque_0 = lines
    return (
        head >> 4,
        position * position_slope + position_0,
        (high << 4 | middle >> 4) * velocity_slope + velocity_0,
        ((middle & 0xF) << 8 | low) * torque_slope + torque_0,
        float(mosfet if mosfet > winding else winding),
    )


def special(code: int) -> bytes:
    """Payload of ENABLE, DISABLE or CLEAR."""
    return b"\xff" * 7 + bytes((code,))


def register_request(node_id: int, operation: int, register: int = 0, value: float = 0.0) -> bytes:
    """Payload on BROADCAST_ID; the value counts for WRITE only.

    Args:
        node_id: ESC_ID.
        operation: READ, WRITE or REFRESH.
        register: number.
        value: to be written.
    """
    raw = register_bytes(register, value) if operation == WRITE else bytes(4)
    return struct.pack("<HBB", node_id, operation, register) + raw


def register_bytes(register: int, value: float) -> bytes:
    """A register's value as four bytes; an integer register takes the integer part."""
    layout = _FORMATS.get(register, _FLOAT)
    return layout.pack(int(value)) if layout is _INTEGER else layout.pack(value)


class RegisterReply(NamedTuple):
    """Operation, register and the four bytes of its value."""

    operation: int
    register: int
    raw: bytes

    @property
    def value(self) -> float:
        """The value as the register has it."""
        return float(_FORMATS.get(self.register, _FLOAT).unpack(self.raw)[0])


def register_reply(data: bytes, node_id: int) -> RegisterReply | None:
    """The register reply in 8 bytes from a motor; None if they are feedback."""
    if data[0] != node_id & 0xFF:  # nearly every feedback ends here: its first byte has the state above the identifier
        return None
    sender, operation, register = _REPLY.unpack_from(data)
    if sender != node_id or operation not in (READ, WRITE, SAVE):
        return None
    return RegisterReply(operation, register, data[4:])
