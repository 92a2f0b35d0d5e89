"""MIT mode on the wire: bytes <-> values at the output shaft, as Damiao motors speak it.

    command   position 16 | velocity 12 | kp 12 | kd 12 | torque 12
    feedback  state 4, node 4 | position 16 | velocity 12 | torque 12 | temperatures 8, 8

Both have 8 bytes, big-endian, the first field in the highest bits. Registers are little-endian. Register replies come
on the identifier of the feedback and are told apart here by their first four bytes: as feedback these would mean a
position within 0.3 % of -PMAX, where no hand works.
Source: Damiao DM-J4310-2EC manual; public clients for what the manual leaves open.
"""

import struct
from typing import NamedTuple

from handctl.drives.signals import Coding, Message, Quantity, Signal, Table

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


Feedback = tuple[int, float, float, float, float]
"""State nibble, position [rad], velocity [rad/s], torque [N m], hotter of two temperatures [degC]."""


def command_message(can_id: int, ranges: Ranges, sign: int = 1, flags: int = 0) -> Message:
    """Return the command with kp = kd = 0.

    Zero has no code in this format: 0 N m is sent as the code next to it, half a step (TMAX / 4095) away.

    Args:
        can_id: of the motor. ranges: of the motor; their torque, TMAX, is the limit. sign: of the torque.
        flags: of the frame.
    """
    unused = Quantity.UNUSED
    signals = (
        _spanning("position", unused, 7, 16, ranges.position, "rad"),
        _spanning("velocity", unused, 23, 12, ranges.velocity, "rad/s"),
        Signal("kp", unused, 27, 12, True, scale=500.0 / TOP, unit="N m/rad"),
        Signal("kd", unused, 47, 12, True, scale=5.0 / TOP, unit="N m s/rad"),
        _spanning("torque", Quantity.TORQUE, 51, 12, ranges.torque, "N m", sign),
    )
    return Message("command", can_id, 8, signals, flags, _NO_MOTION.to_bytes(8, "big"), False, ranges.torque)


def feedback_message(can_id: int, ranges: Ranges, sign: int = 1, zero: float = 0.0) -> Message:
    """Return the feedback.

    Args:
        can_id: of the answer. ranges: of the motor.
        sign: of position, velocity and torque. zero: position that is to read 0 [rad].
    """
    position = _spanning("position", Quantity.POSITION, 15, 16, ranges.position, "rad", sign)
    return Message("feedback", can_id, 8, (
        Signal("state", Quantity.STATUS, 7, 8, True),
        position._replace(offset=position.offset - sign * zero),
        _spanning("velocity", Quantity.VELOCITY, 31, 12, ranges.velocity, "rad/s", sign),
        _spanning("torque", Quantity.TORQUE, 35, 12, ranges.torque, "N m", sign),
        Signal("mosfet", Quantity.TEMPERATURE, 55, 8, True, unit="degC"),
        Signal("winding", Quantity.TEMPERATURE, 63, 8, True, unit="degC"),
    ))  # fmt: skip


def _spanning(
    name: str, quantity: Quantity, start: int, length: int, largest: float, unit: str, sign: int = 1
) -> Signal:
    """Return a signal whose codes span -largest to largest."""
    scale = sign * 2 * largest / ((1 << length) - 1)
    return Signal(name, quantity, start, length, True, Coding.UNSIGNED, scale, -sign * largest, unit)


def decode_feedback(data: bytes, table: Table) -> Feedback:
    """Return the values of 8 bytes of feedback; ``table``: of its message."""
    state, position, velocity, torque, mosfet, winding = table.unpack(data)
    return int(state) >> 4, position, velocity, torque, max(mosfet, winding)


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
