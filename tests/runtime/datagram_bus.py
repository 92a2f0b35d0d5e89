"""Connect handctl's SocketCAN bus to datagram sockets in place of CAN sockets.

Both kinds of sockets have time stamps and count dropped frames.
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager

from handctl.runtime.buses.socketcan import SocketCanBus


@contextmanager
def datagram_bus(bus_index: int) -> Iterator[tuple[SocketCanBus, socket.socket]]:
    """Yield an open bus with the given index, and the socket at the other end of the bus."""
    near, peer_socket = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    near.bind(("127.0.0.1", 0))
    peer_socket.bind(("127.0.0.1", 0))
    near.connect(peer_socket.getsockname())
    peer_socket.connect(near.getsockname())
    peer_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    peer_socket.settimeout(20.0)
    bus = SocketCanBus(near, "socketcan:test", bus_index, convert_time=int)
    yield bus, peer_socket
    bus.close()
    peer_socket.close()
