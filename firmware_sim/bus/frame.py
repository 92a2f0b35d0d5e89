"""The CAN frame of the simulated nodes, and the record of 72 bytes for frames on a local bus.

Record (``struct canfd_frame``, little-endian):

    byte  0..3   identifier with flag bits: 31 extended, 30 remote, 29 error
    byte  4      payload length
    byte  5      flags: 0x01 BRS, 0x02 ESI, 0x04 FDF
    byte  6..7   number of records dropped for the receiver, modulo 65536, written by the hub
    byte  8..71  payload, padded with zeros
"""

import struct
from typing import NamedTuple

EXTENDED_FLAG = 1 << 31
"""Flag bit of an identifier of 29 bits. Source: Linux ``can.h``, CAN_EFF_FLAG."""
REMOTE_FLAG = 1 << 30
"""Flag bit in the identifier of a remote frame. Source: Linux ``can.h``, CAN_RTR_FLAG."""
ERROR_FLAG = 1 << 29
"""Flag bit in the identifier of an error frame. Source: Linux ``can.h``, CAN_ERR_FLAG."""

BRS = 1
"""CAN FD flag: bit-rate switch. Source: Linux ``can.h``, CANFD_BRS."""
ESI = 2
"""CAN FD flag: the sender is error-passive. Source: Linux ``can.h``, CANFD_ESI."""
FDF = 4
"""CAN FD flag: the frame has the FD format. Source: Linux ``can.h``, CANFD_FDF."""

RECORD_SIZE = 72
"""Size of ``struct canfd_frame``, the record of the local bus [bytes]. Source: Linux ``can.h``, CANFD_MTU."""

_FRAME_STRUCT = struct.Struct("<IBBBB64s")


class Frame(NamedTuple):
    """One CAN frame, classical or FD.

    Attributes:
        can_id: 11- or 29-bit identifier with the flag bits of SocketCAN.
        data: payload of the frame, at most 8 bytes for classical CAN and 64 bytes for CAN FD.
        flags: CAN FD flags, a combination of BRS, ESI and FDF. The flags are 0 for a classical
            frame.
        bus: index of the frame's bus in the list of the hand's buses.
        t_ns: time when the frame was received [ns].
    """

    can_id: int
    data: bytes
    flags: int = 0
    bus: int = 0
    t_ns: int = 0


def pack_record(frame: Frame) -> bytes:
    """Pack a frame into a record of 72 bytes.

    In this record, the counter of dropped records is zero.
    """
    return _FRAME_STRUCT.pack(frame.can_id, len(frame.data), frame.flags, 0, 0, frame.data)


def unpack_record(record: bytes, bus: int = 0, t_ns: int = 0) -> Frame | None:
    """Unpack the frame of a record of 72 bytes.

    Args:
        record: record of a local bus, 72 bytes.
        bus: index of the bus to set in the returned frame.
        t_ns: time of reception to set in the returned frame [ns].

    Returns:
        The frame, or None if the payload length in the record is not allowed for the frame's
        format.
    """
    can_id, length, flags, _, _, data = _FRAME_STRUCT.unpack(record)
    if length > (64 if flags & FDF else 8):
        return None
    return Frame(can_id, data[:length], flags, bus, t_ns)
