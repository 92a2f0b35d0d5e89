"""Length of a frame on the wire, and arbitration priority.

Source: ISO 11898-1:2015, frame formats and bit stuffing.

Classical frame: start of frame, identifier, RTR, IDE, reserved, DLC, data and CRC are stuffed. The
tail is not. FD frame: identifier to data are stuffed as in a classical frame. Stuff count and CRC
have fixed stuff bits, one before every four bits.
"""

from dataclasses import dataclass
from functools import lru_cache

from firmware_sim.bus.frame import BRS, EXTENDED, FDF, REMOTE, Frame

INTERFRAME_BITS = 3
"""Bits of the interframe space."""
TAIL_BITS = 1 + 1 + 1 + 7 + INTERFRAME_BITS
"""CRC delimiter, acknowledge slot and delimiter, end of frame, interframe space.

These bits are not stuffed.
"""
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Payload length of each FD data length code [bytes]."""
CRC15 = 0x4599
"""Generator polynomial of the classical CRC: x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1, without the leading term."""


@dataclass(frozen=True, slots=True)
class Rate:
    """Bit rates of a wire.

    Attributes:
        nominal: bit rate of arbitration and classical frames [bit/s].
        data: bit rate of the data phase of FD frames with bit-rate switch [bit/s], 0 for a
            classical bus.
        actual: True to count the stuff bits of each frame, False to count the maximum for its
            length.
    """

    nominal: int
    data: int = 0
    actual: bool = False

    def bits_ns(self, count: int) -> int:
        """Return the duration of a number of nominal bits [ns]."""
        return round(count * 1e9 / self.nominal)

    def frame_ns(self, frame: Frame) -> int:
        """Return the time a frame occupies the wire, including the interframe space [ns]."""
        content = bytes(frame.data) if self.actual else bytes(len(frame.data))
        # Without actual stuffing all-zero content makes the cache key depend on the length only.
        slow, fast = _bits(frame.can_id, content, frame.flags & (FDF | BRS), self.actual)
        return round(slow * 1e9 / self.nominal + fast * 1e9 / (self.data or self.nominal))


def priority(can_id: int) -> int:
    """Return the arbitration field as a number. The lowest number wins.

    Frames with equal numbers cannot be told apart during arbitration.
    """
    remote = bool(can_id & REMOTE)
    if can_id & EXTENDED:
        base = can_id >> 18 & 0x7FF
        rest = can_id & 0x3FFFF
        # 29-bit identifier: 11 bits base, SRR and IDE (both recessive), 18 bits extension, RTR.
        # Recessive is 1.
        return base << 21 | 0b11 << 19 | rest << 1 | remote
    # 11-bit identifier: RTR takes the place of SRR, IDE is dominant. A data frame wins over a
    # remote frame.
    return (can_id & 0x7FF) << 21 | remote << 20


@lru_cache(maxsize=1 << 12)
def _bits(can_id: int, data: bytes, flags: int, actual: bool) -> tuple[int, int]:
    """Count the nominal and the fast bits of a frame."""
    return _fd(can_id, data, flags, actual) if flags & FDF else _classical(can_id, data, actual)


def _classical(can_id: int, data: bytes, actual: bool) -> tuple[int, int]:
    """Count the bits of a classical frame. All bits are nominal."""
    body = _identifier(can_id) + ("00" if can_id & EXTENDED else "0") + format(len(data), "04b")
    body += "" if can_id & REMOTE else "".join(format(byte, "08b") for byte in data)
    exposed = body + _crc15(body)
    return len(exposed) + (_stuff(exposed) if actual else (len(exposed) - 1) // 4) + TAIL_BITS, 0


def _fd(can_id: int, data: bytes, flags: int, actual: bool) -> tuple[int, int]:
    """Count the nominal and the fast bits of an FD frame."""
    size = next(length for length in FD_LENGTHS if length >= len(data))
    fast_bits = bool(flags & BRS)
    head = _identifier(can_id) + "10" + ("1" if fast_bits else "0")  # FDF, reserved, BRS
    body = "0" + format(FD_LENGTHS.index(size), "04b")  # ESI, DLC
    body += "".join(format(byte, "08b") for byte in data.ljust(size, b"\0"))
    in_head = _stuff(head) if actual else (len(head) - 1) // 4
    in_all = _stuff(head + body) if actual else (len(head) + len(body) - 1) // 4
    # Stuff count and CRC: 17 bits of CRC up to 16 bytes, 21 bits beyond. One fixed stuff bit before
    # every four bits.
    check = 4 + (17 if size <= 16 else 21)
    slow = len(head) + in_head + TAIL_BITS
    fast = len(body) + in_all - in_head + check + -(-check // 4)
    return (slow, fast) if fast_bits else (slow + fast, 0)


def _identifier(can_id: int) -> str:
    """Return the bits from start of frame to IDE, or to the RTR bit of a 29-bit identifier."""
    remote = "1" if can_id & REMOTE else "0"
    if can_id & EXTENDED:
        return "0" + format(can_id >> 18 & 0x7FF, "011b") + "11" + format(can_id & 0x3FFFF, "018b") + remote
    return "0" + format(can_id & 0x7FF, "011b") + remote + "0"


def _stuff(bits: str) -> int:
    """Count the stuff bits. After five equal bits the opposite bit is inserted, and counts for the next five."""
    last = ""
    run = 0
    count = 0
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count += 1
            last = "10"[int(bit)]
            run = 1
    return count


def _crc15(bits: str) -> str:
    """Compute the classical CRC of a bit string as 15 binary digits."""
    register = 0
    for bit in bits:
        # One step of the shift register: feedback of the top bit and the input bit.
        out = register >> 14 ^ (bit == "1")
        register = register << 1 & 0x7FFF ^ (CRC15 if out else 0)
    return format(register, "015b")
