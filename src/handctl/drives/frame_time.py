"""Bus load of a hand: worst-case frame times with stuff bits.

    classical   exposed to stuffing 34 + 8 n | at most (exposed - 1) / 4 stuff bits | 13 without
    stuffing
    CAN FD      header 17 + 4 stuff | ESI and DLC 5, data 8 n | stuff count 4, CRC 17 or 21, fixed stuff | 13

The rows have an 11-bit identifier and n data bytes. A 29-bit identifier adds SRR, IDE and 18 bits,
all exposed to stuffing. The 13 bits are CRC delimiter, acknowledge, end of frame, and interframe
space. Source: ISO 11898-1.
"""

import math
from collections.abc import Iterable

USUAL_RATES_HZ = (1000.0, 500.0, 400.0, 250.0, 200.0, 100.0, 50.0, 20.0, 10.0)
"""Usual control rates, highest first [Hz]."""
MAX_BUS_LOAD = 0.70
"""Fraction of a bus that a hand may use. The rest is reserved for bursts."""


EXTENDED_BITS = 20
"""Bits that a 29-bit identifier adds to a frame: SRR, IDE, and the lower 18 bits of the identifier."""


def frame_time_s(
    size: int, fd: bool, bitrate: float, data_bitrate: float | None = None, extended: bool = False
) -> float:
    """Return the longest time of one frame on the wire [s].

    Args:
        size: payload [bytes]. CAN FD rounds it up to the next payload length of the standard.
        fd: True for CAN FD with bit rate switch.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: bit rate of the data phase [bit/s], nominal if None.
        extended: True for a 29-bit identifier.
    """
    more = EXTENDED_BITS if extended else 0
    if not fd:
        exposed = 34 + more + 8 * size
        return (exposed + 13 + (exposed - 1) // 4) / bitrate
    return _fd_time(size, bitrate, data_bitrate or bitrate, more)


FD_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Payload lengths of CAN FD [bytes]. Source: ISO 11898-1, table of DLC."""


# Bits of CAN FD from start of frame to BRS, and their stuff bits, at the nominal rate.
HEADER_BITS = 17
HEADER_STUFF_BITS = 4
END_BITS = 13
"""Bits after the CRC at the nominal rate: delimiter, acknowledge, end of frame, interframe space.

The bit rate changes in the middle of the delimiter. The whole delimiter is counted at the nominal
rate.
"""


def _fd_time(size: int, bitrate: float, data_bitrate: float, more: int) -> float:
    """Return the longest time of a CAN FD frame on the wire [s].

    Up to the last data bit, stuff bits are inserted as in a classical frame. The CRC field has one
    fixed stuff bit before every four bits. ``more`` is the number of bits that a longer identifier
    adds.
    """
    size = next(length for length in FD_SIZES if length >= size)
    # ESI and the four bits of DLC, then the data.
    body = 5 + 8 * size
    header_stuff = HEADER_STUFF_BITS + more // 4
    stuff = (HEADER_BITS + more + body - 1) // 4 - header_stuff
    # Stuff count (3 bits and parity), then a CRC of 17 bits up to 16 bytes and of 21 bits above.
    check = 4 + (17 if size <= 16 else 21)
    nominal = HEADER_BITS + more + header_stuff + END_BITS
    return nominal / bitrate + (body + stuff + check + math.ceil(check / 4)) / data_bitrate


def bus_time_s(frames: Iterable[tuple[int, bool, float]], bitrate: float, data_bitrate: float | None = None) -> float:
    """Return the time that the frames of one tick occupy the bus [s].

    Args:
        frames: (payload bytes, CAN FD?, frames per tick).
        bitrate: nominal bit rate [bit/s].
        data_bitrate: bit rate of the data phase [bit/s], nominal if None.
    """
    return sum(number * frame_time_s(size, fd, bitrate, data_bitrate) for size, fd, number in frames)


def highest_rate(tick_times_s: Iterable[float], periodic_loads: Iterable[float] | None = None) -> float:
    """Return the highest usual control rate at which no bus load exceeds ``MAX_BUS_LOAD`` [Hz].

    Args:
        tick_times_s: time of one tick's frames on each bus [s].
        periodic_loads: fraction of each bus used by periodic frames, 0 by default.
    """
    times = tuple(tick_times_s)
    pairs = tuple(zip(times, (0.0,) * len(times) if periodic_loads is None else periodic_loads, strict=True))
    fits = (
        rate
        for rate in USUAL_RATES_HZ
        if all(rate * busy + periodic_load <= MAX_BUS_LOAD for busy, periodic_load in pairs)
    )
    return next(fits, USUAL_RATES_HZ[-1])
