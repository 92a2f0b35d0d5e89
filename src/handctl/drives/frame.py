"""CAN frame, in the form that all parts of handctl use."""

from typing import NamedTuple

EXTENDED_FLAG = 1 << 31
"""Flag bit of a 29-bit identifier. Source: Linux ``can.h``, CAN_EFF_FLAG."""
REMOTE_FLAG = 1 << 30
"""Flag bit of a remote transmission request. Source: Linux ``can.h``, CAN_RTR_FLAG."""
ERROR_FLAG = 1 << 29
"""Flag bit of an error frame. Source: Linux ``can.h``, CAN_ERR_FLAG."""

# Flags of CAN FD frames: bit rate switch, error state indicator, CAN FD format. Source: Linux
# ``can.h``, CANFD_*.
BRS = 1
ESI = 2
FDF = 4

make_tuple = tuple.__new__
"""Fast constructor of named tuples.

``make_tuple(Frame, (...))`` takes a third of the time of ``Frame(...)``.
"""


class Frame(NamedTuple):
    """One CAN frame, classical or CAN FD.

    Attributes:
        can_id: 11- or 29-bit identifier with the flag bits EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG, as in
            SocketCAN.
        data: payload, at most 8 bytes in a classical frame and 64 bytes in a CAN FD frame.
        flags: BRS | ESI | FDF, 0 for a classical frame.
        bus: index into the hand's list of buses.
        t_ns: time of reception on the run's clock [ns], 0 for a frame to be sent.
    """

    can_id: int
    data: bytes
    flags: int = 0
    bus: int = 0
    t_ns: int = 0
