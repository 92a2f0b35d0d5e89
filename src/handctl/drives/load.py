"""How much of a bus a hand takes: worst-case frame times, stuff bits included.

Source: ISO 11898-1. Classical data frame with an 11-bit identifier: 34 + 8 n bits are exposed to stuffing, at most one
stuff bit in four after the first, 13 more bits are not (CRC delimiter, acknowledge, end of frame, interframe space).
"""

import math
from collections.abc import Iterable

NICE_RATES_HZ = (1000.0, 500.0, 400.0, 250.0, 200.0, 100.0, 50.0, 20.0, 10.0)
MOST = 0.70
"""Share of a bus that a hand may plan for; the rest is for what comes in bursts."""


def frame_time_s(size: int, fd: bool, bitrate: float, data_bitrate: float | None = None) -> float:
    """Longest time of one frame with an 11-bit identifier on the wire [s].

    Args:
        size: payload [bytes]; of an FD frame rounded up to a length that exists.
        fd: CAN FD with bit rate switch.
        bitrate: nominal [bit/s].
        data_bitrate: of the data phase [bit/s]; the nominal one if None.
    """
    if not fd:
        exposed = 34 + 8 * size
        return (exposed + 13 + (exposed - 1) // 4) / bitrate
    return _fd_time(size, bitrate, data_bitrate or bitrate)


FD_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


HEADER_BITS, HEADER_STUFF_BITS = 17, 4
"""Of CAN FD from start of frame to BRS, at the nominal rate like the end of the frame."""
END_BITS = 13
"""CRC delimiter (counted whole, it changes rate in its middle), acknowledge, end of frame, interframe space."""


def _fd_time(size: int, bitrate: float, data_bitrate: float) -> float:
    """CAN FD [s]: stuff bits up to the last data bit as in a classical frame, then one before every four bits."""
    size = next(length for length in FD_SIZES if length >= size)
    body = 5 + 8 * size
    stuff = (HEADER_BITS + body - 1) // 4 - HEADER_STUFF_BITS
    check = 4 + (17 if size <= 16 else 21)
    nominal = HEADER_BITS + HEADER_STUFF_BITS + END_BITS
    return nominal / bitrate + (body + stuff + check + math.ceil(check / 4)) / data_bitrate


def bus_time_s(frames: Iterable[tuple[int, bool, float]], bitrate: float, data_bitrate: float | None = None) -> float:
    """Time that one tick's frames take [s].

    Args:
        frames: (payload bytes, CAN FD?, how many a tick).
        bitrate, data_bitrate: of the bus [bit/s].
    """
    return sum(number * frame_time_s(size, fd, bitrate, data_bitrate) for size, fd, number in frames)


def highest_rate(tick_times_s: Iterable[float], shares: Iterable[float] | None = None) -> float:
    """The highest usual control rate [Hz] at which no bus is loaded beyond ``MOST``.

    Args:
        tick_times_s: of one tick's frames on each bus [s].
        shares: of each bus that frames take which come by time; none if not given.
    """
    times = tuple(tick_times_s)
    pairs = tuple(zip(times, (0.0,) * len(times) if shares is None else shares, strict=True))
    fits = (rate for rate in NICE_RATES_HZ if all(rate * busy + share <= MOST for busy, share in pairs))
    return next(fits, NICE_RATES_HZ[-1])
