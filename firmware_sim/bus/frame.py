"""The CAN frame as the simulated nodes see it, and its record of 72 bytes."""

import struct
from typing import NamedTuple

EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
"""Flag bits in the identifier. Source: Linux ``can.h``, CAN_EFF_FLAG, CAN_RTR_FLAG, CAN_ERR_FLAG."""

BRS, ESI, FDF = 1, 2, 4
"""CAN FD flags. Source: Linux ``can.h``, CANFD_BRS, CANFD_ESI, CANFD_FDF."""

RECORD_SIZE = 72
"""``struct canfd_frame``, one record of the local bus. Source: Linux ``can.h``, CANFD_MTU."""

_RECORD = struct.Struct("<IBBBB64s")


class Frame(NamedTuple):
    """One CAN frame, classical or FD.

    Attributes:
        can_id: 11- or 29-bit identifier with the flag bits of SocketCAN.
        data: payload, at most 8 bytes (classical) or 64 (FD).
        flags: BRS | ESI | FDF; 0 for a classical frame.
        bus: index into the hand's list of buses.
        t_ns: time of reception [ns].
    """

    can_id: int
    data: bytes
    flags: int = 0
    bus: int = 0
    t_ns: int = 0


def pack_record(frame: Frame) -> bytes:
    """Return a frame as a record of 72 bytes, with a drop count of zero."""
    return _RECORD.pack(frame.can_id, len(frame.data), frame.flags, 0, 0, frame.data)


def unpack_record(record: bytes, bus: int = 0, t_ns: int = 0) -> Frame | None:
    """Return the frame in a record of 72 bytes; None if its length does not fit its format."""
    can_id, length, flags, _, _, data = _RECORD.unpack(record)
    if length > (64 if flags & FDF else 8):
        return None
    return Frame(can_id, data[:length], flags, bus, t_ns)
