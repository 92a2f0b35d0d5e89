"""Connect handctl's SocketCAN bus to datagram sockets in place of CAN sockets.

Both kinds of sockets have time stamps and count dropped frames.
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from handctl.runtime.buses.socketcan import SocketCanBus


@contextmanager
def datagram_bus(bus_index: int) -> Iterator[tuple[SocketCanBus, socket.socket]]:
    """Yield an open bus with the given index, and the socket at the other end of this bus."""
    near, far_end = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    near.bind(("127.0.0.1", 0))
    far_end.bind(("127.0.0.1", 0))
    near.connect(far_end.getsockname())
    far_end.connect(near.getsockname())
    far_end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    far_end.settimeout(20.0)
    bus = SocketCanBus(near, "socketcan:test", bus_index, convert_time=int)
    yield bus, far_end
    bus.close()
    far_end.close()
