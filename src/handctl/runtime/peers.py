"""Whose process is at the other end of a Unix socket, as the kernel says: only this user and root are trusted.

The folder of the sockets keeps other users out already (``places``). This is the second guard, on Linux alone:
elsewhere Python has no portable way to ask, and every sender counts as this user.
"""

import os
import socket
import struct
import sys

CREDENTIALS = struct.Struct("3i")
"""Linux's ``struct ucred``: process, user, group."""
LINUX = sys.platform.startswith("linux")
SPACE = socket.CMSG_SPACE(CREDENTIALS.size)
SO_PASSCRED, SCM_CREDENTIALS, SO_PEERCRED = (getattr(socket, name, 0) for name in
                                             ("SO_PASSCRED", "SCM_CREDENTIALS", "SO_PEERCRED"))  # fmt: skip


def name_senders(link: socket.socket) -> None:
    """Let the kernel add the sender's user to every datagram; before the socket has a name that anybody can send to."""
    if LINUX:
        link.setsockopt(socket.SOL_SOCKET, SO_PASSCRED, 1)


def receive(link: socket.socket, most: int) -> tuple[bytes, str, bool]:
    """Receive one datagram of a socket of ``name_senders``.

    Args:
        link: to read from.
        most: bytes; the rest of a longer datagram is lost.

    Returns:
        the data, the path of the sender's socket (empty if it has none), and whether the sender may be trusted.
    """
    if not LINUX:
        data, sender = link.recvfrom(most)
        return data, sender if isinstance(sender, str) else "", True
    data, ancillary, _, sender = link.recvmsg(most, SPACE)
    users = [CREDENTIALS.unpack(raw)[1] for level, kind, raw in ancillary
             if (level, kind) == (socket.SOL_SOCKET, SCM_CREDENTIALS) and len(raw) == CREDENTIALS.size]  # fmt: skip
    return data, sender if isinstance(sender, str) else "", bool(users) and all(map(trusted, users))


def served_by_us(link: socket.socket) -> bool:
    """Return whether the other end of a connected stream socket is a process of this user or root."""
    if not LINUX:
        return True
    raw = link.getsockopt(socket.SOL_SOCKET, SO_PEERCRED, CREDENTIALS.size)
    return trusted(CREDENTIALS.unpack(raw)[1])


def trusted(user: int) -> bool:
    """Return whether a user may command this user's hand."""
    return user in (0, os.geteuid())
