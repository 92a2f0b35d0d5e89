"""Bus load of a hand.

The computation uses the longest possible duration of each frame, with all stuff bits.

    classical   exposed to stuffing 34 + 8 n | at most (exposed - 1) / 4 stuff bits | 13 without stuffing
    CAN FD      header 17 + 4 stuff | ESI and DLC 5, data 8 n | stuff count 4, CRC 17 or 21, fixed stuff | 13

The table gives the number of bits in each part of a frame with an 11-bit identifier and n data
bytes. A 29-bit identifier adds SRR, IDE and 18 bits. The bits of a 29-bit identifier are exposed to
stuffing. The last 13 bits of a frame are CRC delimiter, acknowledge, end of frame, and interframe
space. Source: ISO 11898-1.
"""

import math
from collections.abc import Iterable

COMMON_CONTROL_RATES_HZ = (1000.0, 500.0, 400.0, 250.0, 200.0, 100.0, 50.0, 20.0, 10.0)
"""Usual control rates, highest first [Hz]."""
MAX_BUS_LOAD = 0.70
"""Largest fraction of the time for which the frames of a hand are allowed to occupy a bus.

The rest of the time on the bus is reserved for bursts of frames.
"""


EXTENDED_FRAME_EXTRA_BITS = 20
"""Bits that a 29-bit identifier adds to a frame: SRR, IDE, and the lower 18 bits of the identifier."""


def frame_time_s(
    payload_size: int,
    fd: bool,
    bitrate: float,
    data_bitrate: float | None = None,
    extended: bool = False,
) -> float:
    """Return the longest possible duration of one frame on the bus [s].

    Args:
        payload_size: length of the payload [bytes]. The length of a CAN FD frame is rounded up to the next
            length that the standard allows.
        fd: True for a CAN FD frame with bit rate switch.
        bitrate: nominal bit rate [bit/s].
        data_bitrate: bit rate of the data phase [bit/s]. If ``data_bitrate`` is None, the nominal
            bit rate is used.
        extended: True for a 29-bit identifier.
    """
    extra_bits = EXTENDED_FRAME_EXTRA_BITS if extended else 0
    if not fd:
        stuffable_bits = 34 + extra_bits + 8 * payload_size
        return (stuffable_bits + 13 + (stuffable_bits - 1) // 4) / bitrate
    return _fd_frame_time_s(payload_size, bitrate, data_bitrate or bitrate, extra_bits)


FD_SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Possible payload lengths of a CAN FD frame [bytes]. Source: ISO 11898-1, table of DLC."""


# Number of bits of a CAN FD frame from start of frame to BRS, and number of stuff bits among them.
# The bits up to BRS have the nominal bit rate.
FD_HEADER_BITS = 17
FD_HEADER_STUFF_BITS = 4
FD_END_BITS = 13
"""Number of bits after the CRC: delimiter, acknowledge, end of frame, interframe space.

The bit rate changes in the middle of the CRC delimiter. The computation counts the whole CRC
delimiter at the nominal bit rate.
"""


def _fd_frame_time_s(
    payload_size: int, bitrate: float, data_bitrate: float, extra_identifier_bits: int
) -> float:
    """Return the longest possible duration of a CAN FD frame on the bus [s].

    Up to the last data bit of a CAN FD frame, stuff bits are inserted as in a classical frame. The
    CRC field has one fixed stuff bit before every four bits. ``extra_identifier_bits`` is the
    number of bits that a 29-bit identifier adds.
    """
    payload_size = next(length for length in FD_SIZES if length >= payload_size)
    # The body of the frame has ESI, the four bits of DLC, and the data.
    body_bits = 5 + 8 * payload_size
    header_stuff_bits = FD_HEADER_STUFF_BITS + extra_identifier_bits // 4
    stuff_bits = (FD_HEADER_BITS + extra_identifier_bits + body_bits - 1) // 4 - header_stuff_bits
    # The check field has a stuff count (3 bits and parity) and a CRC. The CRC has 17 bits for up to
    # 16 data bytes, and 21 bits for more data bytes.
    check_bits = 4 + (17 if payload_size <= 16 else 21)
    nominal_rate_bits = FD_HEADER_BITS + extra_identifier_bits + header_stuff_bits + FD_END_BITS
    return (
        nominal_rate_bits / bitrate
        + (body_bits + stuff_bits + check_bits + math.ceil(check_bits / 4)) / data_bitrate
    )


def bus_time_s(
    frames: Iterable[tuple[int, bool, float]], bitrate: float, data_bitrate: float | None = None
) -> float:
    """Return the time for which the frames of one tick occupy the bus [s].

    Args:
        frames: frames of a tick as (payload bytes, CAN FD?, frames per tick).
        bitrate: nominal bit rate [bit/s].
        data_bitrate: bit rate of the data phase [bit/s]. If ``data_bitrate`` is None, the nominal
            bit rate is used.
    """
    return sum(
        number * frame_time_s(size, fd, bitrate, data_bitrate) for size, fd, number in frames
    )


def highest_rate(
    tick_times_s: Iterable[float], periodic_loads: Iterable[float] | None = None
) -> float:
    """Return the highest rate in ``COMMON_CONTROL_RATES_HZ`` at which no bus is loaded above ``MAX_BUS_LOAD`` [Hz].

    Args:
        tick_times_s: time for which the frames of one tick occupy each bus [s].
        periodic_loads: fraction of the time for which frames with a fixed rate occupy each bus, 0
            by default.
    """
    times = tuple(tick_times_s)
    pairs = tuple(
        zip(times, (0.0,) * len(times) if periodic_loads is None else periodic_loads, strict=True)
    )
    feasible_rates = (
        rate
        for rate in COMMON_CONTROL_RATES_HZ
        if all(
            rate * busy_time + periodic_load <= MAX_BUS_LOAD for busy_time, periodic_load in pairs
        )
    )
    return next(feasible_rates, COMMON_CONTROL_RATES_HZ[-1])
