"""The hub of a local bus: every client gets every record of the others; nobody can make it wait.

A record has 72 bytes (``frame.RECORD_SIZE``); several may come in one piece, and a piece may end inside a record.
Towards a client, bytes 6 and 7 of a record count, modulo 65536, what was dropped for it because it did not read.
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
from firmware_sim.description import SimulatorError
from firmware_sim.places import bus_path

BUFFER = 1 << 20
"""Asked of the kernel for each direction [bytes]; Linux grants 416 KiB unless told otherwise."""
_PEER = struct.Struct("3i")
"""Linux's ``struct ucred``: process, user, group."""
_PIECE = 1 << 16
"""Bytes read from a client at a time: a flood cannot keep the hub from the others."""


class Link:
    """One connection, of whole records in both directions; never blocks.

    Attributes:
        socket: non-blocking. dropped: records that did not fit. gone: whether the other side has left.
        unsent: rest of a record that was begun.
    """

    def __init__(self, link: socket.socket) -> None:
        """Args: a connected stream socket."""
        self.socket = link
        self.dropped = 0
        self.gone = False
        self.unsent = b""
        self._rest = b""
        link.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            link.setsockopt(socket.SOL_SOCKET, option, BUFFER)

    def receive(self) -> bytes:
        """Return whole records that have arrived; the beginning of another waits for its rest."""
        try:
            piece = self.socket.recv(_PIECE)
        except BlockingIOError:
            return b""
        except OSError:
            piece = b""
        self.gone = self.gone or not piece
        data = self._rest + piece if self._rest else piece
        end = len(data) - len(data) % RECORD_SIZE
        self._rest = data[end:]
        return data[:end]

    def deliver(self, records: bytes) -> None:
        """Send whole records; those that the kernel does not take are dropped and counted."""
        count = len(records) // RECORD_SIZE
        if not self.flush():
            self.dropped += count
            return
        stamped = bytearray(records)
        stamped[6::RECORD_SIZE] = bytes((self.dropped & 0xFF,)) * count
        stamped[7::RECORD_SIZE] = bytes((self.dropped >> 8 & 0xFF,)) * count
        sent = self._send(stamped)
        begun = -(-sent // RECORD_SIZE)
        self.unsent = bytes(stamped[sent : begun * RECORD_SIZE])
        self.dropped += count - begun

    def flush(self) -> bool:
        """Complete a record that was begun; whether another may follow."""
        if self.unsent:
            self.unsent = self.unsent[self._send(self.unsent) :]
        return not self.unsent

    def _send(self, data: bytes | bytearray) -> int:
        try:
            return self.socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self.gone = True
            return 0


class Hub:
    """Owns the socket of a local bus.

    Attributes:
        name: of the bus. dropped: records dropped for clients that have left by now.
    """

    def __init__(self, name: str) -> None:
        """Begin to serve.

        Raises:
            SimulatorError: another hub serves this name, or the socket cannot be made.
        """
        self.name = name
        self._path = bus_path(name)
        self._listener = _listen(self._path, name)
        self._inode = self._path.stat().st_ino
        self._links: list[Link] = []
        self._gone_dropped = 0

    @property
    def dropped(self) -> int:
        """Records dropped for all clients so far."""
        return self._gone_dropped + sum(link.dropped for link in self._links)

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._links)

    @property
    def links(self) -> Sequence[Link]:
        """Connections of the clients."""
        return self._links

    def readers(self) -> list[socket.socket]:
        """Return the sockets to wait on for reading."""
        return [self._listener, *(link.socket for link in self._links)]

    def writers(self) -> list[socket.socket]:
        """Return the sockets to wait on for writing: of clients that have half a record."""
        return [link.socket for link in self._links if link.unsent]

    def serve(self, ready: Collection[socket.socket]) -> bytes:
        """Accept, read and forward; return the records for whoever owns the hub."""
        heard = self.hear(ready)
        for link, records in heard:
            self._forward(records, link)
        self.part()
        return b"".join(records for _, records in heard)

    def hear(self, ready: Collection[socket.socket]) -> list[tuple[Link, bytes]]:
        """Accept and read, but forward nothing; return the records of each client that sent some."""
        if self._listener in ready:
            self._accept()
        heard = []
        for link in self._links:
            if link.unsent:
                link.flush()
            if link.socket in ready and (records := link.receive()):
                heard.append((link, records))
        return heard

    def send(self, records: bytes) -> None:
        """Send the owner's records to every client."""
        self._forward(records, None)

    def _accept(self) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionAbortedError):
            while True:
                link, _ = self._listener.accept()
                if _is_foreign(link):
                    link.close()
                    continue
                self._links.append(Link(link))

    def _forward(self, records: bytes, sender: Link | None) -> None:
        for link in self._links:
            if link is not sender and not link.gone:
                link.deliver(records)

    def part(self) -> None:
        """Forget the clients that have left."""
        if not any(link.gone for link in self._links):
            return
        for link in self._links:
            if link.gone:
                self._gone_dropped += link.dropped
                link.socket.close()
        self._links = [link for link in self._links if not link.gone]

    def close(self) -> None:
        """Leave; the socket's file goes too, unless somebody has put another in its place."""
        for link in self._links:
            link.socket.close()
        self._links.clear()
        self._listener.close()
        with contextlib.suppress(FileNotFoundError):
            if self._path.stat().st_ino == self._inode:
                self._path.unlink()


def _is_foreign(link: socket.socket) -> bool:
    """Whether another user than this one or root is at the other end; only Linux tells."""
    if not sys.platform.startswith("linux"):
        return False
    raw = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    return _PEER.unpack(raw)[1] not in (0, os.geteuid())


def _listen(path: Path, name: str) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with _alone_in(path.parent):
            if _is_served(path):
                raise SimulatorError(
                    f"local:{name} is served already; end the other hub, or join it: --bus join:{name}"
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
def _alone_in(folder: Path) -> Iterator[None]:
    """Lock a directory, so that two hubs do not both find the same socket stale."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _is_served(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        return probe.connect_ex(str(path)) not in (errno.ECONNREFUSED, errno.ENOENT, errno.ENOTSOCK)
