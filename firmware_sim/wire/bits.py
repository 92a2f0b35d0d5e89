"""How long a frame is on the wire, and which of two goes first.

Source: ISO 11898-1:2015, frame formats and bit stuffing.
"""

from dataclasses import dataclass
from functools import lru_cache

from firmware_sim.bus.frame import BRS, EXTENDED, FDF, REMOTE, Frame

INTERFRAME_BITS = 3
TAIL_BITS = 1 + 1 + 1 + 7 + INTERFRAME_BITS
"""CRC delimiter, acknowledge slot and delimiter, end of frame, interframe space: never stuffed."""
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
CRC15 = 0x4599


@dataclass(frozen=True, slots=True)
class Rate:
    """Speed of a wire.

    Attributes:
        nominal: of arbitration and classical frames [bit/s].
        data: of the data phase of FD frames with bit-rate switch [bit/s]; 0 for a classical bus.
        actual: count the stuff bits that a frame really has; otherwise the most that its length can have.
    """

    nominal: int
    data: int = 0
    actual: bool = False

    def bits_ns(self, count: int) -> int:
        """Return the time of some nominal bits [ns]."""
        return round(count * 1e9 / self.nominal)

    def frame_ns(self, frame: Frame) -> int:
        """Return how long a frame occupies the wire, interframe space included [ns]."""
        content = bytes(frame.data) if self.actual else bytes(len(frame.data))
        slow, fast = _bits(frame.can_id, content, frame.flags & (FDF | BRS), self.actual)
        return round(slow * 1e9 / self.nominal + fast * 1e9 / (self.data or self.nominal))


def priority(can_id: int) -> int:
    """Return the arbitration field as a number: the lowest wins; equal ones belong to frames that look alike."""
    remote = bool(can_id & REMOTE)
    if can_id & EXTENDED:
        base, rest = can_id >> 18 & 0x7FF, can_id & 0x3FFFF
        return base << 21 | 0b11 << 19 | rest << 1 | remote
    return (can_id & 0x7FF) << 21 | remote << 20


@lru_cache(maxsize=1 << 12)
def _bits(can_id: int, data: bytes, flags: int, actual: bool) -> tuple[int, int]:
    """Nominal and fast bits of a frame."""
    return _fd(can_id, data, flags, actual) if flags & FDF else _classical(can_id, data, actual)


def _classical(can_id: int, data: bytes, actual: bool) -> tuple[int, int]:
    body = _identifier(can_id) + ("00" if can_id & EXTENDED else "0") + format(len(data), "04b")
    body += "" if can_id & REMOTE else "".join(format(byte, "08b") for byte in data)
    exposed = body + _crc15(body)
    return len(exposed) + (_stuff(exposed) if actual else (len(exposed) - 1) // 4) + TAIL_BITS, 0


def _fd(can_id: int, data: bytes, flags: int, actual: bool) -> tuple[int, int]:
    """Stuff bits up to the data's end as in a classical frame; then fixed ones, one before every four bits."""
    size = next(length for length in FD_LENGTHS if length >= len(data))
    fast_bits = bool(flags & BRS)
    head = _identifier(can_id) + "10" + ("1" if fast_bits else "0")  # FDF, reserved, BRS
    body = "0" + format(FD_LENGTHS.index(size), "04b")  # ESI, DLC
    body += "".join(format(byte, "08b") for byte in data.ljust(size, b"\0"))
    in_head = _stuff(head) if actual else (len(head) - 1) // 4
    in_all = _stuff(head + body) if actual else (len(head) + len(body) - 1) // 4
    check = 4 + (17 if size <= 16 else 21)  # stuff count and CRC
    slow = len(head) + in_head + TAIL_BITS
    fast = len(body) + in_all - in_head + check + -(-check // 4)
    return (slow, fast) if fast_bits else (slow + fast, 0)


def _identifier(can_id: int) -> str:
    """Start of frame to IDE, or to the bit after the long identifier."""
    remote = "1" if can_id & REMOTE else "0"
    if can_id & EXTENDED:
        return "0" + format(can_id >> 18 & 0x7FF, "011b") + "11" + format(can_id & 0x3FFFF, "018b") + remote
    return "0" + format(can_id & 0x7FF, "011b") + remote + "0"


def _stuff(bits: str) -> int:
    """How many bits are put in: the opposite of five equal ones, which counts for the next five."""
    last, run, count = "", 0, 0
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            count, last, run = count + 1, "10"[int(bit)], 1
    return count


def _crc15(bits: str) -> str:
    register = 0
    for bit in bits:
        out = register >> 14 ^ (bit == "1")
        register = register << 1 & 0x7FFF ^ (CRC15 if out else 0)
    return format(register, "015b")
