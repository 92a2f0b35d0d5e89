"""Cyclic frames as tables of signals: where a value is in a frame, how it is coded, what a count is worth.

One packer and one unpacker, compiled, serve all protocols. The same tables make a DBC (``drives.dbc``), with which
other tools decode the bus. Bit positions are those of a DBC: bit 0 is the lowest bit of the first byte. A little-endian
signal begins at its lowest bit, a big-endian one at its highest.
"""

import enum
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from handctl.compiled import inner, kernel

Words = NDArray[np.uint64]
"""Payloads as numbers of eight bytes, the first byte lowest."""
Real = NDArray[np.float64]
Whole = NDArray[np.int64]


class Quantity(enum.IntEnum):
    """What a signal carries."""

    POSITION = 0
    VELOCITY = 1
    TORQUE = 2
    TEMPERATURE = 3
    """Of several in a frame the hottest counts."""
    STATUS = 4
    """Several in a frame are one number, the first in its highest bits."""
    TENSION = 5
    ANGLE = 6
    COUNTER = 7
    UNUSED = 8
    """Constant in commands, and not read in feedback."""


class Coding(enum.IntEnum):
    """How a number is written."""

    UNSIGNED = 0
    SIGNED = 1
    FLOAT = 2
    """IEEE 754, 32 bits."""


class Signal(NamedTuple):
    """A value in a frame: value = count * scale + offset.

    Attributes:
        name: of the signal. quantity: what it carries.
        start: bit, as in a DBC. length: bits. big_endian: byte order. coding: of the count.
        scale, offset: see above. unit: of the value.
        channel: index of the tendon or joint, of a frame that carries several.
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
    """A cyclic frame.

    Attributes:
        name: of the message. can_id: with the flag bits of ``frame``. length: of the payload [bytes].
        signals: in it.
        flags: of the frame, see ``frame``.
        base: payload with all signals 0, of a command.
        answers: whether it is the feedback that answers a command.
        limit: largest absolute value of its torque, of a command [N m].
    """

    name: str
    can_id: int
    length: int
    signals: tuple[Signal, ...] = ()
    flags: int = 0
    base: bytes = b""
    answers: bool = True
    limit: float = math.inf


class Cyclic(NamedTuple):
    """The frames that one drive exchanges in every tick while it is enabled.

    Attributes:
        feedback: it sends. commands: it is sent, in this order; the torque is in one of them.
        patience_ns: longest time without feedback after which its state machine must look [ns]; 0: it need not.
    """

    feedback: tuple[Message, ...]
    commands: tuple[Message, ...]
    patience_ns: int = 0


START, LENGTH, ORDER, CODING, QUANTITY, CHANNEL = range(6)
UNSIGNED, SIGNED, FLOAT = map(int, Coding)
"""As numbers of this module, as compiled code wants them."""
SCALE, OFFSET = range(2)
"""Columns of the two arrays that describe signals to the packer and the unpacker."""


def whole_columns(signal: Signal) -> tuple[int, ...]:
    """Return the whole numbers of a signal as the unpacker reads them: the start is its lowest bit in a word."""
    start = signal.start
    if signal.big_endian:
        # In a word that was read with the first byte highest, the position of the signal's lowest bit.
        start = 64 - 8 * (start // 8) - (7 - start % 8) - signal.length
    return start, signal.length, int(signal.big_endian), int(signal.coding), int(signal.quantity), signal.channel


@inner
def swapped(value: Any) -> Any:
    """Return a number of eight bytes (uint64) with its bytes in the opposite order."""
    found = np.uint64(0)
    for _ in range(8):
        found = found << np.uint64(8) | value & np.uint64(0xFF)
        value = value >> np.uint64(8)
    return found


@inner
def unpacked(value: Any, wholes: Whole, reals: Real, i: int) -> float:
    """Return the value of signal i of a word; NaN if it is a float that is not finite."""
    length = wholes[i, LENGTH]
    mask = (np.uint64(1) << np.uint64(length)) - np.uint64(1)
    bits = (value >> np.uint64(wholes[i, START])) & mask
    coding = wholes[i, CODING]
    if coding == FLOAT:
        number = np.float64(np.uint32(bits).view(np.float32))
        return number * reals[i, SCALE] + reals[i, OFFSET] if math.isfinite(number) else math.nan
    count = np.int64(bits)
    if coding == SIGNED and count >> (length - 1):
        count -= np.int64(1) << length
    found: float = count * reals[i, SCALE] + reals[i, OFFSET]
    return found


@inner
def packed(value: float, wholes: Whole, reals: Real, i: int) -> Any:
    """Return the bits of signal i, at their place in a word.

    The caller has made sure that the value is finite and fits. Half a count is rounded up.
    """
    scaled = (value - reals[i, OFFSET]) / reals[i, SCALE]
    mask = (np.uint64(1) << np.uint64(wholes[i, LENGTH])) - np.uint64(1)
    if wholes[i, CODING] == FLOAT:
        bits = np.uint64(np.float32(scaled).view(np.uint32))
    else:
        bits = np.int64(math.floor(scaled + 0.5)).view(np.uint64)
    return (bits & mask) << np.uint64(wholes[i, START])


@kernel("words", "matrix_int", "matrix")
def unpack_rows(data: Words, rows: Whole, reals: Real) -> Real:
    """Return the values (signals,) of a payload (1, 1); the arrays have a row for each signal."""
    found = np.empty(len(rows))
    for i in range(len(rows)):
        found[i] = unpacked(swapped(data[0, 0]) if rows[i, ORDER] else data[0, 0], rows, reals, i)
    return found


@kernel("words", "matrix_int", "matrix", "vector")
def pack_rows(data: Words, rows: Whole, reals: Real, values: Real) -> None:
    """Write values (signals,) into a payload (1, 1) that has zeros at their places."""
    for i in range(len(rows)):
        bits = packed(values[i], rows, reals, i)
        data[0, 0] |= swapped(bits) if rows[i, ORDER] else bits


class Table:
    """The signals of a message as arrays for the packer and the unpacker.

    Attributes:
        message: whose. wholes: (signals, 6). reals: (signals, 2).
    """

    def __init__(self, message: Message) -> None:
        self.message = message
        signals = [signal for signal in message.signals if signal.quantity != Quantity.UNUSED]
        self.wholes: Whole = np.array([whole_columns(signal) for signal in signals], dtype=np.int64).reshape(-1, 6)
        self.reals: Real = np.array([(one.scale, one.offset) for one in signals], dtype=np.float64).reshape(-1, 2)

    def unpack(self, data: bytes) -> list[float]:
        """Return the value of each signal; NaN for a float that is not finite."""
        padded = np.frombuffer(data.ljust(8, b"\0"), np.uint64, 1).reshape(1, 1).copy()
        values: list[float] = unpack_rows(padded, self.wholes, self.reals).tolist()
        return values

    def pack(self, *values: float) -> bytes:
        """Return the payload with a value for each signal.

        Raises:
            ValueError: a value is not finite, or its torque is beyond the limit.
        """
        for value in values:
            if not abs(value) <= self.message.limit:
                raise ValueError(f"torque {value} N m, expected at most {self.message.limit:g}")
        data = np.frombuffer(self.message.base.ljust(8, b"\0"), np.uint64, 1).reshape(1, 1).copy()
        pack_rows(data, self.wholes, self.reals, np.array(values, dtype=np.float64))
        return data.tobytes()[: self.message.length]
