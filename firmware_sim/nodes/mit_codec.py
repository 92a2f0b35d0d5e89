"""MIT frames as Damiao motors speak them: bytes <-> values. Source: facts, mit_damiao."""

import struct
from typing import NamedTuple

_FEEDBACK = struct.Struct(">BH5B")
KP_MAX, KD_MAX = 500.0, 5.0
"""Ranges of the gains [N m/rad], [N m s/rad]."""


class Ranges(NamedTuple):
    """The symmetric ranges of registers 21, 22, 23: position [rad], velocity [rad/s], torque [N m]."""

    position: float
    velocity: float
    torque: float


class Command(NamedTuple):
    """An MIT command at the output shaft: [rad], [rad/s], [N m/rad], [N m s/rad], [N m]."""

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


def to_code(value: float, limit: float, bits: int) -> int:
    """Return the code of a value in -limit .. limit: clamped, then truncated as the firmware does."""
    clamped = -limit if value < -limit else limit if value > limit else value
    return int((clamped + limit) * ((1 << bits) - 1) / (2.0 * limit))


def from_code(code: int, limit: float, bits: int) -> float:
    """Return the value of a code over -limit .. limit."""
    return code * (2.0 * limit) / ((1 << bits) - 1) - limit


def decode_command(data: bytes, ranges: Ranges) -> Command:
    """Return the command in 8 bytes; the first field is in the highest bits."""
    word = int.from_bytes(data, "big")
    position, velocity, torque = ranges
    return Command(
        from_code(word >> 48, position, 16),
        from_code(word >> 36 & 0xFFF, velocity, 12),
        (word >> 24 & 0xFFF) * KP_MAX / 4095.0,
        (word >> 12 & 0xFFF) * KD_MAX / 4095.0,
        from_code(word & 0xFFF, torque, 12),
    )


def encode_feedback(
    state: int, node_id: int, motion: tuple[float, float, float], ranges: Ranges, temperatures: tuple[float, float]
) -> bytes:
    """Return 8 bytes of feedback.

    Args:
        state: state or error nibble.
        node_id: ESC_ID, of which four bits travel.
        motion: position [rad], velocity [rad/s], torque [N m]; beyond the ranges they saturate.
        ranges: of registers 21 to 23.
        temperatures: of MOSFET and winding [degC].
    """
    p = to_code(motion[0], ranges.position, 16)
    v = to_code(motion[1], ranges.velocity, 12)
    t = to_code(motion[2], ranges.torque, 12)
    mosfet, winding = temperatures
    return _FEEDBACK.pack(
        state << 4 | node_id & 0xF, p, v >> 4, (v & 0xF) << 4 | t >> 8, t & 0xFF, _degrees(mosfet), _degrees(winding)
    )


def _degrees(value: float) -> int:
    """Return a temperature as a byte, saturated."""
    return 0 if value < 0.0 else 255 if value > 255.0 else int(value)
