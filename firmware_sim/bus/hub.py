"""The hub of a local bus.

Every client of a hub receives the records of all other clients. No client can block the hub.

A record has 72 bytes (``frame.RECORD_SIZE``). One read from a socket can return several records,
and can end in the middle of a record. If the socket buffer of a client has no room, the hub drops
the records for this client. Bytes 6 and 7 of each record for a client contain a counter, modulo
65536. The counter is the number of records that were dropped for this client.
"""

import contextlib
import errno
import fcntl
import os
import socket
import struct
import sys
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

from firmware_sim.bus.frame import RECORD_SIZE
from firmware_sim.description.hand_description import SimulatorError
from firmware_sim.socket_paths import bus_path

BUFFER_BYTES = 1 << 20
"""Size of the socket buffer requested from the kernel for each direction [bytes].

Linux grants 416 KiB by default.
"""
_PEER_CREDENTIALS = struct.Struct("3i")
"""Linux's ``struct ucred``: process, user and group of the other end of a Unix socket."""
_MAX_READ_BYTES = 1 << 16
"""Maximum number of bytes of one read from a client.

Because of the limit, a client that floods the bus cannot block the other clients.
"""


class HubConnection:
    """One connection between a hub and a client.

    In both directions, the connection between hub and client carries whole records. No method
    blocks.

    Attributes:
        socket: non-blocking stream socket of the connection.
        dropped_record_count: number of records dropped because the kernel's send buffer was full.
        closed: True after the other process has closed the connection.
        unsent: bytes of a partly sent record that must still be sent.
    """

    def __init__(self, client_socket: socket.socket) -> None:
        """Make the socket non-blocking, and enlarge the buffers of the socket.

        Args:
            client_socket: connected stream socket.
        """
        self.socket = client_socket
        self.dropped_record_count = 0
        self.closed = False
        self.unsent = b""
        self._partial = b""
        client_socket.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            client_socket.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)

    def receive(self) -> bytes:
        """Receive whole records.

        If only the first bytes of a record have arrived, the connection keeps these bytes until the
        other bytes arrive.
        """
        try:
            received_bytes = self.socket.recv(_MAX_READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            received_bytes = b""
        self.closed = self.closed or not received_bytes
        data = self._partial + received_bytes if self._partial else received_bytes
        end = len(data) - len(data) % RECORD_SIZE
        self._partial = data[end:]
        return data[:end]

    def deliver(self, records: bytes) -> None:
        """Send whole records.

        If the send buffer of the socket has no room for a record, the connection drops and counts
        the record.
        """
        count = len(records) // RECORD_SIZE
        if not self.flush():
            self.dropped_record_count += count
            return
        stamped_records = bytearray(records)
        # The statement below writes bytes 6 and 7 of all records at once. The step of the slice is
        # the size of one record.
        stamped_records[6::RECORD_SIZE] = bytes((self.dropped_record_count & 0xFF,)) * count
        stamped_records[7::RECORD_SIZE] = bytes((self.dropped_record_count >> 8 & 0xFF,)) * count
        sent_byte_count = self._send(stamped_records)
        # The number of sent records is rounded up, because a partly sent record must be completed
        # later.
        started_record_count = -(-sent_byte_count // RECORD_SIZE)
        self.unsent = bytes(stamped_records[sent_byte_count : started_record_count * RECORD_SIZE])
        self.dropped_record_count += count - started_record_count

    def flush(self) -> bool:
        """Send the bytes left over from a partly sent record.

        Returns:
            True if no bytes remain, so that the next record can be sent.
        """
        if self.unsent:
            self.unsent = self.unsent[self._send(self.unsent) :]
        return not self.unsent

    def _send(self, data: bytes | bytearray) -> int:
        try:
            return self.socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self.closed = True
            return 0


class BusHub:
    """The server of a local bus.

    Attributes:
        name: name of the bus.
    """

    def __init__(self, name: str) -> None:
        """Open the listening socket of the bus.

        Args:
            name: name of the bus.

        Raises:
            SimulatorError: another hub serves a bus of this name, or the socket cannot be created.
        """
        self.name = name
        self._path = bus_path(name)
        self._listener = _listening_socket(self._path, name)
        self._inode = self._path.stat().st_ino
        self._links: list[HubConnection] = []
        self._closed_dropped = 0

    @property
    def dropped_record_count(self) -> int:
        """Return the number of records dropped for all present and past clients together."""
        return self._closed_dropped + sum(link.dropped_record_count for link in self._links)

    @property
    def client_count(self) -> int:
        """Return the number of connected clients."""
        return len(self._links)

    @property
    def links(self) -> Sequence[HubConnection]:
        """Return the connections between the hub and its clients."""
        return self._links

    def read_sockets(self) -> list[socket.socket]:
        """Return the sockets to poll for reading."""
        return [self._listener, *(link.socket for link in self._links)]

    def write_sockets(self) -> list[socket.socket]:
        """Return the sockets to poll for writing: sockets of clients with a partly sent record."""
        return [link.socket for link in self._links if link.unsent]

    def serve(self, ready_sockets: Collection[socket.socket]) -> bytes:
        """Accept new clients, read the records of all clients, and forward each record to the other clients.

        Args:
            ready_sockets: sockets that are ready for reading.

        Returns:
            The records that all clients have sent. The owner of the hub uses the records.
        """
        received_records = self.poll(ready_sockets)
        for link, records in received_records:
            self._forward_records(records, link)
        self.remove_closed_clients()
        return b"".join(records for _, records in received_records)

    def poll(self, ready_sockets: Collection[socket.socket]) -> list[tuple[HubConnection, bytes]]:
        """Accept new clients, and read the records of all clients, but do not forward the records.

        Args:
            ready_sockets: sockets that are ready for reading.

        Returns:
            One pair (connection, records) for each client that has sent records.
        """
        if self._listener in ready_sockets:
            self._accept_clients()
        received_records = []
        for link in self._links:
            if link.unsent:
                link.flush()
            if link.socket in ready_sockets and (records := link.receive()):
                received_records.append((link, records))
        return received_records

    def send(self, records: bytes) -> None:
        """Send records from the process that owns the hub to every client."""
        self._forward_records(records, None)

    def _accept_clients(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionAbortedError):
            while True:
                link, _ = self._listener.accept()
                if _belongs_to_other_user(link):
                    link.close()
                    continue
                self._links.append(HubConnection(link))

    def _forward_records(self, records: bytes, sender: HubConnection | None) -> None:
        for link in self._links:
            if link is not sender and not link.closed:
                link.deliver(records)

    def remove_closed_clients(self) -> None:
        """Remove the clients that have disconnected from the hub."""
        if not any(link.closed for link in self._links):
            return
        for link in self._links:
            if link.closed:
                self._closed_dropped += link.dropped_record_count
                link.socket.close()
        self._links = [link for link in self._links if not link.closed]

    def close(self) -> None:
        """Close all connections.

        Remove the file of the socket, unless another process has replaced the file.
        """
        for link in self._links:
            link.socket.close()
        self._links.clear()
        self._listener.close()
        with contextlib.suppress(FileNotFoundError):
            # If the socket file has another inode, another hub now serves a bus of the same name.
            if self._path.stat().st_ino == self._inode:
                self._path.unlink()


def _belongs_to_other_user(client_socket: socket.socket) -> bool:
    """Return True if the client process of a connection belongs to another user than the hub.

    Processes of root do not count as processes of another user.

    The hub can find out the user of the client process only on Linux. On other operating systems,
    return False.
    """
    if not sys.platform.startswith("linux"):
        return False
    raw_bytes = client_socket.getsockopt(
        socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size
    )
    # Field 1 of the credentials is the user id. Root is allowed to join the bus for diagnosis.
    return _PEER_CREDENTIALS.unpack(raw_bytes)[1] not in (0, os.geteuid())


def _listening_socket(path: Path, name: str) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        # The hub locks the folder, because two hubs must not check, unlink and bind the same path
        # at the same time.
        with _locked_folder(path.parent):
            if _is_served(path):
                raise SimulatorError(
                    f"local:{name} is already served; stop the other hub, or join it: --bus join:{name}"
                )
            path.unlink(missing_ok=True)
            listener.bind(str(path))
            listener.listen(16)
    except OSError as error:
        listener.close()
        raise SimulatorError(f"local:{name}: {path}: {error.strerror}") from error
    except SimulatorError:
        listener.close()
        raise
    listener.setblocking(False)
    return listener


@contextlib.contextmanager
def _locked_folder(folder: Path) -> Iterator[None]:
    """Lock a folder.

    Only the hub that holds the lock of a folder is allowed to remove and replace an unused socket
    in this folder.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _is_served(path: Path) -> bool:
    """Return True if a hub accepts connections at a socket path."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        return probe.connect_ex(str(path)) not in (errno.ECONNREFUSED, errno.ENOENT, errno.ENOTSOCK)
