"""The length of a frame on the wire in bits, and the arbitration priority of a frame.

Source: ISO 11898-1:2015, frame formats and bit stuffing.

In a classical frame, stuff bits are inserted into the following fields: start of frame, identifier,
RTR, IDE, reserved bit, DLC, data, and CRC. No stuff bits are inserted after the CRC of a classical
frame. In an FD frame, stuff bits are inserted from the start of frame to the end of the data, as in
a classical frame. The stuff count and the CRC of an FD frame have fixed stuff bits, one before
every four bits.
"""

from dataclasses import dataclass
from functools import lru_cache

from firmware_sim.bus.frame import BRS, EXTENDED_FLAG, FDF, REMOTE_FLAG, Frame

INTERFRAME_BITS = 3
"""Number of bits of the interframe space."""
TAIL_BITS = 1 + 1 + 1 + 7 + INTERFRAME_BITS
"""Number of bits of CRC delimiter, acknowledge slot, acknowledge delimiter, end of frame and interframe space.

No stuff bits are inserted into the listed fields, which end a frame.
"""
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Payload length for each data length code of CAN FD [bytes]."""
CRC15_POLYNOMIAL = 0x4599
"""Generator polynomial of the classical CRC, x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1, without the leading term."""


@dataclass(frozen=True, slots=True)
class BitRates:
    """Bit rates of a wire.

    Attributes:
        nominal_bit_s: bit rate of the arbitration and of classical frames [bit/s].
        data_bit_s: bit rate in the data phase of FD frames with bit-rate switch [bit/s], 0 for a
            bus without CAN FD.
        are_stuff_bits_counted: True to count the actual stuff bits of each frame, and False to
            count the largest possible number of stuff bits for the length of the frame.
    """

    nominal_bit_s: int
    data_bit_s: int = 0
    are_stuff_bits_counted: bool = False

    def duration_of_bits_ns(self, count: int) -> int:
        """Return the duration of the given number of bits at the nominal bit rate [ns]."""
        return round(count * 1e9 / self.nominal_bit_s)

    def frame_duration_ns(self, frame: Frame) -> int:
        """Return the time for which a frame occupies the wire [ns], including the interframe space."""
        content = bytes(frame.data) if self.are_stuff_bits_counted else bytes(len(frame.data))
        # If the actual stuff bits are not counted, zeros replace the content of the frame, so that
        # the cache key depends only on the length of the frame.
        nominal_bits, data_bits = _frame_bits(
            frame.can_id, content, frame.flags & (FDF | BRS), self.are_stuff_bits_counted
        )
        return round(
            nominal_bits * 1e9 / self.nominal_bit_s
            + data_bits * 1e9 / (self.data_bit_s or self.nominal_bit_s)
        )


def arbitration_priority(can_id: int) -> int:
    """Return the arbitration field of a frame as a number.

    The frame with the lowest arbitration field wins the arbitration.

    Arbitration cannot decide between frames with equal arbitration fields.
    """
    is_remote = bool(can_id & REMOTE_FLAG)
    if can_id & EXTENDED_FLAG:
        base = can_id >> 18 & 0x7FF
        lower_id_bits = can_id & 0x3FFFF
        # The arbitration field of a 29-bit identifier has 11 base bits, SRR and IDE (both
        # recessive, 1), 18 extension bits, and RTR.
        return base << 21 | 0b11 << 19 | lower_id_bits << 1 | is_remote
    # The arbitration field of an 11-bit identifier has RTR where a 29-bit identifier has SRR, and
    # its IDE is dominant. So a data frame wins over a remote frame.
    return (can_id & 0x7FF) << 21 | is_remote << 20


@lru_cache(maxsize=1 << 12)
def _frame_bits(
    can_id: int, data: bytes, flags: int, are_stuff_bits_counted: bool
) -> tuple[int, int]:
    """Count the bits of a frame at the nominal bit rate, and the bits at the data bit rate."""
    return (
        _fd_frame_bits(can_id, data, flags, are_stuff_bits_counted)
        if flags & FDF
        else _classical_frame_bits(can_id, data, are_stuff_bits_counted)
    )


def _classical_frame_bits(
    can_id: int, data: bytes, are_stuff_bits_counted: bool
) -> tuple[int, int]:
    """Count the bits of a classical frame.

    All bits of a classical frame have the nominal bit rate.
    """
    body = (
        _identifier_bits(can_id)
        + ("00" if can_id & EXTENDED_FLAG else "0")
        + format(len(data), "04b")
    )
    body += "" if can_id & REMOTE_FLAG else "".join(format(byte, "08b") for byte in data)
    stuffed_part = body + _crc15(body)
    return len(stuffed_part) + (
        _stuff_bit_count(stuffed_part) if are_stuff_bits_counted else (len(stuffed_part) - 1) // 4
    ) + TAIL_BITS, 0


def _fd_frame_bits(
    can_id: int, data: bytes, flags: int, are_stuff_bits_counted: bool
) -> tuple[int, int]:
    """Count the bits of an FD frame at the nominal bit rate, and the bits at the data bit rate."""
    size = next(length for length in FD_LENGTHS if length >= len(data))
    has_fast_bits = bool(flags & BRS)
    header_bits = (
        _identifier_bits(can_id) + "10" + ("1" if has_fast_bits else "0")
    )  # FDF, reserved, BRS
    body = "0" + format(FD_LENGTHS.index(size), "04b")  # ESI, DLC
    body += "".join(format(byte, "08b") for byte in data.ljust(size, b"\0"))
    stuff_bits_in_head = (
        _stuff_bit_count(header_bits) if are_stuff_bits_counted else (len(header_bits) - 1) // 4
    )
    stuff_bits_total = (
        _stuff_bit_count(header_bits + body)
        if are_stuff_bits_counted
        else (len(header_bits) + len(body) - 1) // 4
    )
    # The CRC has 17 bits for a payload of up to 16 bytes, and 21 bits for a longer payload. The
    # stuff count and the CRC have one fixed stuff bit before every four bits.
    crc_field_bits = 4 + (17 if size <= 16 else 21)
    nominal_bits = len(header_bits) + stuff_bits_in_head + TAIL_BITS
    data_bits = (
        len(body) + stuff_bits_total - stuff_bits_in_head + crc_field_bits + -(-crc_field_bits // 4)
    )
    return (nominal_bits, data_bits) if has_fast_bits else (nominal_bits + data_bits, 0)


def _identifier_bits(can_id: int) -> str:
    """Return the first bits of a frame: all bits from the start of frame to IDE.

    For a 29-bit identifier, return the bits up to RTR.
    """
    remote_bit = "1" if can_id & REMOTE_FLAG else "0"
    if can_id & EXTENDED_FLAG:
        return (
            "0"
            + format(can_id >> 18 & 0x7FF, "011b")
            + "11"
            + format(can_id & 0x3FFFF, "018b")
            + remote_bit
        )
    return "0" + format(can_id & 0x7FF, "011b") + remote_bit + "0"


def _stuff_bit_count(bit_string: str) -> int:
    """Count the stuff bits of a bit string.

    After five equal bits, the sender inserts the opposite bit. The inserted bit is the first bit of
    the next run of equal bits.
    """
    last_bit = ""
    equal_bits = 0
    count = 0
    for bit in bit_string:
        equal_bits = equal_bits + 1 if bit == last_bit else 1
        last_bit = bit
        if equal_bits == 5:
            count += 1
            last_bit = "10"[int(bit)]
            equal_bits = 1
    return count


def _crc15(bit_string: str) -> str:
    """Compute the CRC of a classical frame from a sequence of bits, as 15 binary digits."""
    register = 0
    for bit in bit_string:
        # The line below is one step of the CRC's shift register, with the feedback of the top bit
        # and the input bit.
        feedback_bit = register >> 14 ^ (bit == "1")
        register = register << 1 & 0x7FFF ^ (CRC15_POLYNOMIAL if feedback_bit else 0)
    return format(register, "015b")
