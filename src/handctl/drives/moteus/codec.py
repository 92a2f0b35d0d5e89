"""Conversion of the frames of the moteus register protocol between bytes and values. All numbers are little-endian.

The identifier of a request always has 29 bits. The identifier of a reply has 11 bits if it is below
0x800, else 29 bits:

    bits    28..16         15                14..8           7..0
    request prefix (0)     1 reply wanted    source (host)   destination (node)
    reply   prefix (0)     0                 source (node)   destination (host)

A payload is a sequence of subframes. Unused bytes at the end of a payload have the value 0x50 (no
operation). The field type of a subframe is 0 for int8 values, 1 for int16, 2 for int32, and 3 for
float32. The lowest two bits of the first byte of a subframe contain the number of values, if the
number of values is 1 to 3. A larger number of values is a varuint after the first byte:

    00 | type << 2 | count    register (varuint), values          write
    10 | type << 2 | count    register (varuint)                  read
    20 | type << 2 | count    register (varuint), values          reply
    30, 31                    register, error (varuints)          write refused, read refused
    40, 41                    channel, length, text               text to the drive, text from it
    42                        channel, longest length             request for text

Torque command of a tick, 48 bytes:

    byte    0..2            3, 4    5..8      9..12                     13..16
    field   mode: 01 00 0A  0D 22   torque    02 20 80 00               02 23 00 00
            position mode           float32   position NaN, velocity 0  kp and kd scale 0
    byte    17..19          20, 21  22..25        26, 27  28..31         32..39, then padding
    field   01 2B 00        0D 25   limit         0D 27   watchdog [s]   query
            integrator 0            float32 N m           float32

Command of a tick in which the drive closes the position loop, 48 bytes:

    byte    0..2            3, 4    5..16                          17, 18  19..30
    field   mode: 01 00 0A  0F 20   position, velocity, torque     0F 23   kp scale, kd scale, limit
            position mode           float32 turn, turn/s, N m              float32 1, 1, N m
    byte    31..33          34, 35  36..39         40..47
    field   01 2B 00        0D 27   watchdog [s]   query
            integrator 0            float32

Feedback, the reply to the query, 24 bytes:

    byte    0, 1, 2         3..6                         7, 8    9..20                           21..23
    field   21 00 mode      22 0E temperature, fault     2F 01   position, velocity, torque      21 0A temperature
                            int8 degC                            float32 turn, turn/s, N m       motor, int8 degC

Source: docs/facts/moteus.md.
"""

import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from handctl.drives.frame import BRS, EXTENDED_FLAG, FDF
from handctl.drives.frame_time import FD_SIZES
from handctl.drives.signals import CyclicMessage, Signal, SignalCoding, SignalQuantity

FD_FRAME_FLAGS = FDF | BRS
"""CAN FD flags of all frames to the drive."""
REPLY_REQUESTED_BIT = 0x8000
"""Bit in the identifier of a request. If the bit is set, the drive sends a reply."""
STANDARD_IDS = 0x800
"""Number of possible identifiers with 11 bits. Identifiers from this number on have 29 bits."""
LAST_NODE_ID = 0x7E
"""Largest node number of a drive. The number 0x7F addresses all drives."""
BROADCAST = 0x7F
"""Node number that addresses a request to all drives."""
SOURCE_NODES = range(0x80)
"""Possible source numbers of hosts. The source number of handctl is 0."""
NOP = 0x50
"""Byte that fills the rest of a payload (no operation)."""
FLOAT32_STEP = 2.0**-23
"""Relative resolution of a number in the format float32."""
MAX_TURNS = 256.0
"""Largest commanded position [turn].

Up to 256 turns, a float32 has the resolution of the drive's position error, 1/65536 turn.
"""

# Register numbers: registers of commands, then registers of the drive's identity. A register number
# beyond 0x7F takes two bytes as a varuint.
MODE = 0x000
COMMANDED_POSITION = 0x020
KP_SCALE = 0x023
MOTOR_TEMPERATURE = 0x00A
TEMPERATURE = 0x00E
FAULT = 0x00F
MAX_TORQUE = 0x025
TIMEOUT = 0x027
INTEGRATOR_SCALE = 0x02B
FIRMWARE_VERSION = 0x101
SERIAL_NUMBER = 0x120

# Numbers of the modes in which the drive makes no torque: stopped, fault.
STOPPED = 0
FAULT_MODE = 1
PREPARING_MODES = (2, 3, 4)
"""Modes through which the drive goes from stopped to position mode."""
POSITION = 10
"""Position mode. A torque command selects position mode with gains 0."""
TIMED_OUT = 11
"""Mode of a drive whose watchdog has fired. The drive leaves the mode TIMED_OUT only after a stop command."""
FAULT_TEXTS = {
    32: "calibration fault",
    33: "motor driver fault",
    34: "over-voltage",
    35: "encoder fault",
    36: "motor not configured",
    37: "PWM cycle overrun",
    38: "over-temperature",
    39: "outside the position limits",
    40: "under-voltage",
    41: "configuration changed while enabled",
    42: "no valid commutation encoder",
    43: "no valid output encoder",
    44: "gate driver cannot be enabled",
    45: "stop position is not supported",
    46: "timing violation",
    47: "back-EMF feedforward without acceleration limit",
    48: "invalid position limits",
}
"""Text of each fault code in mode 1 (fault)."""

WRITE, READ, REPLY = 0x00, 0x10, 0x20
"""First bytes of register subframes: write, read, and reply."""
INT8, INT16, INT32, FLOAT = range(4)
"""Types of the values of registers."""
WRITE_REFUSED, READ_REFUSED = 0x30, 0x31
"""First bytes of subframes that report a refused write or read.

In the subframe, register number and error number follow the first byte.
"""
TEXT_IN, TEXT_OUT, TEXT_POLL = 0x40, 0x41, 0x42
"""First bytes of text subframes: text to the drive, text from the drive, request for text."""
DIAGNOSTIC_CHANNEL = 1
"""Number of the text channel for the diagnostic protocol."""
MAX_TEXT_BYTES = 48
"""Longest text in one reply of the drive [bytes]."""
_VALUE_STRUCTS = tuple(struct.Struct(f"<{letter}") for letter in "bhif")
"""``struct`` code of each type of register value."""

QUERY_SUBFRAMES = bytes(
    (
        READ | 1,
        MODE,
        READ | 2,
        TEMPERATURE,
        READ | FLOAT << 2 | 3,
        0x01,
        READ | 1,
        MOTOR_TEMPERATURE,
    )
)
"""Payload bytes (subframes) that request feedback from the drive."""
FEEDBACK_LENGTH = 24
"""Length of a feedback frame [bytes]."""
STATUS_HEADERS = ((0, b"\x21"), (3, b"\x22"), (7, b"\x2f\x01"), (21, b"\x21\x0a"))
"""Byte offset and value of the bytes that are the same in every feedback of an enabled drive without a fault."""


def request_id(node_id: int, source_node: int = 0) -> int:
    """Return the identifier of a request from a source to a node."""
    return EXTENDED_FLAG | REPLY_REQUESTED_BIT | source_node << 8 | node_id


def reply_id(node_id: int, source_node: int = 0) -> int:
    """Return the identifier of a node's reply to a request from a source."""
    number = node_id << 8 | source_node
    return number if number < STANDARD_IDS else number | EXTENDED_FLAG


def padded_payload(payload: bytes) -> bytes:
    """Return a payload padded to the next payload length of CAN FD."""
    return payload.ljust(next(size for size in FD_SIZES if size >= len(payload)), bytes((NOP,)))


def write_floats_subframe(first_register: int, *values: float) -> bytes:
    """Return a subframe that writes up to three consecutive registers as float32."""
    subframe_start = bytes((WRITE | FLOAT << 2 | len(values), first_register))
    return subframe_start + struct.pack(f"<{len(values)}f", *values)


def write_bytes_subframe(first_register: int, *values: int) -> bytes:
    """Return a subframe that writes up to three consecutive registers as int8. The value -128 means NaN."""
    return struct.pack(f"<BB{len(values)}b", WRITE | len(values), first_register, *values)


def read_subframe(value_type: int, register: int) -> bytes:
    """Return the subframe to read a register as a value of the given type."""
    return bytes((READ | value_type << 2 | 1,)) + encode_varuint(register)


def encode_varuint(value: int) -> bytes:
    """Return a number as varuint, in groups of seven bits with the lowest group first."""
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*encoded, value))


def limits_subframes(torque: float, timeout_s: float) -> bytes:
    """Return the subframes that set the torque limit [N m] and the watchdog timeout [s] of the drive."""
    return write_floats_subframe(MAX_TORQUE, torque) + write_floats_subframe(TIMEOUT, timeout_s)


STOP_PAYLOAD = padded_payload(write_bytes_subframe(MODE, STOPPED) + QUERY_SUBFRAMES)
"""Payload of the stop command, which also requests feedback."""


def limits_request(torque: float, timeout_s: float) -> bytes:
    """Return the payload that writes torque limit and watchdog timeout into the command registers.

    The written limits have no effect until a command sets the mode of the drive. The payload also
    writes the register ``INTEGRATOR_SCALE``. A drive whose firmware does not have this register
    refuses the request, so the host detects the missing register before the first torque command.
    """
    return padded_payload(
        limits_subframes(torque, timeout_s)
        + write_bytes_subframe(INTEGRATOR_SCALE, 0)
        + QUERY_SUBFRAMES
    )


def text_request(text: bytes) -> bytes:
    """Return the payload that sends a text to the diagnostic channel."""
    return padded_payload(bytes((TEXT_IN, DIAGNOSTIC_CHANNEL, len(text))) + text)


TEXT_REQUEST = padded_payload(bytes((TEXT_POLL, DIAGNOSTIC_CHANNEL, MAX_TEXT_BYTES)))
"""Payload to request text from the diagnostic channel."""


def command_message(
    node_id: int, torque: float, timeout_s: float, direction: int = 1
) -> CyclicMessage:
    """Return the signal table of the torque command.

    The torque command selects position mode with gains 0 and a feedforward torque.

    Args:
        node_id: node number of the drive.
        torque: torque limit that both host and drive apply [N m].
        timeout_s: timeout of the watchdog [s].
        direction: 1 if positive torque of the motor winds the tendon, else -1.
    """
    no_motion_subframes = (
        write_bytes_subframe(0x020, -128, 0)
        + write_bytes_subframe(0x023, 0, 0)
        + write_bytes_subframe(INTEGRATOR_SCALE, 0)
    )
    base = (
        write_bytes_subframe(MODE, POSITION)
        + write_floats_subframe(0x022, 0.0)
        + no_motion_subframes
        + limits_subframes(torque, timeout_s)
        + QUERY_SUBFRAMES
    )
    signals = (
        _float_signal("torque", SignalQuantity.TORQUE, 5, float(direction), "N m"),
        _float_signal("torque_limit", SignalQuantity.UNUSED, 22, 1.0, "N m"),
        _float_signal("watchdog", SignalQuantity.UNUSED, 28, 1.0, "s"),
    )
    base = padded_payload(base)
    return CyclicMessage(
        "command", request_id(node_id), len(base), signals, FD_FRAME_FLAGS, base, False, torque
    )


class PositionGains(NamedTuple):
    """Gains of the position loop in the drive, which are the configuration items ``servo.pid_position``.

    Attributes:
        kp: stiffness [N m/turn].
        kd: damping [N m s/turn].
    """

    kp: float
    kd: float


def position_message(
    torque: CyclicMessage,
    gains: PositionGains,
    timeout_s: float,
    top_speed: float,
    direction: int = 1,
    zero: float = 0.0,
) -> CyclicMessage:
    """Return the signal table of the position command, see ``signals.POSITION_COMMAND``.

    The position command contains position, velocity, kp, kd, torque and torque limit. The frame of
    the command contains kp and kd as fractions of the drive's gains. Between two position commands,
    the drive changes the commanded position at the commanded velocity.

    Args:
        torque: signal table of the torque command to the same drive.
        gains: gains of the drive's position loop.
        timeout_s: timeout of the watchdog [s].
        top_speed: largest velocity command [rad/s].
        direction: 1 if positive torque of the motor winds the tendon, else -1. The position and the
            velocity have the same sign as the torque.
        zero: angle of the motor when the spool angle is zero [rad].
    """
    base = (
        write_bytes_subframe(MODE, POSITION)
        + write_floats_subframe(COMMANDED_POSITION, 0.0, 0.0, 0.0)
        + write_floats_subframe(KP_SCALE, 0.0, 0.0, 0.0)
        + write_bytes_subframe(INTEGRATOR_SCALE, 0)
        + write_floats_subframe(TIMEOUT, timeout_s)
        + QUERY_SUBFRAMES
    )
    turns = direction * math.tau
    position = _float_signal("position", SignalQuantity.POSITION, 5, turns, "rad")
    velocity = _float_signal("velocity", SignalQuantity.VELOCITY, 9, turns, "rad/s")
    # If a gain of the drive is 0, the commanded fraction of the gain is 0, whatever the scale of
    # the fraction.
    kp = _float_signal("kp", SignalQuantity.STIFFNESS, 19, gains.kp / math.tau or 1.0, "N m/rad")
    kd = _float_signal("kd", SignalQuantity.DAMPING, 23, gains.kd / math.tau or 1.0, "N m s/rad")
    limit = _float_signal("limit", SignalQuantity.TORQUE_LIMIT, 27, 1.0, "N m")
    signals = (
        position._replace(offset=-direction * zero, largest=MAX_TURNS),
        velocity._replace(largest=top_speed / math.tau),
        kp._replace(largest=1.0),
        kd._replace(largest=1.0),
        _float_signal("torque", SignalQuantity.TORQUE, 13, float(direction), "N m"),
        limit._replace(largest=torque.limit * (1.0 + FLOAT32_STEP)),
        _float_signal("watchdog", SignalQuantity.UNUSED, 36, 1.0, "s"),
    )
    return torque._replace(name="position_command", signals=signals, base_payload=base)


def feedback_message(node_id: int, direction: int = 1, zero: float = 0.0) -> CyclicMessage:
    """Return the signal table of the feedback frame.

    Args:
        node_id: node number of the drive.
        direction: 1 if positive torque of the motor winds the tendon, else -1. The position and the
            velocity have the same sign as the torque.
        zero: angle of the motor when the spool angle is zero [rad].
    """
    turns = direction * math.tau
    position = _float_signal("position", SignalQuantity.POSITION, 9, turns, "rad")
    return CyclicMessage("feedback", reply_id(node_id), FEEDBACK_LENGTH, (
        Signal("mode_head", SignalQuantity.STATUS, 0, 8),
        Signal("mode", SignalQuantity.STATUS, 16, 8),
        Signal("temperature_head", SignalQuantity.STATUS, 24, 8),
        Signal("fault", SignalQuantity.STATUS, 48, 8),
        Signal("values_head", SignalQuantity.STATUS, 56, 16),
        Signal("motor_head", SignalQuantity.STATUS, 168, 16),
        # The spool angle is sign * (motor angle - zero).
        position._replace(offset=-direction * zero),
        _float_signal("velocity", SignalQuantity.VELOCITY, 13, turns, "rad/s"),
        _float_signal("torque", SignalQuantity.TORQUE, 17, float(direction), "N m"),
        Signal("board", SignalQuantity.TEMPERATURE, 40, 8, coding=SignalCoding.SIGNED, unit="degC"),
        # Without a thermistor in the motor, the count of the motor temperature is -128. The
        # temperature of the board is then the highest temperature.
        Signal("motor", SignalQuantity.TEMPERATURE, 184, 8, coding=SignalCoding.SIGNED, unit="degC"),
    ), FD_FRAME_FLAGS)  # fmt: skip


def _float_signal(
    name: str, quantity: SignalQuantity, byte_offset: int, scale: float, unit: str
) -> Signal:
    """Return the description of a float32 signal that begins at a byte."""
    return Signal(
        name, quantity, 8 * byte_offset, 32, coding=SignalCoding.FLOAT, scale=scale, unit=unit
    )


def join_mode_and_fault(mode: int, fault: int) -> int:
    """Join a mode and a fault code to the status of feedback.

    Compiled code computes the same number from the signals mode and fault of a feedback frame.
    """
    header_numbers = [int.from_bytes(content, "little") for _, content in STATUS_HEADERS]
    return (
        (((header_numbers[0] << 8 | mode) << 8 | header_numbers[1]) << 8 | fault) << 16
        | header_numbers[2]
    ) << 16 | header_numbers[3]


def is_feedback(data: bytes) -> bool:
    """Return True if the payload has the layout of a feedback frame."""
    are_headers_equal = all(
        data[at : at + len(content)] == content for at, content in STATUS_HEADERS
    )
    return len(data) == FEEDBACK_LENGTH and are_headers_equal


class DriveReply(NamedTuple):
    """Decoded content of a reply from the drive.

    Attributes:
        values: value of each register in the reply, by register.
        error_by_register: error number of each refused read or write, by register.
        text: text from the diagnostic channel, None if the reply has no text subframe.
    """

    values: dict[int, float]
    error_by_register: dict[int, int]
    text: bytes | None


def decode_reply(data: bytes) -> DriveReply | None:
    """Decode a payload as a reply of the drive, or return None if it is no reply."""
    values = dict[int, float]()
    error_by_register = dict[int, int]()
    text = None
    reader = _SubframeReader(data)
    try:
        while reader.at < len(data):
            kind = reader.read_byte()
            if kind == NOP:
                continue
            if REPLY <= kind < REPLY + 0x10:
                values.update(reader.read_registers(kind))
            elif kind in (WRITE_REFUSED, READ_REFUSED):
                register = reader.read_varuint()
                error_by_register[register] = reader.read_varuint()
            elif kind == TEXT_OUT:
                reader.read_varuint()
                text = reader.read_bytes(reader.read_varuint())
            else:
                return None
    except IndexError:
        return None
    return (
        DriveReply(values, error_by_register, text)
        if values or error_by_register or text is not None
        else None
    )


class _SubframeReader:
    """Reader that decodes the payload of a reply one subframe element after another.

    At the end of the payload, the reader raises IndexError.
    """

    def __init__(self, payload: bytes) -> None:
        """Start reading at the first byte of the payload."""
        self.data = payload
        self.at = 0

    def read_byte(self) -> int:
        """Return the next byte of the payload."""
        value = self.data[self.at]
        self.at += 1
        return value

    def read_bytes(self, byte_count: int) -> bytes:
        """Return the next ``byte_count`` bytes of the payload."""
        value = self.data[self.at : self.at + byte_count]
        if len(value) < byte_count:
            raise IndexError
        self.at += byte_count
        return value

    def read_varuint(self) -> int:
        """Return the next varuint of the payload. A varuint has at most five groups of seven bits."""
        number = 0
        for shift in range(0, 35, 7):
            group = self.read_byte()
            number |= (group & 0x7F) << shift
            if group < 0x80:
                return number
        raise IndexError

    def read_registers(self, value_type: int) -> Iterator[tuple[int, Any]]:
        """Yield the pairs (register, value) of a register subframe."""
        coding = _VALUE_STRUCTS[value_type >> 2 & 3]
        count = value_type & 3 or self.read_varuint()
        first_value = self.read_varuint()
        for register in range(first_value, first_value + count):
            yield register, coding.unpack(self.read_bytes(coding.size))[0]
