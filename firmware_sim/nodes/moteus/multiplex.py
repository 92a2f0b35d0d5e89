"""Subframes of the register protocol of moteus, as the drive reads and writes them.

Source: docs/facts/moteus.md.

    0x00..0x0F write    count, first register, values        0x30  write error: register, error
    0x10..0x1F read     count, first register                0x31  read error: register, error
    0x20..0x2F reply    count, first register, values        0x50  no operation
    0x40 text in, 0x41 text out: channel, length, text       0x42  poll for text: channel, longest length

In the first byte of a register subframe, bits 3 and 2 give the type of the values: int8, int16,
int32 or float32. Bits 1 and 0 of the first byte contain the number of values. If bits 1 and 0 are
0, the next bytes contain the number of values as a varuint. Numbers are little-endian.
"""

import math
import struct

INT8, INT16, INT32, FLOAT = range(4)
"""Codes of the types of register values."""
REGISTER_STRUCTS = (
    struct.Struct("<b"),
    struct.Struct("<h"),
    struct.Struct("<i"),
    struct.Struct("<f"),
)
"""Encoding of a register value, by type."""
MAX_INTEGER_BY_TYPE = (127, 32767, 2147483647)
"""Largest integer of each integer type. The most negative integer of a type means NaN."""
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Payload lengths in CAN FD [bytes]."""
PADDING_SUBFRAME = b"\x50"
"""Subframe *no operation*, which fills a payload up to a length of CAN FD."""

# Value of one integer step as int8, int16 and int32, for each kind of physical quantity.
UNSCALED_LSB = (1.0, 1.0, 1.0)
POSITION_LSB = (0.01, 0.0001, 0.00001)
VELOCITY_LSB = (0.1, 0.00025, 0.00001)
TORQUE_LSB = (0.5, 0.01, 0.001)
TEMPERATURE_LSB = (1.0, 0.1, 0.001)
TIME_LSB = (0.01, 0.001, 0.000001)
CURRENT_LSB = (1.0, 0.1, 0.001)
VOLTAGE_LSB = (0.5, 0.1, 0.001)
POWER_LSB = (10.0, 0.05, 0.0001)
ACCELERATION_LSB = (0.05, 0.001, 0.00001)
FRACTION_LSB = (1.0 / 127, 1.0 / 32767, 1.0 / 2147483647)


class MalformedPayload(Exception):  # noqa: N818 - never leaves the node
    """Error for a payload that ends within a subframe, or that contains an unknown subframe."""


class PayloadReader:
    """Reader of a payload, from the first byte to the last byte."""

    def __init__(self, data: bytes) -> None:
        """Create a reader that starts at the first byte of a payload."""
        self._data = data
        self._at = 0

    @property
    def has_more(self) -> bool:
        """Return True if bytes of the payload are left."""
        return self._at < len(self._data)

    def take(self, byte_count: int) -> bytes:
        """Return the next bytes of the payload.

        Raises:
            MalformedPayload: the payload has fewer bytes left than requested.
        """
        taken_bytes = self._data[self._at : self._at + byte_count]
        if len(taken_bytes) != byte_count:
            raise MalformedPayload
        self._at += byte_count
        return taken_bytes

    def varuint(self) -> int:
        """Return the next number of the payload, a varuint of at most five bytes.

        Raises:
            MalformedPayload: the payload ends within the number, or the number has more than five
                bytes.
        """
        value = 0
        for i in range(5):
            (byte,) = self.take(1)
            value += (byte & 127) << 7 * i
            if byte < 128:
                return value
        raise MalformedPayload


def encode_varuint(value: int) -> bytes:
    """Return a number as the bytes of a varuint."""
    if value < 128:
        return bytes([value])
    return bytes([128 | value & 127]) + encode_varuint(value >> 7)


def decode_register(
    register_bytes: bytes, value_type: int, lsb_values: tuple[float, float, float]
) -> float:
    """Decode the bytes of a register value. The most negative integer of a type means NaN."""
    (number,) = REGISTER_STRUCTS[value_type].unpack(register_bytes)
    if value_type == FLOAT:
        return float(number)
    return (
        math.nan
        if number < -MAX_INTEGER_BY_TYPE[value_type]
        else float(number * lsb_values[value_type])
    )


def encode_register(value: float, value_type: int, lsb_values: tuple[float, float, float]) -> bytes:
    """Encode a register value, limited to the range of its type and truncated towards 0."""
    if value_type == FLOAT:
        return REGISTER_STRUCTS[FLOAT].pack(value)
    if not math.isfinite(value):
        return REGISTER_STRUCTS[value_type].pack(-MAX_INTEGER_BY_TYPE[value_type] - 1)
    # The code rounds the quotient to float32, because the drive does the same. In float64, the
    # quotient 0.00003 / 1e-5 would be slightly less than 3.
    count = struct.unpack("<f", struct.pack("<f", value / lsb_values[value_type]))[0]
    return REGISTER_STRUCTS[value_type].pack(
        int(max(-MAX_INTEGER_BY_TYPE[value_type], min(MAX_INTEGER_BY_TYPE[value_type], count)))
    )


def subframe_head(base: int, value_type: int, register_count: int, first_register: int) -> bytes:
    """Return the bytes of a register subframe that precede the register values."""
    subframe = base | value_type << 2
    start = (
        bytes([subframe | register_count])
        if 0 < register_count < 4
        else bytes([subframe]) + encode_varuint(register_count)
    )
    return start + encode_varuint(first_register)


def padded_payload(data: bytes) -> bytes:
    """Return a payload, padded to the next length that CAN FD allows."""
    return data + PADDING_SUBFRAME * (
        min(length for length in FD_LENGTHS if length >= len(data)) - len(data)
    )
