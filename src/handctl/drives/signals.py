"""Signal tables of cyclic frames: position, coding, and scale of each value in a frame.

One compiled packer and one compiled unpacker serve all protocols. ``drives.dbc`` writes a DBC file
for other tools from these tables. Bit positions are those of a DBC: bit 0 is the lowest bit of the
first byte. The start of a little-endian signal is its lowest bit. The start of a big-endian signal
is its highest bit.

A signal is read from a window of eight bytes. The window begins at byte 0, or at the first byte of
the signal if the signal ends after byte 7. Payloads of CAN FD have up to 64 bytes.

A command may have a signal in its identifier. The identifier is the word of eight bytes before the
payload, so its lowest bit has the number -64.
"""

import enum
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner, kernel

Words = NDArray[np.uint64]
"""Payloads as words of eight bytes, the first byte lowest."""
Real = NDArray[np.float64]
Whole = NDArray[np.int64]


class Quantity(enum.IntEnum):
    """Physical quantity of a signal."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2
    TEMPERATURE = 3
    """Temperature. If a frame has several, the highest is used."""
    STATUS = 4
    """Status. Several status signals in a frame form one number, with the first signal in the highest bits."""
    TENSION = 5
    ANGLE = 6
    COUNTER = 7
    UNUSED = 8
    """Constant value in commands. Ignored in feedback."""
    STIFFNESS = 9
    """Stiffness of the drive's own position loop, kp."""
    DAMPING = 10
    """Damping of the drive's own position loop, kd."""


class Coding(enum.IntEnum):
    """Coding of the bits of a signal."""

    UNSIGNED = 0
    SIGNED = 1
    """Two's complement."""
    FLOAT = 2
    """IEEE 754, 32 bits."""


class Signal(NamedTuple):
    """Value in a frame: value = count * scale + offset.

    Attributes:
        name: name of the signal.
        quantity: physical quantity.
        start: start bit, as in a DBC. In an identifier, counted from -64.
        length: number of bits.
        big_endian: byte order.
        coding: coding of the count.
        scale: value of one count [unit].
        offset: value of count 0 [unit].
        unit: unit of the value.
        channel: index of the tendon or joint, in a frame with several tendons or joints.
    """

    name: str
    quantity: Quantity
    start: int
    length: int
    big_endian: bool = False
    coding: Coding = Coding.UNSIGNED
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    channel: int = 0


class Message(NamedTuple):
    """Cyclic frame.

    Attributes:
        name: name of the message.
        can_id: identifier with the flag bits of ``frame``.
        length: length of the payload [bytes].
        signals: signals in the frame.
        flags: flags of the frame, see ``frame``.
        base: payload of a command with all signals 0.
        answers: True for feedback that answers a command.
        limit: largest absolute value of a command, in the unit of its signal.
        nearest: True for a message that the drive sends on request and also by itself, measured at
            different times. If several frames arrive in a tick, the one nearest to the expected
            position is used.
    """

    name: str
    can_id: int
    length: int
    signals: tuple[Signal, ...] = ()
    flags: int = 0
    base: bytes = b""
    answers: bool = True
    limit: float = math.inf
    nearest: bool = False


class Cyclic(NamedTuple):
    """Frames exchanged with one drive in every tick while the drive is enabled.

    Attributes:
        feedback: frames from the drive.
        commands: frames to the drive, in this order. One of them carries the torque.
        feedback_timeout_ns: longest time without feedback before the state machine must act [ns], 0
            for no limit.
        position: the torque command with the five signals of ``POSITION_COMMAND``, with which the
            drive closes its own position loop. None if the protocol has no such frame.
    """

    feedback: tuple[Message, ...]
    commands: tuple[Message, ...]
    feedback_timeout_ns: int = 0
    position: Message | None = None


POSITION_COMMAND = (
    Quantity.POSITION, Quantity.VELOCITY, Quantity.STIFFNESS, Quantity.DAMPING, Quantity.TORQUE
)  # fmt: skip
"""Signals of ``Cyclic.position``, in order.

The drive makes the torque kp (position - p) + kd (velocity - v) + torque.
"""


START, LENGTH, ORDER, CODING, QUANTITY, CHANNEL, WINDOW = range(7)
"""Columns of the integer array that describes signals to the packer and the unpacker.

START is the lowest bit of the signal in its window. WINDOW is the first byte of the window, or
IN_IDENTIFIER.
"""
IN_IDENTIFIER = -8
"""Value of WINDOW for a signal in the identifier."""
IDENTIFIER_BIT = -64
"""Number of the lowest bit of the identifier, as a start bit."""
COLUMNS = 7
"""Number of integer columns."""
UNSIGNED, SIGNED, FLOAT = map(int, Coding)
"""Codings as module-level integers, for compiled code."""
SCALE, OFFSET = range(2)
"""Columns of the float array."""


def integer_columns(signal: Signal) -> tuple[int, ...]:
    """Return the values of the integer columns for a signal. Its start is the lowest bit in its window."""
    order, coding, quantity = int(signal.big_endian), int(signal.coding), int(signal.quantity)
    if signal.start < 0:
        start = signal.start - IDENTIFIER_BIT
        return start, signal.length, order, coding, quantity, signal.channel, IN_IDENTIFIER
    first = signal.start // 8
    # Bits of the first byte that precede the signal, in the order of the signal's bits.
    before = 7 - signal.start % 8 if signal.big_endian else signal.start % 8
    window = first if 8 * first + before + signal.length > 64 else 0
    start = 8 * (first - window) + before
    if signal.big_endian:
        # Position of the signal's lowest bit in a word whose first byte is the highest.
        start = 64 - start - signal.length
    return start, signal.length, order, coding, quantity, signal.channel, window


@inner
def window_at(words: Any, first: int, byte: int) -> Any:
    """Return eight bytes of a payload as uint64, from the given byte on. Bytes after the last word are 0.

    Args:
        words: (n,) uint64 words of a row.
        first: index of the first word of the payload.
        byte: first byte of the window.
    """
    at = first + byte // 8
    shift = np.uint64(8 * (byte % 8))
    value = words[at] >> shift
    # The second word is used only if the window is divided, because a shift by 64 bits is
    # undefined.
    if shift > np.uint64(0) and at + 1 < len(words):
        value |= words[at + 1] << (np.uint64(64) - shift)
    return value


@inner
def write_window(words: Any, first: int, byte: int, bits: Any) -> None:
    """Write the bits of a signal (uint64) into a payload that has zeros at their positions.

    Args:
        words: (n,) uint64 words of a row.
        first: index of the first word of the payload.
        byte: first byte of the window.
        bits: content of the window.
    """
    at = first + byte // 8
    shift = np.uint64(8 * (byte % 8))
    words[at] |= bits << shift
    if shift > np.uint64(0) and at + 1 < len(words):
        words[at + 1] |= bits >> (np.uint64(64) - shift)


@inner
def bytes_reversed(value: Any) -> Any:
    """Return a word of eight bytes (uint64) with its bytes in reverse order."""
    result = np.uint64(0)
    for _ in range(8):
        result = result << np.uint64(8) | value & np.uint64(0xFF)
        value = value >> np.uint64(8)
    return result


@inner
def decode_signal(value: Any, wholes: Whole, reals: Real, i: int) -> float:
    """Return the value of signal i from a window, or NaN for a float that is not finite."""
    length = wholes[i, LENGTH]
    mask = (np.uint64(1) << np.uint64(length)) - np.uint64(1)
    bits = (value >> np.uint64(wholes[i, START])) & mask
    coding = wholes[i, CODING]
    if coding == FLOAT:
        number = np.float64(np.uint32(bits).view(np.float32))
        return number * reals[i, SCALE] + reals[i, OFFSET] if math.isfinite(number) else math.nan
    count = np.int64(bits)
    # The top bit is the sign: extend it.
    if coding == SIGNED and count >> (length - 1):
        count -= np.int64(1) << length
    result: float = count * reals[i, SCALE] + reals[i, OFFSET]
    return result


@inner
def encode_signal(value: float, wholes: Whole, reals: Real, i: int) -> Any:
    """Return the bits of signal i at their position in a window.

    The value must be finite and within range. Half a count is rounded up.
    """
    # floor(x + 0.5) is used, because round() rounds a half to the even number. The mask removes the
    # sign extension.
    scaled = (value - reals[i, OFFSET]) / reals[i, SCALE]
    mask = (np.uint64(1) << np.uint64(wholes[i, LENGTH])) - np.uint64(1)
    if wholes[i, CODING] == FLOAT:
        bits = np.uint64(np.float32(scaled).view(np.uint32))
    else:
        bits = np.int64(math.floor(scaled + 0.5)).view(np.uint64)
    return (bits & mask) << np.uint64(wholes[i, START])


@kernel("words", "matrix_int", "matrix")
def unpack_rows(data: Words, rows: Whole, reals: Real) -> Real:
    """Return the value of each signal (signals,) from an identifier and payload (1, words).

    The arrays have one row per signal.
    """
    result = np.empty(len(rows))
    for i in range(len(rows)):
        value = window_at(data[0], 1, rows[i, WINDOW])
        result[i] = decode_signal(bytes_reversed(value) if rows[i, ORDER] else value, rows, reals, i)
    return result


@kernel("words", "matrix_int", "matrix", "vector")
def pack_rows(data: Words, rows: Whole, reals: Real, values: Real) -> None:
    """Write the value of each signal (signals,) into identifier and payload (1, words).

    The bits at the positions of the signals must be zero.
    """
    for i in range(len(rows)):
        bits = encode_signal(values[i], rows, reals, i)
        write_window(data[0], 1, rows[i, WINDOW], bytes_reversed(bits) if rows[i, ORDER] else bits)


class Table:
    """Signals of a message as arrays, for the packer and the unpacker.

    Attributes:
        message: the message.
        wholes: (signals, COLUMNS), see ``START``.
        reals: (signals, 2), see ``SCALE``.
    """

    def __init__(self, message: Message) -> None:
        """Build the arrays of a message. Signals of quantity UNUSED are left out."""
        self.message = message
        signals = [signal for signal in message.signals if signal.quantity != Quantity.UNUSED]
        self.wholes: Whole = np.array([integer_columns(signal) for signal in signals], dtype=np.int64).reshape(
            -1, COLUMNS
        )
        self._names = [(one.name, one.unit) for one in signals]
        self.reals: Real = np.array([(one.scale, one.offset) for one in signals], dtype=np.float64).reshape(-1, 2)

    def unpack(self, data: bytes) -> list[float]:
        """Return the value of each signal, NaN for a float that is not finite."""
        values: list[float] = unpack_rows(self._words(data), self.wholes, self.reals).tolist()
        return values

    def pack(self, *values: float) -> bytes:
        """Return the payload that contains one value per signal.

        Raises:
            ValueError: a value is not finite, or beyond the limit.
        """
        return self.pack_frame(*values)[1]

    def pack_frame(self, *values: float) -> tuple[int, bytes]:
        """Return the identifier and the payload that contain one value per signal.

        Raises:
            ValueError: a value is not finite, or beyond the limit.
        """
        for value, (name, unit) in zip(values, self._names, strict=True):
            # Negated, so that NaN is refused.
            if not abs(value) <= self.message.limit:
                raise ValueError(f"{name} {value} {unit}, expected at most {self.message.limit:g}")
        data = self._words(self.message.base)
        pack_rows(data, self.wholes, self.reals, np.array(values, dtype=np.float64))
        return int(data[0, 0]), data[0, 1:].tobytes()[: self.message.length]

    def _words(self, data: bytes) -> Words:
        """Return identifier and payload as words (1, words), with zeros appended if the payload is shorter."""
        size = 8 * max(1, -(-self.message.length // 8))
        head = self.message.can_id.to_bytes(8, "little")
        return np.frombuffer(head + data.ljust(size, b"\0")[:size], np.uint64).reshape(1, -1).copy()
