"""Signal tables of cyclic frames.

A signal table contains the position, the coding and the scale of each value in a frame.

All drive protocols use the same compiled packer and the same compiled unpacker.
``drives.dbc_export`` uses the same tables to write a DBC file for other tools. The bits of a
payload have the same numbers as in a DBC file. Bit 0 is the lowest bit of the first byte. A
little-endian signal starts at its lowest bit. A big-endian signal starts at its highest bit.

Payloads of CAN FD have up to 64 bytes. The unpacker reads a signal from a window of eight bytes of
the payload. The window begins at byte 0 if the signal ends at byte 7 or before. If the signal ends
after byte 7, the window begins at the first byte of the signal.

The identifier of a command can contain a signal. The identifier is in the word of eight bytes
before the payload. The lowest bit of the word with the identifier has the number -64.
"""

import enum
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import kernel, kernel_helper

WordArray = NDArray[np.uint64]
"""Payloads as words of eight bytes. The first byte of a payload is in the lowest bits of the first word."""
RealArray = NDArray[np.float64]
IntegerArray = NDArray[np.int64]


class SignalQuantity(enum.IntEnum):
    """Physical quantity of a signal."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2
    TEMPERATURE = 3
    """Temperature. If a frame has several temperatures, only the highest temperature is used."""
    STATUS = 4
    """Status of the drive.

    Several status signals in a frame form one number, with the first signal in the highest bits of
    the number.
    """
    TENSION = 5
    ANGLE = 6
    COUNTER = 7
    UNUSED = 8
    """Signal that has a constant value in commands, and is ignored in feedback."""
    STIFFNESS = 9
    """Stiffness of the drive's own position loop, kp."""
    DAMPING = 10
    """Damping of the drive's own position loop, kd."""
    TORQUE_LIMIT = 11
    """Largest absolute torque of the drive."""


class SignalCoding(enum.IntEnum):
    """Number format of the bits of a signal."""

    UNSIGNED = 0
    SIGNED = 1
    """Signed integer in two's complement."""
    FLOAT = 2
    """Floating-point number in IEEE 754 with 32 bits."""


FLOAT_STEPS_PER_COUNT = 1 << 16
"""Number of steps between two counts of a float in position commands.

A float32 below 256 counts represents each step exactly.
"""


class Signal(NamedTuple):
    """Position, coding and scale of a value in a frame. The value of the signal is count * scale + offset.

    Attributes:
        name: name of the signal.
        quantity: physical quantity of the value.
        start: number of the start bit, as in a DBC file. The bits of an identifier are numbered
            from -64.
        length: number of bits of the signal.
        is_big_endian: True if the first byte of the signal is the highest byte.
        coding: number format of the count.
        scale: change of the value per count [unit].
        offset: value at count 0 [unit].
        unit: unit of the value.
        channel: index of the tendon or joint, in a frame with several tendons or joints.
        largest: largest absolute count of a float, used only to limit position commands.
    """

    name: str
    quantity: SignalQuantity
    start: int
    length: int
    is_big_endian: bool = False
    coding: SignalCoding = SignalCoding.UNSIGNED
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    channel: int = 0
    largest: float = math.inf

    @property
    def value_limits(self) -> tuple[float, float]:
        """Return the smallest and largest value of an unsigned integer signal or a float signal [unit].

        The smallest value of a stiffness, a damping or a torque limit is 0.
        """
        low = 0.0
        high = (1 << self.length) - 1.0
        if self.coding == SignalCoding.FLOAT:
            high = self.largest
            low = (
                0.0
                if self.quantity
                in (SignalQuantity.STIFFNESS, SignalQuantity.DAMPING, SignalQuantity.TORQUE_LIMIT)
                else -high
            )
        values = (self.offset + low * self.scale, self.offset + high * self.scale)
        return min(values), max(values)

    @property
    def step(self) -> float:
        """Return the resolution of the value [unit].

        The resolution of an integer signal is one count. A count of a float signal is divided into
        ``FLOAT_STEPS_PER_COUNT`` steps, and the resolution of the float signal is one step.
        """
        return abs(self.scale) / (FLOAT_STEPS_PER_COUNT if self.coding == SignalCoding.FLOAT else 1)


class CyclicMessage(NamedTuple):
    """Frame that host and drive exchange in every tick.

    Attributes:
        name: name of the message.
        can_id: identifier with the flag bits of ``frame``.
        length: length of the payload [bytes].
        signals: signals in the frame.
        flags: flags of the frame, see ``frame``.
        base_payload: payload of a command in which all signals are 0.
        is_reply: True for feedback that answers a command.
        limit: largest allowed absolute value of a command, in the unit of its signal.
        keeps_nearest_frame: True for feedback that the drive sends both on request and without a
            request, with values measured at different times. If several of these feedback frames
            arrive in a tick, the frame nearest to the expected position is used.
    """

    name: str
    can_id: int
    length: int
    signals: tuple[Signal, ...] = ()
    flags: int = 0
    base_payload: bytes = b""
    is_reply: bool = True
    limit: float = math.inf
    keeps_nearest_frame: bool = False


class CyclicMessages(NamedTuple):
    """Frames that every tick exchanges with one enabled drive.

    Attributes:
        feedback: frames from the drive.
        commands: frames to the drive, in the order in which the host sends them. One command
            contains the torque.
        feedback_timeout_ns: longest time without feedback before the state machine must act [ns], 0
            for no limit.
        position: command with the signals of ``POSITION_COMMAND``, with which the drive closes its
            own position loop. None if the protocol has no position command.
        integrates_velocity: True if the drive moves the commanded position with the commanded velocity
            until the next command. The value is False if the commanded position stays unchanged
            until the next command. If the host fails, a moving commanded position would increase
            the tension more and more. A command with a moving position contains a torque limit as a
            protection.
    """

    feedback: tuple[CyclicMessage, ...]
    commands: tuple[CyclicMessage, ...]
    feedback_timeout_ns: int = 0
    position: CyclicMessage | None = None
    integrates_velocity: bool = False


POSITION_COMMAND = (
    SignalQuantity.POSITION, SignalQuantity.VELOCITY, SignalQuantity.STIFFNESS, SignalQuantity.DAMPING,
    SignalQuantity.TORQUE, SignalQuantity.TORQUE_LIMIT,
)  # fmt: skip
"""Signals of ``CyclicMessages.position``, in order. The last signal, the torque limit, is optional.

The drive makes the torque kp (position - p) + kd (velocity - v) + torque, within +-limit.
"""


(
    START_COLUMN,
    LENGTH_COLUMN,
    ORDER_COLUMN,
    CODING_COLUMN,
    QUANTITY_COLUMN,
    CHANNEL_COLUMN,
    WINDOW_COLUMN,
) = range(7)
"""Columns of the integer array with the signals, which the packer and the unpacker read.

START_COLUMN is the number of the lowest bit of the signal in the window. WINDOW_COLUMN is the first byte of the
window in the payload, or IDENTIFIER_WINDOW.
"""
IDENTIFIER_WINDOW = -8
"""Value in the column WINDOW_COLUMN for a signal in the identifier."""
IDENTIFIER_BIT = -64
"""Bit number of the lowest bit of the identifier, in the numbering of ``Signal.start``."""
INTEGER_COLUMN_COUNT = 7
"""Number of columns of the integer array with the signals."""
UNSIGNED, SIGNED, FLOAT = map(int, SignalCoding)
"""Values of ``SignalCoding`` as integers of the module, for compiled code."""
SCALE_COLUMN, OFFSET_COLUMN = range(2)
"""Columns of the float array with the scale and the offset of each signal."""


def integer_columns(signal: Signal) -> tuple[int, ...]:
    """Return the row of a signal in the integer array, see ``START_COLUMN``."""
    order, coding, quantity = int(signal.is_big_endian), int(signal.coding), int(signal.quantity)
    if signal.start < 0:
        start = signal.start - IDENTIFIER_BIT
        return start, signal.length, order, coding, quantity, signal.channel, IDENTIFIER_WINDOW
    first_byte = signal.start // 8
    # Number of bits of the first byte that precede the signal, in the bit order of the signal.
    bits_before = 7 - signal.start % 8 if signal.is_big_endian else signal.start % 8
    window = first_byte if 8 * first_byte + bits_before + signal.length > 64 else 0
    start = 8 * (first_byte - window) + bits_before
    if signal.is_big_endian:
        # Number of the lowest bit of the signal, in a word whose first byte has the highest bits.
        start = 64 - start - signal.length
    return start, signal.length, order, coding, quantity, signal.channel, window


@kernel_helper
def read_window(words: Any, first_word: int, byte_offset: int) -> Any:
    """Return eight bytes of a payload as uint64, from ``byte_offset`` on. Bytes beyond the last word are 0.

    Args:
        words: (n,) uint64 words of a row.
        first_word: index of the first word of the payload.
        byte_offset: first byte of the window.
    """
    at = first_word + byte_offset // 8
    shift = np.uint64(8 * (byte_offset % 8))
    value = words[at] >> shift
    # The second word is read only if the window is in two words. If the window is in one word, the
    # shift of the second word would be 64 bits, which is undefined.
    if shift > np.uint64(0) and at + 1 < len(words):
        value |= words[at + 1] << (np.uint64(64) - shift)
    return value


@kernel_helper
def write_window(words: Any, first_word: int, byte_offset: int, signal_bits: Any) -> None:
    """Write the bits of a signal (uint64) into a payload.

    Before the call, the payload must have zeros at the positions of the signal's bits.

    Args:
        words: (n,) uint64 words of a row.
        first_word: index of the first word of the payload.
        byte_offset: first byte of the window.
        signal_bits: bits of the signal at their positions in the window.
    """
    at = first_word + byte_offset // 8
    shift = np.uint64(8 * (byte_offset % 8))
    words[at] |= signal_bits << shift
    if shift > np.uint64(0) and at + 1 < len(words):
        words[at + 1] |= signal_bits >> (np.uint64(64) - shift)


@kernel_helper
def bytes_reversed(word: Any) -> Any:
    """Return a word of eight bytes (uint64) with its bytes in reverse order."""
    result = np.uint64(0)
    for _ in range(8):
        result = result << np.uint64(8) | word & np.uint64(0xFF)
        word = word >> np.uint64(8)
    return result


@kernel_helper
def decode_signal(
    value: Any, signal_integers: IntegerArray, signal_scalings: RealArray, i: int
) -> float:
    """Decode the value of signal i from the bits of a window.

    If a float is not finite, return NaN.
    """
    length = signal_integers[i, LENGTH_COLUMN]
    mask = (np.uint64(1) << np.uint64(length)) - np.uint64(1)
    bits = (value >> np.uint64(signal_integers[i, START_COLUMN])) & mask
    coding = signal_integers[i, CODING_COLUMN]
    if coding == FLOAT:
        number = np.float64(np.uint32(bits).view(np.float32))
        return (
            number * signal_scalings[i, SCALE_COLUMN] + signal_scalings[i, OFFSET_COLUMN]
            if math.isfinite(number)
            else math.nan
        )
    integer_value = np.int64(bits)
    # The top bit of the signal is the sign, which is copied to all higher bits of the number.
    if coding == SIGNED and integer_value >> (length - 1):
        integer_value -= np.int64(1) << length
    result: float = (
        integer_value * signal_scalings[i, SCALE_COLUMN] + signal_scalings[i, OFFSET_COLUMN]
    )
    return result


@kernel_helper
def encode_signal(
    value: float, signal_integers: IntegerArray, signal_scalings: RealArray, i: int
) -> Any:
    """Encode a value as signal i, and return the bits of the signal at their position in a window.

    The value must be finite and in the range of the signal. Half a count is rounded up.
    """
    # The code uses floor(x + 0.5), because round() rounds a half to the even number. A negative
    # number sets bits above the signal, which the mask removes.
    scaled = (value - signal_scalings[i, OFFSET_COLUMN]) / signal_scalings[i, SCALE_COLUMN]
    mask = (np.uint64(1) << np.uint64(signal_integers[i, LENGTH_COLUMN])) - np.uint64(1)
    if signal_integers[i, CODING_COLUMN] == FLOAT:
        bits = np.uint64(np.float32(scaled).view(np.uint32))
    else:
        bits = np.int64(math.floor(scaled + 0.5)).view(np.uint64)
    return (bits & mask) << np.uint64(signal_integers[i, START_COLUMN])


@kernel("words", "matrix_int", "matrix")
def unpack_rows(data: WordArray, rows: IntegerArray, signal_scalings: RealArray) -> RealArray:
    """Decode each signal (signals,) in the words of an identifier and a payload (1, words).

    The arrays ``rows`` and ``signal_scalings`` have one row per signal.
    """
    result = np.empty(len(rows))
    for i in range(len(rows)):
        value = read_window(data[0], 1, rows[i, WINDOW_COLUMN])
        result[i] = decode_signal(
            bytes_reversed(value) if rows[i, ORDER_COLUMN] else value, rows, signal_scalings, i
        )
    return result


@kernel("words", "matrix_int", "matrix", "vector")
def pack_rows(
    data: WordArray, rows: IntegerArray, signal_scalings: RealArray, values: RealArray
) -> None:
    """Encode each value (signals,) into the words of an identifier and a payload (1, words).

    Before the call, all bits at the positions of the signals must be zero.
    """
    for i in range(len(rows)):
        bits = encode_signal(values[i], rows, signal_scalings, i)
        write_window(
            data[0],
            1,
            rows[i, WINDOW_COLUMN],
            bytes_reversed(bits) if rows[i, ORDER_COLUMN] else bits,
        )


class SignalTable:
    """Signals of a message, as arrays for the packer and the unpacker.

    Attributes:
        message: the message.
        signal_integers: (signals, INTEGER_COLUMN_COUNT) integer columns, see ``START_COLUMN``.
        signal_scalings: (signals, 2) scale and offset, see ``SCALE_COLUMN``.
    """

    def __init__(self, message: CyclicMessage) -> None:
        """Build the arrays of a message, without signals of quantity UNUSED."""
        self.message = message
        signals = [signal for signal in message.signals if signal.quantity != SignalQuantity.UNUSED]
        self.signal_integers: IntegerArray = np.array(
            [integer_columns(signal) for signal in signals], dtype=np.int64
        ).reshape(-1, INTEGER_COLUMN_COUNT)
        self._names = [(signal.name, signal.unit) for signal in signals]
        self.signal_scalings: RealArray = np.array(
            [(signal.scale, signal.offset) for signal in signals], dtype=np.float64
        ).reshape(-1, 2)

    def unpack(self, data: bytes) -> list[float]:
        """Return the value of each signal in a payload.

        If a float in the payload is not finite, its value is NaN.
        """
        values: list[float] = unpack_rows(
            self._payload_words(data), self.signal_integers, self.signal_scalings
        ).tolist()
        return values

    def pack(self, *values: float) -> bytes:
        """Return the payload with the given values, one per signal.

        Raises:
            ValueError: a value is not finite, or exceeds the limit of the message.
        """
        return self.pack_frame(*values)[1]

    def pack_frame(self, *values: float) -> tuple[int, bytes]:
        """Return the identifier and the payload with the given values, one per signal.

        Raises:
            ValueError: a value is not finite, or exceeds the limit of the message.
        """
        for value, (name, unit) in zip(values, self._names, strict=True):
            # The comparison is negated, so that the check refuses NaN.
            if not abs(value) <= self.message.limit:
                raise ValueError(f"{name} {value} {unit}, expected at most {self.message.limit:g}")
        data = self._payload_words(self.message.base_payload)
        pack_rows(
            data, self.signal_integers, self.signal_scalings, np.array(values, dtype=np.float64)
        )
        return int(data[0, 0]), data[0, 1:].tobytes()[: self.message.length]

    def _payload_words(self, payload: bytes) -> WordArray:
        """Return the identifier and a payload as words (1, words).

        Zeros are added at the end of a short payload.
        """
        size = 8 * max(1, -(-self.message.length // 8))
        id_bytes = self.message.can_id.to_bytes(8, "little")
        return (
            np.frombuffer(id_bytes + payload.ljust(size, b"\0")[:size], np.uint64)
            .reshape(1, -1)
            .copy()
        )
