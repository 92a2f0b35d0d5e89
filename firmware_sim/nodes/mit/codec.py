"""MIT frames as Damiao motors speak them: bytes <-> values. Source: facts, mit_damiao.

Eight bytes are one number here, the first byte highest; its sign means nothing. Whoever wants these laws compiled, if
they are, calls them through the module.
"""

import ctypes
import struct
from typing import Any, NamedTuple

from firmware_sim.compiled import compiled, inner
from firmware_sim.nodes.thermal import ThermalRow

WORD = struct.Struct(">q")
"""Bytes of a frame <-> number."""
KP_MAX, KD_MAX = 500.0, 5.0
"""Ranges of the gains [N m/rad], [N m s/rad]."""
ENABLED = 0x1
"""State nibble of a drive that follows commands."""
WARM_PERIOD_NS = 100_000_000


class Ranges(NamedTuple):
    """The symmetric ranges of registers 21, 22, 23: position [rad], velocity [rad/s], torque [N m]."""

    position: float
    velocity: float
    torque: float


class MitRow(ctypes.Structure):
    """See ``node.MitNode``; ``motor_number``: of its rotor."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("offset", "direction")),
        *((name, ctypes.c_double) for name in ("position_range", "velocity_range", "torque_range")),
        *((name, ctypes.c_int64) for name in ("state", "node_id", "reply_id", "motor_number")),
        *((name, ctypes.c_int64) for name in ("fed_ns", "wake_ns", "warmed_ns", "timeout_ns")),
        ("temperatures", ThermalRow),
    ]


class Command(NamedTuple):
    """An MIT command at the output shaft: [rad], [rad/s], [N m/rad], [N m s/rad], [N m]."""

    position: float
    velocity: float
    kp: float
    kd: float
    torque: float


@compiled("real", "real", "count")
def to_code(value: float, limit: float, bits: int) -> int:
    """Return the code of a value in -limit .. limit: clamped, then truncated as the firmware does."""
    clamped = -limit if value < -limit else limit if value > limit else value
    return int((clamped + limit) * ((1 << bits) - 1) / (2.0 * limit))


@compiled("count", "real", "count")
def from_code(code: int, limit: float, bits: int) -> float:
    """Return the value of a code over -limit .. limit."""
    return code * (2.0 * limit) / ((1 << bits) - 1) - limit


@compiled("count", "real", "real", "real")
def read_command(word: int, position: float, velocity: float, torque: float) -> tuple[float, ...]:
    """Return the fields of ``Command`` in a word, given the ranges; the first field is in the highest bits."""
    return (
        from_code(word >> 48 & 0xFFFF, position, 16),
        from_code(word >> 36 & 0xFFF, velocity, 12),
        (word >> 24 & 0xFFF) * KP_MAX / 4095.0,
        (word >> 12 & 0xFFF) * KD_MAX / 4095.0,
        from_code(word & 0xFFF, torque, 12),
    )


@compiled("real")
def _degrees(value: float) -> int:
    """Return a temperature as a byte, saturated."""
    return 0 if value < 0.0 else 255 if value > 255.0 else int(value)


@compiled("count", *("real",) * 8)
def write_feedback(
    head: int, p: float, v: float, t: float, position: float, velocity: float, torque: float,
    mosfet: float, winding: float,
) -> int:  # fmt: skip
    """Return a word of feedback.

    Args:
        head: state or error nibble, and ESC_ID, of which four bits travel, as one byte.
        p, v, t: position [rad], velocity [rad/s], torque [N m]; beyond the ranges they saturate.
        position, velocity, torque: the ranges of registers 21 to 23.
        mosfet, winding: temperatures [degC].
    """
    motion = to_code(p, position, 16) << 24 | to_code(v, velocity, 12) << 12 | to_code(t, torque, 12)
    signed = head - 256 if head > 127 else head
    return signed << 56 | motion << 16 | _degrees(mosfet) << 8 | _degrees(winding)


@inner
def obey(node: Any, servo: Any, word: int) -> None:
    """Let the servo of an enabled drive follow the command in a word.

    Args:
        node: the drive, a row or an object. servo: of its rotor. word: the command.
    """
    ranges = node.position_range, node.velocity_range, node.torque_range
    position, velocity, servo.kp, servo.kd, torque = read_command(word, *ranges)
    servo.position, servo.velocity = node.direction * (position - node.offset), node.direction * velocity
    servo.torque = node.direction * torque


@inner
def feedback_word(node: Any, rotor: Any, angle: float, mosfet: float, winding: float) -> int:
    """Return the feedback of a drive at this moment as a word.

    Args:
        node: the drive, a row or an object. rotor: its rotor. angle: of the spool by the encoder [rad].
        mosfet, winding: temperatures [degC].
    """
    sign, head = node.direction, node.state << 4 | node.node_id & 0xF
    p, v, t = sign * angle + node.offset, sign * rotor.velocity, sign * rotor.torque
    ranges = node.position_range, node.velocity_range, node.torque_range
    return write_feedback(head, p, v, t, *ranges, mosfet, winding)


@inner
def schedule(node: Any) -> None:
    """Note when time must pass for a drive next: for its temperatures, or for its watchdog while it is enabled."""
    node.wake_ns = node.warmed_ns + WARM_PERIOD_NS
    if node.timeout_ns != 0 and node.state == ENABLED:
        node.wake_ns = min(node.wake_ns, node.fed_ns + node.timeout_ns)


def decode_command(data: bytes, ranges: Ranges) -> Command:
    """Return the command in 8 bytes."""
    return Command(*read_command(WORD.unpack(data)[0], *ranges))


def encode_feedback(
    state: int, node_id: int, motion: tuple[float, float, float], ranges: Ranges, temperatures: tuple[float, float]
) -> bytes:
    """Return 8 bytes of feedback; see ``write_feedback``."""
    return WORD.pack(write_feedback(state << 4 | node_id & 0xF, *motion, *ranges, *temperatures))
